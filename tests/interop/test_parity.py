"""Parity with stored cases: all agree, a planted difference is a miss, what is wrong is named."""

import json
import os

import jax
import numpy as np
import pytest

from neurosym_jax.commands.parity import run
from neurosym_jax.errors import InputError
from neurosym_jax.interop.parity import TOLERANCE, hand_over, run_parity, run_torch
from tests.interop import released_cases  # noqa: F401 (it registers kinds of cases)
from tests.repository import GOLDEN, exhaustive


def copied(directory, source, file, change=None, row_changes=None):
    """A directory with one case of `source`; `change` edits its arrays, `row_changes` its row."""
    rows = json.loads((source / "manifest.json").read_text())
    (row,) = [row for row in rows if row["file"] == file]
    with np.load(source / file) as archive:
        arrays = dict(archive)
    np.savez(directory / file, **(change(arrays) if change else arrays))
    row = {k: v for k, v in {**row, **(row_changes or {})}.items() if v is not DROP}
    (directory / "manifest.json").write_text(json.dumps([row]))
    return directory


DROP = object()
NONE, POOLED = "fresh_none.npz", "fresh_pool_net.npz"
ARCHIVE = (GOLDEN / "fresh" / NONE).read_bytes()


def altered(name, where, by):
    def change(arrays):
        array = arrays[name].copy()
        array[where] += by
        return {**arrays, name: array}

    return change


def without(name):
    return lambda arrays: {k: v for k, v in arrays.items() if not k.startswith(name)}


def replaced(name, change):
    return lambda arrays: {**arrays, name: change(arrays[name])}


@pytest.fixture(scope="module")
def golden(shared):
    if not (shared / "golden" / "torch").is_dir():
        pytest.skip(f"no golden cases in {shared}")
    return shared / "golden" / "torch"


ROUNDING = {"pred_rel": 2e-6, "pred_abs": TOLERANCE}
"""Metres, by output: of a step 1e-6, of positions after twelve steps 8e-6, compiled for users."""


@pytest.mark.rounding
@pytest.mark.parametrize("folder", ["published", "fresh"])
def test_stored_cases(folder):
    parity = run_parity(GOLDEN / folder)
    assert parity.ok, parity
    assert all(
        row.max_abs < ROUNDING.get(row.output, TOLERANCE) for row in parity.rows
    ), parity
    scores = {"d_scores_fake"} if folder == "fresh" else set()
    assert {row.output for row in parity.rows} == {"pred_rel", "pred_abs"} | scores


def test_the_stored_cases_prove_something():
    for path in GOLDEN.glob("[pf]*/*.npz"):
        with np.load(path) as arrays:
            assert np.abs(arrays["pred_rel"]).max() > 0.01
            # A score of zero is a ReLU that is shut, and would agree with anything.
            assert "d_scores_fake" not in arrays or arrays["d_scores_fake"].min() > 0


@pytest.mark.rounding
@pytest.mark.slow
def test_released_code(golden):
    """The 40 outputs of SGAN, NeuroSyM, its symbols and a training step."""
    parity = run_parity(golden)
    assert parity.ok, parity
    rows = {f"{row.case} {row.output}": row for row in parity.rows}
    assert len(rows) == 40
    exact = [
        *(
            f"qtc.npz {name}"
            for name in ("qtc_reference", "qtc_signed", "qtc_signed_q005")
        ),
        "qtc.npz alpha_reference",
        *(f"neurosym_ijcnn_{case}.npz alpha_rows_used" for case in (0, 1)),
    ]
    assert [rows[name].max_abs for name in exact] == [0] * len(exact)
    # The table as printed; what remains is its float32.
    shipped = [f"neurosym_{name}.npz alpha" for name in ("ros_0", "ros_2", "ijcnn_1")]
    assert max(rows[name].max_abs for name in shipped) < 1e-9
    assert all(
        row.max_abs < ROUNDING["pred_rel"]
        for row in parity.rows
        if row.output == "pred_rel"
    )
    # Training proves little where clipping does not act or nothing moves.
    with np.load(golden / "train_step.npz") as arrays:
        assert arrays["g_grad_norm"] > 1
        moved = [
            np.abs(arrays[n] - arrays[n.replace("1/", "0/")])
            for n in arrays
            if n[1:3] == "1/"
        ]
    assert min(change.max() for change in moved) > 5e-5


