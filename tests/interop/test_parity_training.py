import json

import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.interop.parity import format_parity, run_parity

LOSSES = ["d_loss", "g_l2_loss", "g_adv_loss", "g_grad_norm"]


@pytest.fixture(scope="module")
def golden(shared):
    """The manifest's row and the arrays."""
    folder = shared / "golden" / "torch"
    rows = json.loads((folder / "manifest.json").read_text()) if folder.is_dir() else []
    row = next((row for row in rows if row["file"] == "train_step.npz"), None)
    if row is None:
        pytest.skip(f"no golden train step in {folder}")
    with np.load(folder / row["file"]) as archive:
        return row, {name: archive[name] for name in archive.files}


def compare(folder, row, arrays, tolerance=1e-5):
    np.savez(folder / row["file"], **arrays)
    (folder / "manifest.json").write_text(json.dumps([row]))
    return run_parity(folder, tolerance)


def test_the_golden_step(tmp_path, golden):
    row, arrays = golden
    rows = {result.output: result for result in compare(tmp_path, row, arrays)}
    assert list(rows) == [*LOSSES, "d_grad", "g_grad_clipped", "d1", "g1"]
    assert all(result.ok for result in rows.values()), format_parity(list(rows.values()))
    assert all(rows[name].max_rel <= 1e-5 for name in LOSSES)
    assert rows["g_grad_clipped"].max_abs <= 1e-6
    assert rows["g1"].max_abs <= 1e-6
    # The comparison proves little where clipping does not act or nothing moves.
    assert arrays["g_grad_norm"] > 2 * row["clipping_threshold_g"]
    moved = [np.abs(arrays[n] - arrays[n.replace("1/", "0/")]) for n in arrays if "1/" in n[:3]]
    assert min(change.max() for change in moved) > 5e-5


@pytest.mark.parametrize(
    ("name", "missed"),
    [
        ("d_loss", {"d_loss"}),
        ("g1/decoder.hidden2pos.bias", {"g1"}),
        ("g_grad_clipped/encoder.encoder.weight_hh_l0", {"g_grad_clipped"}),
        # A discriminator that has learned nothing hardly tells one forecast from another.
        ("noise_d", {"d_grad", "d1"}),
        ("noise_g", {"g_l2_loss", "g_grad_norm", "g_grad_clipped", "g1"}),
        ("d0/real_classifier.2.bias", {"d_loss", "g_adv_loss", "d1"}),
    ],
)
def test_a_difference_is_a_miss(tmp_path, golden, name, missed):
    row, arrays = golden
    rows = compare(tmp_path, row, {**arrays, name: 0.5 - arrays[name]})
    found = {result.output for result in rows if not result.ok}
    assert missed <= found
    if len(missed) == 1:
        assert found == missed


def test_bad_cases_are_refused(tmp_path, golden):
    row, arrays = golden
    with pytest.raises(InputError, match="noise_mix_type global"):
        compare(tmp_path, row | {"noise_mix_type": "ped"}, arrays)
    with pytest.raises(InputError, match=r"\[5, 4, 8\], not \[3, 4, 8\]"):
        compare(tmp_path, row | {"best_k": 3}, arrays)
    with pytest.raises(InputError, match="label_fake is missing"):
        compare(tmp_path, {k: v for k, v in row.items() if k != "label_fake"}, arrays)
    for missing in ("d_loss", "noise_g", "g0/decoder.hidden2pos.bias", "d1/encoder"):
        kept = {name: a for name, a in arrays.items() if not name.startswith(missing)}
        with pytest.raises(InputError, match=r"train_step\.npz"):
            compare(tmp_path, row, kept)
