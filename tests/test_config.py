import dataclasses
import json
from typing import Any

import pytest

from neurosym_jax.configuration import changed, from_json, to_json
from neurosym_jax.errors import InputError
from neurosym_jax.models import LSTM, PoolNet, Social
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.symbolic.state_weightings import Cnd, Soft
from neurosym_jax.training.recipe import RECIPES, TrainConfig


@pytest.mark.parametrize(
    "config",
    [
        GeneratorConfig(),
        GeneratorConfig(pooling="social,neighborhood_size=3", pool_every_timestep=True),
        GeneratorConfig(pooling="neurosym_ros", weighting=Soft(learned=True)),
        DiscriminatorConfig(kind="local"),
        *RECIPES.values(),
    ],
)
def test_json_round_trip(config):
    data = to_json(config)
    assert from_json(type(config), data) == config
    assert from_json(type(config), json.dumps(data)) == config


def test_a_component_can_be_given_by_its_text():
    assert GeneratorConfig(pooling="pool_net,hidden_dim=3").pooling == PoolNet(hidden_dim=3)
    assert GeneratorConfig(pooling="as_described").weighting == Cnd()
    text: Any = "soft,temperature=0.05"
    own = GeneratorConfig(pooling="as_described", weighting=text)
    assert own.weighting == Soft(temperature=0.05)


def test_defaults_are_those_of_the_published_checkpoints():
    config = GeneratorConfig()
    sizes = (config.embedding_dim, config.encoder_h_dim, config.decoder_h_dim, config.mlp_dim)
    assert sizes == (16, 32, 32, 64)
    assert config.pooling == PoolNet(bottleneck_dim=8, hidden_dim=512)
    assert (config.cell, config.noise_dim) == (LSTM(), 8)
    assert (config.obs_len, config.pred_len, config.pool_every_timestep) == (8, 8, False)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 1}, "unknown field 'format'"),
        ({"poolling": "none"}, "unknown field 'poolling' for GeneratorConfig"),
        ({"pooling": "mean"}, "unknown pooling 'mean': there are none, pool_net, social"),
        ({"obs_len": 8.0}, "obs_len must be a whole number, not 8.0"),
        ({"obs_len": True}, "obs_len must be a whole number, not True"),
        ({"pool_every_timestep": 1}, "pool_every_timestep must be true or false, not 1"),
        ({"pooling": "social,neighborhood_size=NaN"}, "neighborhood_size must be a finite number"),
        ({"pooling": {"kind": "social", "grid_size": 0}}, "pooling: grid_size must be at least 1"),
        ({"pooling": {"grid_size": 1}}, "pooling: unknown pooling 'None'"),
        ({"pooling": {"kind": "none", "grid_size": 1}}, "unknown field 'grid_size' for NoPooling"),
        ({"pooling": 3}, "pooling must be a Pooling, not 3"),
        ({"cell": "gru"}, "unknown cell 'gru': there are lstm"),
        ({"period": 0}, "period must be positive"),
        ({"noise_dim": 32}, "noise_dim must lie in"),
        ({"pooling": "neurosym_ijcnn", "pool_every_timestep": True}, "needs a pooling other than"),
        ({"noise_mix_type": "each"}, "noise_mix_type must be one of global, ped, not 'each'"),
        ({"pooling": "none", "pool_every_timestep": True}, "needs a pooling other than 'none'"),
        ({"weighting": "ones"}, "has no symbols"),
    ],
)
def test_refused_with_the_name_of_its_source(change, message):
    with pytest.raises(InputError, match=message) as caught:
        from_json(GeneratorConfig, {**to_json(GeneratorConfig()), **change}, "model/config.json")
    assert str(caught.value).startswith("model/config.json: ")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": -1}, "seed must lie in"),
        ({"max_agents": 0}, "max_agents must be at least 1 or be null, not 0"),
        ({"warmup_steps": -1}, "warmup_steps must be at least 0, not -1"),
        ({"clip_norm": float("nan")}, "clip_norm must be a finite number, not nan"),
        ({"fde_weight": -0.5}, "fde_weight must be at least 0"),
        ({"learning_rate": -0.01}, "learning_rate must be positive, not -0.01"),
        ({"ema": 1.0}, r"ema must lie in \[0, 1\), not 1.0"),
        ({"scale": -0.1}, r"scale must lie in \[0, 1\)"),
        ({"label_real": (1.2, 0.7)}, r"label_real must be low, high, not \(1.2, 0.7\)"),
        ({"label_fake": 0.0}, "label_fake must be 2 finite numbers, not 0.0"),
        ({"schedule": "cosin"}, "schedule must be one of constant, cosine, not 'cosin'"),
        ({"rotate": 2.0}, r"rotate must lie in \[0, 1\], not 2.0"),
        ({"discriminator": {}}, "discriminator must be a DiscriminatorConfig, not {}"),
    ],
)
def test_recipes_that_would_fail_late(change, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(TrainConfig(), **change)


@pytest.mark.parametrize("text", ["{", "[1]", "null", "3", ""])
def test_not_an_object(text):
    with pytest.raises(InputError, match=r"^here: not "):
        from_json(GeneratorConfig, text, "here")


def test_changes_of_components():
    def made(*changes):
        return changed(GeneratorConfig(), changes, "--network", "network")

    assert made("pooling=social", "pooling.grid_size=5").pooling == Social(grid_size=5)
    assert made("pooling.hidden_dim=16").pooling == PoolNet(hidden_dim=16)
    assert made("pooling=encounter").weighting == Cnd()
    for change, message in (
        ("pooling.grid_size=5", "--network pooling.grid_size=5: must be NAME=VALUE, where NAME"),
        ("pooling.kind=social", "must be NAME=VALUE"),
        ("mlp_dim.x=1", "must be NAME=VALUE"),
        ("mlp_dim", "must be NAME=VALUE"),
        ("pooling=sociall", "network: unknown pooling 'sociall': did you mean 'social'"),
        ("pooling=encounter,bottleneck_dim=6", "bottleneck_dim must be a multiple of 4"),
        ("pooling.hidden_dim=0", "network: pooling: hidden_dim must be at least 1"),
    ):
        with pytest.raises(InputError, match=message):
            made(change)


def test_a_key_that_stands_twice_is_refused():
    with pytest.raises(InputError, match="here: the key 'obs_len' stands twice"):
        from_json(GeneratorConfig, '{"obs_len": 8, "obs_len": 9}', "here")