def test_far_from_the_origin(tmp_path):
    """In float32 positions are good to 1e-5 only if scenes are centred first."""

    def move(arrays):
        moved = {
            n: arrays[n].astype(float) + np.array([100, -300])
            for n in ("traj", "pred_abs")
        }
        return {**arrays, **moved}

    parity = run_parity(copied(tmp_path, GOLDEN / "fresh", POOLED, move))
    assert parity.ok, parity


BIAS, CLIPPED = "mlp_pre_pool.0.bias", "g_grad_clipped"
OF_FORECAST = {"pred_rel", "pred_abs"}
OF_CRITIC = {"d_scores_fake"}


@pytest.mark.parametrize(
    ("file", "change", "missed"),
    [
        (
            POOLED,
            altered("g_state/decoder.decoder.weight_hh_l0", ..., 1e-2),
            OF_FORECAST,
        ),
        (POOLED, altered("d_state/real_classifier.0.bias", ..., 1e-2), OF_CRITIC),
        # Torch's displacements are also what the discriminator is given.
        (POOLED, altered("pred_rel", ..., 1e-2), {"pred_rel", *OF_CRITIC}),
        (POOLED, altered("noise", ..., 1e-2), OF_FORECAST),
        (POOLED, altered("traj_rel", ..., 1e-2), OF_FORECAST),
        ("qtc.npz", altered("qtc_signed", (3, 1, 2), 1), {"qtc_signed"}),
        ("qtc.npz", altered("alpha_reference", (0, 0), 0.01), {"alpha_reference"}),
        ("neurosym_ros_0.npz", altered("alpha", (1, 3), 0.5), {"alpha", "pred_rel"}),
        (
            "neurosym_ijcnn_0.npz",
            altered("alpha", (1, 3), 0.5),
            {"alpha_rows_used", "pred_rel"},
        ),
        ("neurosym_ijcnn_0.npz", altered("alpha", (30, 3), 0.5), set()),
        (
            "neurosym_ijcnn_0.npz",
            altered(f"g_state/pool_net_g.{BIAS}", ..., 0.1),
            {"pred_rel"},
        ),
        # These compile a training step.
        exhaustive("train_step.npz", altered("d_loss", ..., 0.1), {"d_loss"}),
        exhaustive(
            "train_step.npz", altered("g1/decoder.hidden2pos.bias", ..., 0.1), {"g1"}
        ),
        # A discriminator that has learned nothing hardly tells one forecast from
        # another.
        exhaustive(
            "train_step.npz", replaced("noise_d", np.negative), {"d_grad", "d1"}
        ),
        exhaustive(
            "train_step.npz",
            replaced("noise_g", np.negative),
            {"g_l2_loss", CLIPPED, "g1"},
        ),
    ],
)
def test_a_planted_difference_is_found(request, tmp_path, file, change, missed):
    source = GOLDEN / "fresh" if file == POOLED else request.getfixturevalue("golden")
    parity = run_parity(copied(tmp_path, source, file, change))
    misses = {row.output for row in parity.rows if not row.ok}
    # A training step has many outputs that depend on its noise.
    assert (
        missed
        <= misses
        <= (misses if {"d1", "g1"} & missed and len(missed) > 1 else missed)
    )
    assert ("MISS" in str(parity)) == (not parity.ok) == bool(missed)


def test_one_element_decides_tolerance_is_inclusive_and_nothing_compared_is_no_proof(
    tmp_path,
):
    copied(tmp_path, GOLDEN / "fresh", NONE, altered("pred_abs", (3, 1, 0), 1e-3))
    row = next(r for r in run_parity(tmp_path).rows if r.output == "pred_abs")
    assert not row.ok
    assert row.max_abs == pytest.approx(1e-3, abs=1e-5)
    again = {r.output: r for r in run_parity(tmp_path, row.max_abs).rows}
    assert again["pred_abs"].ok
    (tmp_path / "manifest.json").write_text("[]")
    assert run(tmp_path) == 1


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.skipif(os.name == "nt", reason="a script of a shell stands for Python")
def test_the_seed_reaches_the_python_of_torch(tmp_path):
    python, module = tmp_path / "python", tmp_path / "m.py"
    said = tmp_path / "said"
    python.write_text(f'#!/bin/sh\nfor word; do :; done; echo "$word" > {said}\n')
    python.chmod(0o700)
    module.touch()
    options = {"title": "a", "python": str(python), "seed": 7}
    run_torch(f"{module}:Net", {"args": {}, "g_state": {}}, tmp_path, **options)
    assert said.read_text() == "7\n"


