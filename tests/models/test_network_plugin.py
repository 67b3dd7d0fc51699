"""One file of a plugin adds a pooling with an option and a recurrent cell."""

import json
from pathlib import Path
from unittest import mock

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.__main__ import main
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import predict
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.models import GeneratorConfig
from neurosym_jax.models.cell import CELLS, Encoder
from neurosym_jax.models.poolings import POOLINGS, pooling_names
from neurosym_jax.plugins import load_plugin
from neurosym_jax.training.network import named_network
from tests.networks import random_model

PLUGIN = str(Path(__file__).with_name("network_plugin.py"))
WALKS = np.random.default_rng(0).normal(0, 0.3, (4, 8, 2)).cumsum(axis=1)


@pytest.fixture(scope="module", autouse=True)
def _plugin():
    with mock.patch.dict(POOLINGS), mock.patch.dict(CELLS):
        load_plugin(PLUGIN)
        yield


def run(*command):
    with pytest.raises(SystemExit) as end:
        main([*command, "--plugin", PLUGIN])
    assert not end.value.code


def test_they_are_trained_saved_loaded_and_evaluated(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    network = ("--network", "pooling=nearest", "pooling.temperature=0.5", "cell=gru")
    how = ("--steps", "1", "--set", "batch_scenes=2", "best_k=1", "max_agents=4")
    train = ("train", "--dataset", "cross-path", *network, *how, "--out", "run")
    evaluate = ("evaluate", "--checkpoint", "run/model", "--samples", "1", "--no-figures")
    run(*train)
    model = load_model("run/model")
    kind = {"kind": "nearest", "bottleneck_dim": 8, "temperature": 0.5}
    assert json.loads(Path("run/model/config.json").read_text())["config"]["pooling"] == kind
    assert POOLINGS.name_of(model.config.pooling) == "nearest"
    assert "pooling=nearest,temperature=0.5, cell=gru" in repr(model)
    run(*evaluate)
    assert model.name == "Nearest neighbours, GRU"
    assert model.name in capsys.readouterr().out


def test_what_is_refused():
    assert pooling_names(symbolic=False) == ("none", "pool_net", "social", "nearest")
    assert pooling_names(symbolic=True) == ("as_described", "neurosym_ros", "encounter")
    with pytest.raises(InputError, match="sgan has none, pool_net, social, nearest"):
        named_network(pooling="neurosym_ros")


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def literal_gru(part, hidden, step):
    """One step, as its authors write it (Cho et al., 2014; biases as in torch)."""
    embedding, params = part["spatial_embedding"], part["gru"]
    of_input = (step @ embedding["kernel"] + embedding["bias"]) @ params["input_kernel"]
    of_hidden = hidden @ params["recurrent_kernel"]
    (r, z, n), (hr, hz, hn) = (np.split(each, 3, axis=-1) for each in (of_input, of_hidden))
    br, bz, bn, bh = np.split(params["bias"], 4)
    r, z = sigmoid(r + hr + br), sigmoid(z + hz + bz)
    return z * hidden + (1 - z) * np.tanh(n + bn + r * (hn + bh))


def test_a_gru_is_folded_as_it_is_written():
    """Encoder and decoder, whose affine layers fold into the cell, against plain loops."""
    model = random_model(
        GeneratorConfig(pred_len=5, pooling="none", noise_dim=0, cell="gru"), std=0.4
    )
    params = model.params["params"]
    steps = np.diff(WALKS, axis=1, prepend=WALKS[:, :1]).astype("f4")
    hidden = np.zeros((4, 32))
    for step in np.moveaxis(steps, 1, 0):
        hidden = literal_gru(params["encoder"], hidden, step)
    encoder = Encoder(model.config.cell, 16, 32)
    assert_allclose(encoder.apply({"params": params["encoder"]}, steps), hidden, atol=1e-5)
    decoder, step, position, track = params["decoder"], steps[:, -1], WALKS[:, -1], []
    for _ in range(5):
        hidden = literal_gru(decoder, hidden, step)
        step = hidden @ decoder["hidden2pos"]["kernel"] + decoder["hidden2pos"]["bias"]
        position = position + step
        track.append(position)
    assert_allclose(predict(model, WALKS)[0], np.stack(track, axis=1), atol=1e-4)
    assert jax.tree.structure(params["encoder"]["gru"]).num_leaves == 3
