import json
import shutil

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tyro

from neurosym_jax.commands.parity import Options, run
from neurosym_jax.errors import InputError
from neurosym_jax.interop.names import params_to_torch
from neurosym_jax.interop.parity import (
    ParityRow,
    format_parity,
    parity_json,
    run_parity,
)
from neurosym_jax.interop.parity_case import generator_of
from neurosym_jax.models import Discriminator, Generator
from neurosym_jax.models.config import DiscriminatorConfig
from neurosym_jax.scene import make_scene

BOUNDS = np.array([[0, 3], [3, 4], [4, 7]])
OBS, PRED = 8, 3
ROW = {
    "file": "case.npz",
    "model": "sgan",
    "obs_len": OBS,
    "pred_len": PRED,
    "embedding_dim": 4,
    "encoder_h_dim": 6,
    "decoder_h_dim": 7,
    "mlp_dim": 9,
    "bottleneck_dim": 5,
    "noise_dim": [2],
    "noise_type": "gaussian",
    "noise_mix_type": "ped",
    "pooling_type": "pool_net",
    "pool_every_timestep": False,
    "d_type": "global",
    "encoder_h_dim_d": 8,
}


def make_case(row=ROW):
    """Arrays of a case as a torch run would store them, computed scene by scene, unpadded."""
    config = generator_of(row)
    d_config = DiscriminatorConfig("global", embedding_dim=4, h_dim=8, mlp_dim=9)
    rng = np.random.default_rng(0)
    agents = BOUNDS[-1, 1]
    # Far from zero: in float32 the positions are good to 1e-5 only if scenes are centred first.
    traj = np.cumsum(rng.normal(0, 0.3, (agents, OBS + PRED, 2)), axis=1).round(4) + 100
    rel = np.diff(traj, axis=1, prepend=traj[:, :1]).astype(np.float32)
    per_agent = row["noise_mix_type"] == "ped"
    noise = rng.normal(size=(agents if per_agent else len(BOUNDS), 2)).astype(np.float32)

    def randomly(shapes):
        return jax.tree.map(lambda s: rng.normal(0, 0.2, s.shape).astype(np.float32), shapes)

    generator, discriminator = Generator(config), Discriminator(d_config)
    scene = make_scene(traj[:3, :OBS])
    first = jnp.zeros(config.noise_dim)
    variables = randomly(jax.eval_shape(generator.init, jax.random.key(0), scene, first))
    forecast, discriminate = jax.jit(generator.apply), jax.jit(discriminator.apply)
    predicted, absolute, fakes = [], [], []
    for index, (a, b) in enumerate(BOUNDS):
        scene = make_scene(traj[a:b, :OBS])
        given = noise[a:b] if per_agent else noise[index]
        steps = np.asarray(forecast(variables, scene, given[..., : config.noise_dim]))
        positions = traj[a:b, OBS - 1 : OBS] + np.cumsum(steps, axis=1, dtype=np.float64)
        fake = make_scene(np.concatenate([traj[a:b, :OBS], positions], axis=1))
        fake_rel = np.concatenate([rel[a:b, :OBS], steps], axis=1)
        fakes.append((fake.observed, fake_rel, fake.valid))
        predicted.append(steps)
        absolute.append(positions)
    g_state = params_to_torch(variables["params"], config)
    arrays = {
        "traj": traj,
        "traj_rel": rel,
        "scene_start_end": BOUNDS,
        "noise": noise,
        "pred_rel": np.concatenate(predicted),
        "pred_abs": np.concatenate(absolute),
        **{f"g_state/{name}": value for name, value in g_state.items()},
    }
    if "d_type" not in row:
        return arrays
    d_variables = randomly(jax.eval_shape(discriminator.init, jax.random.key(0), *fakes[0]))
    # A score of zero is a ReLU that is shut, and would agree with anything.
    d_variables["params"]["classifier"]["layer_1"]["bias"] += 0.5
    d_state = params_to_torch(d_variables["params"], d_config)
    return arrays | {
        "d_scores_fake": np.concatenate([discriminate(d_variables, *fake) for fake in fakes]),
        **{f"d_state/{name}": value for name, value in d_state.items()},
    }


