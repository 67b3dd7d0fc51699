"""Checkpoints of SGAN and NeuroSyM: names, shapes and arguments, read and written."""

import argparse
import dataclasses
from collections import OrderedDict, defaultdict

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.commands import convert
from neurosym_jax.errors import InputError
from neurosym_jax.interop.checkpoint import (
    export_torch_checkpoint,
    load_torch_checkpoint,
    model_from_torch,
    torch_contents,
)
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_jax.models.disk import load_model
from neurosym_jax.models.forecast import Model, predict
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.models.sgan.torch_names import params_from_torch, params_to_torch
from tests.networks import random_model

SMALL = GeneratorConfig(
    pooling="none",
    embedding_dim=2,
    encoder_h_dim=3,
    decoder_h_dim=4,
    mlp_dim=5,
    noise_dim=1,
)
SIZES = {
    "embedding_dim": 4,
    "encoder_h_dim": 6,
    "decoder_h_dim": 7,
    "mlp_dim": 9,
    "noise_dim": 2,
}
ROS = GeneratorConfig(
    pooling="neurosym_ros,bottleneck_dim=5", weighting="ones", **SIZES
)
IJCNN = GeneratorConfig(pooling="neurosym_ijcnn,bottleneck_dim=5", **SIZES)
CONFIGS = [
    SMALL,
    GeneratorConfig(),
    GeneratorConfig(pool_every_timestep=True, decoder_h_dim=40, embedding_dim=8),
    GeneratorConfig(
        pooling="social,grid_size=4,neighborhood_size=3.5", noise_type="uniform"
    ),
    GeneratorConfig(
        pooling="none", noise_dim=0, noise_mix_type="ped", pred_len=12, mlp_dim=64
    ),
    ROS,
    IJCNN,
]
DROP = object()


def model_of(config):
    return random_model(config, "eth")


def contents_of(config=SMALL, tensors=(), **arguments):
    """What a checkpoint file holds, with some of it changed; DROP removes one."""
    contents = torch_contents(model_of(config))
    changes = {"args": arguments, "g_state": dict(tensors)}
    changed = {}
    for part, values in contents.items():
        merged = {**values, **changes[part]}
        changed[part] = {name: x for name, x in merged.items() if x is not DROP}
    return changed


def assert_same(a, b):
    jax.tree.map(lambda x, y: assert_array_equal(x, y, strict=True), a, b)


@pytest.mark.parametrize("config", [ROS, IJCNN])
def test_neurosym_has_a_pooling_that_is_never_used(config):
    params = model_of(config).params["params"]
    state = params_to_torch(params, config)
    unused = {
        name: array for name, array in state.items() if name.startswith("pool_net_d.")
    }
    assert unused["pool_net_d.spatial_embedding.weight"].shape == (4, 2)
    assert unused["pool_net_d.mlp_pre_pool.0.weight"].shape == (512, 10)
    assert len(unused) == 6
    assert not any(array.any() for array in unused.values())
    other = {name: np.ones(7) for name in unused}
    assert_same(params_from_torch(state | other, config), params)


BIAS = "decoder.hidden2pos.bias"


def test_misfits_of_our_tree_are_named_our_way():
    params = model_of(SMALL).params["params"]
    del params["decoder"]["hidden2pos"]["bias"]
    with pytest.raises(InputError, match="'decoder/hidden2pos/bias' is missing"):
        params_to_torch(params, SMALL)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (BIAS, DROP, f"'{BIAS}' is missing, not (2,)"),
        ("encoder.encoder.bias_hh_l0", np.zeros(11, "f"), "is (11,), not (12,)"),
        (
            "pool_net_g.bias",
            np.zeros(1, "f"),
            "'pool_net_g.bias' is (1,), not expected",
        ),
        (BIAS, np.zeros(2, int), f"'{BIAS}' is not floating point"),
        (BIAS, np.full(2, np.inf, "f"), f"not finite: {BIAS}"),
        (BIAS, np.ndarray, f"'{BIAS}' is no tensor"),
        (1, np.zeros(2), "g_state is not a state dict"),
        (
            "mlp_decoder_context.1.running_mean",
            np.zeros(5, "f"),
            "our networks have no batch norm",
        ),
        ("obs_len", DROP, "obs_len is missing"),
        ("batch_norm", True, "batch_norm is True, and our networks have False only"),
        (
            "activation",
            "leakyrelu",
            "activation is 'leakyrelu', and our networks have 'relu' only",
        ),
        ("num_layers", 2, "num_layers is 2"),
        (
            "pooling_type",
            "attention",
            "one of 'none', 'pool_net', 'spool', not 'attention'",
        ),
        ("pooling_type", "pool_net", "'pool_net.spatial_embedding.bias' is missing"),
        ("pool_every_timestep", True, "needs a pooling"),
        ("pred_len", "12", "pred_len must be a whole number, not '12'"),
        ("noise_type", "cauchy", "one of gaussian, uniform, not 'cauchy'"),
        ("noise_dim", (1, 1), "noise_dim must be a whole number, not (1, 1)"),
        ("noise_dim", (2,), "'mlp_decoder_context.2.weight' is (3, 5), not (2, 5)"),
    ],
)
def test_tensors_and_arguments_that_do_not_fit(name, value, message):
    tensor = "." in str(name) or name == 1
    changed = (
        contents_of(tensors={name: value}) if tensor else contents_of(**{name: value})
    )
    with pytest.raises(InputError) as error:
        model_from_torch(changed)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("contents", "part"),
    [({"g_state": {}}, "args"), ({"args": {}}, "g_state"), ([], "g_state")],
)
def test_contents_that_are_no_checkpoint(contents, part):
    with pytest.raises(InputError, match=f"has no {part}: not a checkpoint of SGAN"):
        model_from_torch(contents)


