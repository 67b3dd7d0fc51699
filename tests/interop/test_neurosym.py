"""NeuroSyM and its symbols against torch: names, checkpoints, parity cases."""

import dataclasses
import json

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.interop import names
from neurosym_jax.interop.names import params_from_torch, params_to_torch
from neurosym_jax.interop.parity import format_parity, run_parity
from neurosym_jax.interop.parity_case import generator_of
from neurosym_jax.interop.parity_networks import alpha_rows_used
from neurosym_jax.interop.pickle_writer import write_torch_file
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_jax.interop.torch import export_torch_checkpoint, load_torch_checkpoint
from neurosym_jax.models import Generator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.scene import make_scene

SMALL = {"embedding_dim": 4, "encoder_h_dim": 6, "decoder_h_dim": 7, "mlp_dim": 9, "noise_dim": 2}
ROS = GeneratorConfig(pooling="neurosym_ros,bottleneck_dim=5", weighting="ones", **SMALL)
IJCNN = dataclasses.replace(ROS, pooling="neurosym_ijcnn,bottleneck_dim=5", weighting=None)
EACH = pytest.mark.parametrize(
    "config", [ROS, IJCNN], ids=lambda config: POOLINGS.name_of(config.pooling)
)


def random_state(config):
    rng = np.random.default_rng(0)
    leaves = names._leaves(config)
    return {leaf.torch: rng.normal(size=leaf.shape[::-1]).astype(np.float32) for leaf in leaves}


@EACH
def test_names_and_shapes(config):
    state = random_state(config)
    shapes = {name: array.shape for name, array in state.items() if name.startswith("pool_net")}
    embedding = (32, 16) if config is ROS else (4, 2)
    wanted = {
        "pool_net_g.spatial_embedding": embedding,
        "pool_net_g.mlp_pre_pool.0": (512, 38),
        "pool_net_g.mlp_pre_pool.2": (5, 512),
        "pool_net_d.spatial_embedding": (4, 2),
        "pool_net_d.mlp_pre_pool.0": (512, 10),
        "pool_net_d.mlp_pre_pool.2": (5, 512),
    }
    assert shapes == {f"{k}.weight": shape for k, shape in wanted.items()} | {
        f"{k}.bias": shape[:1] for k, shape in wanted.items()
    }


@EACH
def test_params_are_the_networks_own(config):
    params = params_from_torch(random_state(config), config)
    alpha = np.zeros((1, 8) if config is IJCNN else (1, 1, 8))
    init = jax.eval_shape(
        Generator(config).init,
        jax.random.key(0),
        make_scene(np.zeros((1, 8, 2))),
        np.zeros(2),
        alpha,
    )
    assert jax.tree.map(np.shape, params) == jax.tree.map(np.shape, init["params"])


@EACH
def test_the_unused_pooling_is_ignored_and_written_as_zeros(config):
    state = random_state(config)
    unused = {name for name in state if name.startswith("pool_net_d.")}
    without = {name: array for name, array in state.items() if name not in unused}
    wrong = {**without, "pool_net_d.mlp_pre_pool.2.bias": "anything"}
    written = [
        params_to_torch(params_from_torch(given, config), config)
        for given in (state, without, wrong)
    ]
    for again in written:
        assert again.keys() == state.keys()
        for name, array in again.items():
            assert_array_equal(array, 0 * state[name] if name in unused else state[name])


def test_golden_state_dicts_fit(shared):
    rows = json.loads((shared / "golden/torch/manifest.json").read_text())
    rows = [row for row in rows if row.get("model") == "neurosym"]
    assert len(rows) == 5
    for row in rows:
        with np.load(shared / "golden/torch" / row["file"]) as arrays:
            state = {k[8:]: arrays[k] for k in arrays.files if k.startswith("g_state/")}
        config = generator_of(row)
        again = params_to_torch(params_from_torch(state, config), config)
        assert again.keys() == state.keys()
        for name, array in again.items():
            assert array.shape == state[name].shape
            assert name.startswith("pool_net_d.") or np.array_equal(array, state[name])


