"""One file of a plugin adds a pooling with an option and a cell, which `test_generator` unfolds."""

import json
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax import predict
from neurosym_jax.__main__ import main
from neurosym_jax.errors import InputError
from neurosym_jax.models.disk import load_model
from neurosym_jax.models.sgan.network import POOLINGS
from neurosym_jax.plugins import load_plugin
from neurosym_jax.training.run import make_config
from tests.networks import random_model

PLUGIN = str(Path(__file__).with_name("network_plugin.py"))


@pytest.fixture(scope="module", autouse=True)
def _plugin():
    load_plugin(PLUGIN)


def run(*command):
    with pytest.raises(SystemExit) as end:
        main([*command, "--plugin", PLUGIN])
    assert not end.value.code


@pytest.mark.slow
def test_a_pooling_and_a_cell_are_trained_saved_loaded_and_evaluated(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    network = ("--network", "pooling=nearest", "pooling.temperature=0.5", "cell=rnn")
    sizes = ("--steps", "1", "--set", "batch_scenes=2", "best_k=1", "max_agents=4")
    train = ("train", "--dataset", "cross-path", *network, *sizes, "--out", "run")
    evaluate = (
        "evaluate",
        "--model",
        "run/model",
        "--samples",
        "1",
        "--no-figures",
    )
    evaluate += ("--dataset", "cross-path", "--baselines", "constant_velocity")
    run(*train)
    model = load_model("run/model")
    kind = {"kind": "nearest", "bottleneck_dim": 8, "temperature": 0.5}
    assert (
        json.loads(Path("run/model/config.json").read_text())["config"]["pooling"]
        == kind
    )
    assert POOLINGS.name_of(model.config.pooling) == "nearest"
    assert "pooling=nearest,temperature=0.5, cell=rnn" in repr(model)
    run(*evaluate)
    assert model.name == "Nearest neighbours, RNN"
    assert model.name in capsys.readouterr().out


def test_what_is_refused():
    with pytest.raises(
        InputError, match="'sgan': pooling=neurosym_ros makes it 'neurosym'"
    ):
        make_config(changes=["pooling=neurosym_ros"])
    with pytest.raises(InputError, match="pooling 'nearest' has no symbols"):
        make_config("neurosym", changes=["pooling=nearest"])


def test_the_example_pools_neighbours():
    """Encounter pooling, a plugin in `examples`."""
    load_plugin(str(Path(__file__).parents[2] / "examples" / "encounter_pooling.py"))
    config = make_config("neurosym", changes=["pooling=encounter", "weighting=ones"])
    model, walks = random_model(config, std=0.5), np.zeros((2, 8, 2))
    walks[..., 0] = 0.3 * np.arange(8)
    walks[1, :, 1] = 1.0
    forecast, alone = (
        predict(model, people, samples=2) for people in (walks, walks[:1])
    )
    assert np.abs(forecast[:, :1] - alone).max() > 1e-3