@pytest.mark.parametrize(
    ("name", "value"),
    [("pooling_type", None), ("num_layers", DROP), ("noise_dim", 1), ("g_steps", 3)],
)
def test_arguments_that_change_no_network(name, value):
    assert model_from_torch(contents_of(**{name: value})).config == SMALL


def test_dropout_takes_a_number_in_a_perceptron():
    contents = contents_of(dropout=0.5)
    model = model_from_torch(contents)
    for name in ("weight", "bias"):
        tensor = contents["g_state"].pop(f"mlp_decoder_context.2.{name}")
        contents["g_state"][f"mlp_decoder_context.3.{name}"] = tensor
    assert_same(model_from_torch(contents).params, model.params)


def test_assumptions_are_stated(tmp_path, torch):
    assert model_from_torch(contents_of()).assumed == (
        "forward as in the released code",
    )
    contents = contents_of(activation=DROP, heads=4)
    with pytest.raises(
        InputError, match=r"unknown argument 'heads'.*--ignore-arg heads"
    ):
        model_from_torch(contents)
    assumed = model_from_torch(contents, ["heads"]).assumed
    assert assumed[1:] == (
        "activation relu",
        "the unknown argument heads changes nothing",
    )
    tensors = {k: torch.from_numpy(v) for k, v in contents["g_state"].items()}
    torch.save({**contents, "g_state": tensors}, tmp_path / "a.pt")
    with pytest.raises(InputError, match="--ignore-arg heads"):
        convert.run(tmp_path / "a.pt", tmp_path / "a")
    with pytest.raises(InputError, match="would lose args heads: --generator-only"):
        convert.run(tmp_path / "a.pt", tmp_path / "a", ignore_arg=("heads",))
    convert.run(
        tmp_path / "a.pt", tmp_path / "a", ignore_arg=("heads",), generator_only=True
    )
    assert "activation relu; the unknown" in (tmp_path / "a" / "README.md").read_text()


def test_a_released_file_says_neither_network_nor_weighting():
    ros = model_from_torch(contents_of(ROS, weighting=DROP))
    assert ros.config == dataclasses.replace(ROS, weighting="cnd_shipped")
    assert "pairs weighted by cnd_shipped" in ros.assumed
    assert model_from_torch(contents_of(IJCNN)).config == IJCNN
    with pytest.raises(InputError, match="unknown weighting 'cdn'"):
        model_from_torch(contents_of(ROS, weighting="cdn"))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (GeneratorConfig(pooling="pool_net,hidden_dim=64"), "fixed at 512, not 64"),
        (dataclasses.replace(ROS, weighting="learned"), "learned: no torch has them"),
        (
            dataclasses.replace(ROS, pooling="as_described"),
            "ones has no counterpart in torch",
        ),
        (dataclasses.replace(ROS, pool_every_timestep=True), "at observed steps only"),
    ],
)
def test_export_refuses_what_sgan_cannot_build(config, message):
    with pytest.raises(InputError, match=message):
        torch_contents(Model(config, {"params": {}}))


@pytest.mark.parametrize("config", CONFIGS)
def test_export_reads_back_and_opens_in_torch(tmp_path, torch, config):
    path, model = tmp_path / "a.pt", model_of(config)
    export_torch_checkpoint(path, model)
    stored = torch.load(path, weights_only=True)
    assert type(stored["g_state"]) is OrderedDict
    state = params_to_torch(model.params["params"], config)
    assert_same({k: v.numpy() for k, v in stored["g_state"].items()}, state)
    loaded = load_model(path)
    assert (loaded.config, loaded.dataset) == (config, "eth")
    assert_same(loaded.params, model.params)
    with pytest.raises(InputError, match=r"a\.pt: exists already"):
        export_torch_checkpoint(path, model)