def generator_only(row):
    return {name: value for name, value in row.items() if name not in ("d_type", "encoder_h_dim_d")}


def write(directory, arrays, row=ROW, more=()):
    np.savez(directory / row["file"], **arrays)
    (directory / "manifest.json").write_text(json.dumps([row, *more]))
    return directory


@pytest.fixture(scope="module")
def case():
    return make_case()


def test_golden_cases_of_torch(shared, tmp_path):
    """Those of SGAN; the others have tests of their own."""
    directory = shared / "golden" / "torch"
    if not directory.is_dir():
        pytest.skip(f"no golden cases at {directory}")
    manifest = json.loads((directory / "manifest.json").read_text())
    cases = [row for row in manifest if row["file"].startswith("sgan")]
    for case in cases:
        shutil.copy(directory / case["file"], tmp_path)
    (tmp_path / "manifest.json").write_text(json.dumps(cases))
    sgan = run_parity(tmp_path, 2e-6)
    assert [row.output for row in sgan] == ["pred_rel", "pred_abs", "d_scores_fake"] * 6
    assert all(row.ok for row in sgan), format_parity(sgan)
    # An output of zeros would agree with anything that a ReLU has killed.
    for file in {row.case for row in sgan}:
        assert (np.load(directory / file)["d_scores_fake"] > 0).all()


def test_equal_networks_pass(tmp_path, case, capsys):
    write(tmp_path, case)
    assert (case["d_scores_fake"] > 0).all()
    assert run(Options(tmp_path)) == 0
    assert "3 of 3 outputs within 1e-05; 0 cases skipped" in capsys.readouterr().out


@pytest.mark.parametrize(
    "changes",
    [
        {"noise_mix_type": "global", "noise_dim": 2},
        {"noise_dim": [0], "pooling_type": None},
        {"pooling_type": "spool", "bottleneck_dim": 6, "neighborhood_size": 2.0, "grid_size": 3},
    ],
)
def test_forms_of_noise_and_pooling(tmp_path, changes):
    row = generator_only(ROW | changes)
    rows = run_parity(write(tmp_path, make_case(row), row))
    assert all(r.ok for r in rows), format_parity(rows)


def test_without_a_discriminator(tmp_path, case):
    row = generator_only(ROW)
    arrays = {name: value for name, value in case.items() if not name.startswith("d_")}
    assert [r.output for r in run_parity(write(tmp_path, arrays, row))] == ["pred_rel", "pred_abs"]


@pytest.mark.parametrize(
    ("name", "missed"),
    [
        ("g_state/decoder.decoder.weight_hh_l0", {"pred_rel", "pred_abs"}),
        ("g_state/pool_net.mlp_pre_pool.2.bias", {"pred_rel", "pred_abs"}),
        ("d_state/real_classifier.0.bias", {"d_scores_fake"}),
        ("pred_rel", {"pred_rel"}),
        ("d_scores_fake", {"d_scores_fake"}),
        ("noise", {"pred_rel", "pred_abs"}),
    ],
)
def test_a_difference_is_a_miss(tmp_path, case, name, missed, capsys):
    write(tmp_path, {**case, name: case[name] + np.float32(1e-2)})
    rows = run_parity(tmp_path)
    # Torch's displacements are also what the discriminator is given.
    known = missed | {"d_scores_fake"} if name == "pred_rel" else missed
    assert missed <= {row.output for row in rows if not row.ok} <= known
    assert run(Options(tmp_path)) == 1
    assert "MISS" in capsys.readouterr().out