def test_torch_gets_tuples_for_tuples(tmp_path):
    """JSON has lists alone, and a constructor may take a tuple for a key."""
    arguments = {"noise_dim": (8,), "sizes": [1, 2], "name": "eth"}
    hand_over(tmp_path, "a", {"args": arguments, "g_state": {"w": [1.0]}})
    contents = json.loads((tmp_path / "contents.json").read_text())
    assert contents["tuples"] == ["noise_dim"]
    assert contents["arguments"] == arguments | {"noise_dim": [8]}


def test_a_forecast_that_is_not_finite_is_a_miss(tmp_path):
    broken = replaced(
        "g_state/decoder.hidden2pos.bias", lambda a: np.full_like(a, 3e38)
    )
    copied(tmp_path, GOLDEN / "fresh", NONE, broken)
    with jax.debug_nans(False):
        parity = run_parity(tmp_path)
    assert [row.ok for row in parity.rows] == [False, False, True]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "(cannot be read as|not JSON|holds objects)"),
        ("[3]", "(cannot be read as|not JSON|holds objects)"),
        ('[{"model": "sgan"}]', r"manifest\.json: 'file' is missing"),
        ('[{"file": "absent.npz"}]', "'absent' is none of the cases sgan"),
        ('[{"file": "qtc.npz"}]', r"qtc\.npz: cannot be read: No such file"),
        *(
            (
                f'[{{"file": "{n}.npz", "model": "sgan"}}]',
                rf"{n}\.npz: (cannot be read as|not JSON|holds objects)",
            )
            for n in "abc"
        ),
    ],
)
def test_bad_manifests(tmp_path, text, reason):
    (tmp_path / "manifest.json").write_text(text)
    for name, content in (("a", b""), ("b", b"text"), ("c", ARCHIVE[:2000])):
        (tmp_path / f"{name}.npz").write_bytes(content)
    with pytest.raises(InputError, match=reason) as caught:
        run_parity(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"directory": GOLDEN}, r"manifest\.json: cannot be read: No such file"),
        ({"directory": GOLDEN / "fresh", "tolerance": -1.0}, "tolerance"),
        ({"directory": GOLDEN / "fresh", "tolerance": float("nan")}, "tolerance"),
        ({}, "give either"),
        (
            {"directory": GOLDEN, "torch_module": "a.py:B"},
            "--torch-module: has no effect",
        ),
        ({"torch_module": "a.py:B"}, "give either"),
    ],
)
def test_bad_options(options, reason):
    with pytest.raises(InputError, match=reason):
        run(**options)


@pytest.mark.parametrize(
    ("file", "change", "row", "reason"),
    [
        (NONE, None, {"pooling_type": DROP}, "args: pooling_type is missing"),
        (NONE, None, {"d_type": "both"}, "kind"),
        (NONE, without("noise"), {}, "'noise' is missing"),
        (
            NONE,
            without("d_state/encoder.encoder.bias_hh_l0"),
            {},
            "bias_hh_l0' is missing",
        ),
        (
            NONE,
            replaced("noise", lambda a: a[1:]),
            {},
            "(cannot be read as|not JSON|holds objects)",
        ),
        (
            NONE,
            replaced("scene_start_end", lambda a: a[:-1]),
            {},
            "(cannot be read as|not JSON|holds objects)",
        ),
        (
            NONE,
            replaced("traj", lambda a: np.array([{}], dtype=object)),
            {},
            "(cannot be read as|not JSON|holds objects)",
        ),
        ("qtc.npz", without("qtc_signed"), {}, "'qtc_signed' is missing"),
        (
            "neurosym_ros_0.npz",
            replaced("alpha", lambda a: a[1:]),
            {},
            "(cannot be read as|not JSON|holds objects)",
        ),
        (
            "neurosym_ros_1.npz",
            None,
            {"pooling_type": "spool"},
            "one of 'pool_net', not 'spool'",
        ),
        ("train_step.npz", None, {"label_fake": DROP}, "'label_fake' is missing"),
    ],
)
def test_bad_cases(request, tmp_path, file, change, row, reason):
    source = GOLDEN / "fresh" if file == NONE else request.getfixturevalue("golden")
    with pytest.raises(InputError, match=reason) as caught:
        run_parity(copied(tmp_path, source, file, change, row))
    assert str(caught.value).startswith(str(tmp_path / file))
    assert "\n" not in str(caught.value)