def test_as_described_is_in_no_torch():
    described = dataclasses.replace(IJCNN, pooling="as_described,bottleneck_dim=5")
    state = random_state(IJCNN)
    for convert in (params_from_torch, params_to_torch):
        with pytest.raises(InputError, match="as_described has no counterpart in torch"):
            convert(state, described)


def test_as_described_is_not_exported(tmp_path):
    described = dataclasses.replace(IJCNN, pooling="as_described,bottleneck_dim=5")
    # Of the same shapes, and it would do something else.
    params = params_from_torch(random_state(IJCNN), IJCNN)
    with pytest.raises(InputError, match="as_described has no counterpart in torch"):
        export_torch_checkpoint(tmp_path / "a.pt", described, params)
    assert not (tmp_path / "a.pt").exists()


@EACH
def test_export_reads_back(tmp_path, config):
    params = params_from_torch(random_state(config), config)
    export_torch_checkpoint(tmp_path / "a.pt", config, params, scene="zara1")
    loaded = load_torch_checkpoint(tmp_path / "a.pt")
    assert loaded.config == config
    assert loaded.scene == "zara1"
    jax.tree.map(assert_array_equal, loaded.params, params)
    assert load_model(tmp_path / "a.pt").config == config


def test_a_released_file_says_neither_network_nor_weighting(tmp_path):
    for config in (ROS, IJCNN):
        path = tmp_path / f"{POOLINGS.name_of(config.pooling)}.pt"
        params = params_from_torch(random_state(config), config)
        export_torch_checkpoint(path, config, params)
        contents = read_torch_file(path)
        assert contents["args"]["pooling_type"] == "pool_net"
        contents["args"].pop("weighting", None)
        state = {name: np.asarray(tensor) for name, tensor in contents["g_state"].items()}
        write_torch_file(path, {**contents, "g_state": state}, overwrite=True)
        wanted = dataclasses.replace(config, weighting="cnd_shipped") if config is ROS else config
        assert load_torch_checkpoint(path).config == wanted
        if config is ROS:
            wrong = {**contents, "g_state": state}
            wrong["args"] = {**contents["args"], "weighting": "cdn"}
            write_torch_file(path, wrong, overwrite=True)
            with pytest.raises(InputError, match="unknown weighting 'cdn'"):
                load_torch_checkpoint(path)


def test_learned_weights_have_no_place_in_torch(tmp_path):
    learned = dataclasses.replace(ROS, weighting="learned")
    params = params_from_torch(random_state(learned), learned)
    with pytest.raises(InputError, match="learned: no torch has them"):
        export_torch_checkpoint(tmp_path / "a.pt", learned, params)


def test_hidden_width_is_the_released_codes(tmp_path):
    narrow = dataclasses.replace(ROS, pooling="neurosym_ros,hidden_dim=64")
    params = params_from_torch(random_state(narrow), narrow)
    with pytest.raises(InputError, match="fixed at 512, not 64"):
        export_torch_checkpoint(tmp_path / "a.pt", narrow, params)


def test_rows_that_the_released_collation_picks():
    bounds = np.array([[0, 2], [2, 5]])
    rows = np.arange(13)[:, None] * np.ones(8)
    picked = alpha_rows_used(rows, bounds)
    assert [list(part[:, 0]) for part in picked] == [[0, 1], [2, 3, 4]]
    with pytest.raises(InputError, match="12 rows for 13 pairs"):
        alpha_rows_used(rows[1:], bounds)


# Parity


@pytest.fixture(scope="module")
def golden(shared):
    directory = shared / "golden" / "torch"
    if not directory.is_dir():
        pytest.skip(f"no golden cases at {directory}")
    return directory


def cases_of(golden, directory, prefix, change=None):
    """A directory with the golden cases of this name; `change` edits the arrays of each."""
    rows = json.loads((golden / "manifest.json").read_text())
    rows = [row for row in rows if row["file"].startswith(prefix)]
    for row in rows:
        with np.load(golden / row["file"]) as archive:
            arrays = dict(archive)
        np.savez(directory / row["file"], **(change(arrays) if change else arrays))
    (directory / "manifest.json").write_text(json.dumps(rows))
    return directory