def test_published_checkpoints_equal_torch_load(shared, torch):
    paths = sorted((shared / "checkpoints").glob("*/*.pt"))
    assert len(paths) == 20
    for path in paths:
        stored = torch.load(path, map_location="cpu", weights_only=True)
        loaded = load_torch_checkpoint(path)
        pooling = "pool_net" if path.parent.name == "sgan-p-models" else "none"
        pred_len = int(path.name.split("_")[1])
        assert loaded.config == GeneratorConfig(pooling=pooling, pred_len=pred_len)
        assert loaded.dataset == path.name.split("_")[0]
        assert loaded.assumed == ("forward as in the released code", "activation relu")
        state = params_to_torch(loaded.params["params"], loaded.config)
        assert_same({k: v.numpy() for k, v in stored["g_state"].items()}, state)


@pytest.mark.parametrize("zip_form", [False, True])
def test_training_checkpoint_written_by_torch(tmp_path, torch, zip_form):
    model = model_of(SMALL)
    state = params_to_torch(model.params["params"], SMALL)
    # As cuDNN leaves them: weights that are slices of one storage, at an offset.
    flat = torch.from_numpy(np.concatenate([array.ravel() for array in state.values()]))
    parts = flat.split([array.size for array in state.values()])
    tensors = {
        name: part.reshape(state[name].shape) for name, part in zip(state, parts)
    }
    name = "mlp_decoder_context.0.weight"
    tensors[name] = torch.from_numpy(state[name].T.copy()).double().T
    layer = torch.nn.Linear(2, 2)
    layer(torch.ones(2)).sum().backward()
    optimizer = torch.optim.Adam(layer.parameters())
    optimizer.step()
    contents = {
        "args": contents_of(d_type="local", encoder_h_dim_d=3)["args"],
        "G_losses": defaultdict(list, G=[0.5, 0.25]),
        "counters": {"t": 1, "epoch": None},
        "norm_g": [torch.tensor(1.0)],
        "g_state": OrderedDict(tensors),
        "g_best_state": layer.state_dict(),
        "g_optim_state": optimizer.state_dict(),
        "d_state": layer.state_dict(),
        "empty": torch.zeros(0, 3),
    }
    torch.save(contents, tmp_path / "a.pt", _use_new_zipfile_serialization=zip_form)
    loaded = load_torch_checkpoint(tmp_path / "a.pt")
    assert loaded.config == SMALL
    assert_same(loaded.params, model.params)
    lost = "would lose G_losses, counters, norm_g, g_best_state, g_optim_state, d_state, empty, "
    with pytest.raises(
        InputError, match=f"{lost}args d_type, args encoder_h_dim_d: --generator"
    ):
        convert.run(tmp_path / "a.pt", tmp_path / "a")
    assert not (tmp_path / "a").exists()
    # Without them it is the identity, there and back.
    convert.run(tmp_path / "a.pt", tmp_path / "a", generator_only=True)
    convert.run(tmp_path / "a", tmp_path / "b.pt")
    convert.run(tmp_path / "b.pt", tmp_path / "b")
    convert.run(tmp_path / "b", tmp_path / "c.pt")
    first, second = (read_torch_file(tmp_path / name) for name in ("b.pt", "c.pt"))
    assert first.keys() == second.keys()
    assert first["args"] == second["args"]
    for name, array in first["g_state"].items():
        assert_array_equal(array, second["g_state"][name], strict=True)
        assert_array_equal(array, state[name], strict=True)


def test_what_wrappers_and_newer_torch_add_is_read(tmp_path):
    """Prefixes of names, a namespace of arguments, and a number of numpy beside the weights."""
    torch = pytest.importorskip("torch")
    model = load_model("sgan_zara1_8")
    export_torch_checkpoint(tmp_path / "plain.pt", model)
    contents = torch.load(tmp_path / "plain.pt", weights_only=False)
    weights = contents["g_state"].items()
    variants = (
        {"g_state": {f"module._orig_mod.{name}": tensor for name, tensor in weights}},
        {"args": argparse.Namespace(**contents["args"])},
        {"best_ade": np.float64(0.31), "seed": np.int64(3)},
    )
    unknown = {"args": contents["args"] | {"attention": True}}
    torch.save(contents | unknown, tmp_path / "unknown.pt")
    with pytest.raises(InputError, match="unknown argument 'attention'"):
        load_model(tmp_path / "unknown.pt")
    past = np.cumsum(np.full((3, 8, 2), 0.3), axis=1) + np.arange(3)[:, None, None]
    expected = predict(model, past, samples=1)
    for variant in variants:
        torch.save(contents | variant, tmp_path / "wrapped.pt")
        result = predict(load_model(tmp_path / "wrapped.pt"), past, samples=1)
        assert_array_equal(result, expected)