def test_one_element_decides_and_tolerance_is_inclusive(tmp_path, case):
    shifted = case["pred_abs"].copy()
    shifted[3, 1, 0] += 1e-3
    write(tmp_path, {**case, "pred_abs": shifted})
    row = next(r for r in run_parity(tmp_path) if r.output == "pred_abs")
    assert not row.ok
    assert row.shape == shifted.shape
    assert row.max_abs == pytest.approx(1e-3, abs=1e-5)
    assert row.max_rel == pytest.approx(1e-3 / np.abs(shifted).max(), rel=1e-2)
    again = {r.output: r for r in run_parity(tmp_path, row.max_abs)}
    assert again["pred_abs"].ok


def test_the_stored_displacements_are_used(tmp_path, case):
    rows = run_parity(write(tmp_path, {**case, "traj_rel": case["traj_rel"] * 1.5}))
    assert not any(row.ok for row in rows)


def test_unknown_kinds_are_skipped_and_prove_nothing(tmp_path, case, capsys):
    others = [{"file": "qtcx.npz"}, {"file": "m.npz", "model": "neurosym", "variant": "other"}]
    for other in others:
        (tmp_path / other["file"]).write_bytes(b"")
    write(tmp_path, case, more=others)
    rows = run_parity(tmp_path)
    assert [row.skipped for row in rows[3:]] == [
        "this version compares no 'qtcx' cases",
        "this version compares no 'other' cases",
    ]
    assert run(Options(tmp_path)) == 0
    assert "2 cases skipped" in capsys.readouterr().out
    (tmp_path / "manifest.json").write_text(json.dumps(others))
    assert run(Options(tmp_path)) == 1
    assert "nothing was compared" in capsys.readouterr().out


def test_json_report(tmp_path, case):
    options = tyro.cli(
        Options,
        args=[str(write(tmp_path, case)), "--json", str(tmp_path / "out.json")],
    )
    for _ in range(2):  # The second run replaces the report of the first.
        assert run(options) == 0
    report = json.loads((tmp_path / "out.json").read_text())
    assert (report["format"], report["tolerance"], len(report["rows"])) == (1, 1e-5, 3)
    assert report["rows"][0]["output"] == "pred_rel"
    assert report["rows"][0]["shape"] == [7, PRED, 2]
    (tmp_path / "out.json").write_text("my notes")
    with pytest.raises(InputError, match=r"out\.json"):
        run(options)
    assert (tmp_path / "out.json").read_text() == "my notes"


@pytest.mark.filterwarnings("ignore:overflow")
def test_what_is_not_finite_is_a_miss_and_null(tmp_path, case):
    broken = {**case, "g_state/decoder.hidden2pos.bias": np.full(2, 3e38, np.float32)}
    with jax.debug_nans(False):
        rows = run_parity(write(tmp_path, broken))
    assert [row.ok for row in rows] == [False, False, True]
    assert "MISS" in format_parity(rows)
    assert json.dumps(parity_json(rows), allow_nan=False)
    # How far a sum goes before it overflows hangs on how it was compiled.
    assert None in [row["max_abs"] for row in parity_json(rows)["rows"]]


def test_table_is_aligned():
    rows = [
        ParityRow("a.npz", 1e-5, "pred_rel", (3, 2), 1e-7, 1e-6, True),
        ParityRow("longer.npz", 1e-5, "loss", (), 2e-5, 1e-3, False),
        ParityRow("b.npz", 1e-5, skipped="unknown"),
    ]
    head, *lines = format_parity(rows).splitlines()[:4]
    assert len({line.index(word) for line, word in zip(lines, ["ok", "MISS", "skipped"])}) == 1
    assert head.index("shape") == lines[0].index("3x2") == lines[1].index("scalar")
    assert "1 of 2 outputs within 1e-05; 1 cases skipped" in format_parity(rows)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "not JSON"),
        ("[]", "at least one case"),
        ('{"file": "case.npz"}', "list"),
        ("[3]", "row 0 needs 'file'"),
        ('[{"model": "sgan"}]', "row 0 needs 'file'"),
        ('[{"file": "../case.npz"}]', "row 0 needs 'file'"),
        ('[{"file": "absent.npz"}]', r"absent\.npz: is in the manifest and does not exist"),
    ],
)
def test_bad_manifests(tmp_path, text, reason):
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(InputError, match=reason) as caught:
        run_parity(tmp_path)
    assert "\n" not in str(caught.value)