@pytest.mark.parametrize("x64", [pytest.param(False, marks=pytest.mark.rounding), True])
def test_golden_cases_of_torch(golden, tmp_path, x64):
    with jax.enable_x64(x64):
        rows = run_parity(cases_of(golden, tmp_path, ("neurosym", "qtc")), 2e-7)
    assert all(row.ok for row in rows), format_parity(rows)
    found = {f"{row.case} {row.output}": row.max_abs for row in rows}
    exact = [
        *(f"qtc.npz {name}" for name in ("qtc_reference", "qtc_signed", "qtc_signed_q005")),
        "qtc.npz alpha_reference",
        *(f"neurosym_ijcnn_{case}.npz alpha_rows_used" for case in (0, 1)),
    ]
    assert [found.pop(name) for name in exact] == [0] * len(exact)
    # The table as printed; what remains is its float32.
    shipped = [f"neurosym_{name}.npz alpha" for name in ("ros_0", "ros_2", "ijcnn_1")]
    assert max(found.pop(name) for name in shipped) < 1e-9
    networks = ("ijcnn_0", "ijcnn_1", "ros_0", "ros_1", "ros_2")
    assert sorted(found) == [f"neurosym_{name}.npz pred_rel" for name in networks]


def altered(name, where, by):
    def change(arrays):
        array = arrays[name].copy()
        array[where] += by
        return {**arrays, name: array}

    return change


@pytest.mark.parametrize(
    ("case", "change", "missed"),
    [
        ("qtc", altered("qtc_signed", (3, 1, 2), 1), {"qtc_signed"}),
        ("qtc", altered("qtc_reference", (0, 0, 0), 1), {"qtc_reference"}),
        ("qtc", altered("alpha_reference", (0, 0), 0.01), {"alpha_reference"}),
        ("neurosym_ros_0", altered("alpha", (1, 3), 0.5), {"alpha", "pred_rel"}),
        ("neurosym_ros_0", altered("pred_rel", (4, 1, 0), 1e-3), {"pred_rel"}),
        ("neurosym_ijcnn_0", altered("alpha", (1, 3), 0.5), {"alpha_rows_used", "pred_rel"}),
        ("neurosym_ijcnn_0", altered("alpha", (30, 3), 0.5), set()),
        (
            "neurosym_ijcnn_0",
            altered("g_state/pool_net_g.mlp_pre_pool.0.bias", ..., 0.1),
            {"pred_rel"},
        ),
    ],
)
def test_a_difference_is_a_miss(golden, tmp_path, case, change, missed):
    rows = run_parity(cases_of(golden, tmp_path, case, change))
    assert {row.output for row in rows if not row.ok} == missed, format_parity(rows)


@pytest.mark.parametrize(
    ("case", "change", "message"),
    [
        ("qtc", lambda a: {**a, "k": a["k"][1:]}, r"'l' has the shape"),
        ("qtc", lambda a: {**a, "qtc_signed": a["qtc_signed"] * 1.0}, "qtc_signed.*whole numbers"),
        ("qtc", lambda a: {k: v for k, v in a.items() if k != "qtc_signed"}, "'qtc_signed' is mis"),
        ("neurosym_ros_0", lambda a: {**a, "alpha": a["alpha"][1:]}, r"'alpha' has the shape"),
        (
            "neurosym_ijcnn_1",
            lambda a: {k: v for k, v in a.items() if k != "alpha_rows_used"},
            "'alpha_rows_used' is missing",
        ),
    ],
)
def test_bad_cases(golden, tmp_path, case, change, message):
    with pytest.raises(InputError, match=message):
        run_parity(cases_of(golden, tmp_path, case, change))


def test_neurosym_pools_like_pool_net_only(golden, tmp_path):
    cases_of(golden, tmp_path, "neurosym_ros_1")
    path = tmp_path / "manifest.json"
    (row,) = json.loads(path.read_text())
    path.write_text(json.dumps([{**row, "pooling_type": "spool"}]))
    with pytest.raises(InputError, match="pooling_type is one of 'pool_net', not 'spool'"):
        run_parity(tmp_path)