def test_bad_directories_and_tolerances(tmp_path):
    with pytest.raises(InputError, match="no such directory"):
        run_parity(tmp_path / "absent")
    with pytest.raises(InputError, match=r"manifest\.json: cannot be read"):
        run_parity(tmp_path)
    for tolerance in (-1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="tolerance"):
            run_parity(tmp_path, tolerance)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"pooling_type": "hidden"}, "pooling_type"),
        ({"pooling_type": ["spool"]}, "pooling_type"),
        ({"pooling_type": "spool"}, "neighborhood_size is missing"),
        ({"noise_dim": [2, 2]}, "noise_dim"),
        ({"batch_norm": True}, "batch_norm is True"),
        ({"num_layers": 2}, "num_layers is 2"),
        ({"mlp_dim": "9"}, "mlp_dim"),
        ({"mlp_dim": 10}, "of another shape"),
        ({"d_type": "both"}, "kind"),
        ({"pred_len": 4}, r"'traj' has the shape \[7, 11, 2\], not \[any, 12, 2\]"),
    ],
)
def test_bad_rows(tmp_path, case, changes, reason):
    with pytest.raises(InputError, match=reason) as caught:
        run_parity(write(tmp_path, case, ROW | changes))
    assert str(caught.value).startswith(str(tmp_path / "case.npz"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["bottleneck_dim", "pooling_type", "noise_dim", "encoder_h_dim_d"])
def test_missing_fields(tmp_path, case, name):
    row = {key: value for key, value in ROW.items() if key != name}
    with pytest.raises(InputError, match=f"manifest: {name} is missing"):
        run_parity(write(tmp_path, case, row))


def test_missing_arrays(tmp_path, case):
    for name in case:
        arrays = {key: value for key, value in case.items() if key != name}
        with pytest.raises(InputError, match=name.partition("/")[2] or name):
            run_parity(write(tmp_path, arrays))


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("noise", lambda a: a[:, :1], r"\[7, 1\], not \[7, 2\]"),
        ("pred_rel", lambda a: a[:, 0], "pred_rel"),
        ("d_scores_fake", lambda a: a[:, None], r"\[7, 1\], not \[7\]"),
        ("traj_rel", lambda a: a[1:], "traj_rel"),
        ("traj", lambda a: a.astype(int), "not floating point"),
        ("traj", lambda a: a * np.nan, "not finite"),
        ("scene_start_end", lambda a: a[1:], "scenes one after another"),
        ("scene_start_end", lambda a: a[:-1], "scenes one after another"),
        ("scene_start_end", lambda a: a + np.eye(3, 2, -1, int), "scenes one after another"),
        ("scene_start_end", lambda a: a[[0, 0, 1, 2]], "scenes one after another"),
        ("scene_start_end", lambda a: a * 1.0, "whole numbers"),
        ("scene_start_end", lambda a: a[:0], "at least one scene"),
    ],
)
def test_bad_arrays(tmp_path, case, name, change, reason):
    with pytest.raises(InputError, match=reason):
        run_parity(write(tmp_path, {**case, name: change(case[name])}))


def test_files_that_are_no_archives(tmp_path, case):
    write(tmp_path, case)
    path = tmp_path / "case.npz"
    whole = path.read_bytes()
    for content in (b"", b"text", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"case\.npz"):
            run_parity(tmp_path)
    np.savez(path, traj=np.array([{}], dtype=object))
    with pytest.raises(InputError, match="plain arrays"):
        run_parity(tmp_path)
    with path.open("wb") as file:
        np.save(file, case["traj"])
    with pytest.raises(InputError, match="plain arrays"):
        run_parity(tmp_path)
