import dataclasses
import json
from typing import Any

import pytest

from neurosym_jax.configuration import changed, from_json, to_json
from neurosym_jax.errors import InputError
from neurosym_jax.models import AsDescribed, PoolNet, Social
from neurosym_jax.models.anchors.network import AnchorConfig
from neurosym_jax.models.forecaster import forecaster_of
from neurosym_jax.models.sgan.network import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.sgan.training import GeneratorRecipe
from neurosym_jax.symbolic.weighting import Cnd, Learned, Soft
from neurosym_jax.training.run import known_recipes, make_config, make_recipe


@pytest.mark.parametrize(
    "config",
    [
        GeneratorConfig(),
        GeneratorConfig(pooling="social,neighborhood_size=3", pool_every_timestep=True),
        GeneratorConfig(pooling="neurosym_ros", weighting=Soft(learned=True)),
        DiscriminatorConfig(kind="local"),
        *known_recipes().values(),
    ],
)
def test_json_round_trip(config):
    data = to_json(config)
    assert from_json(type(config), data) == config
    assert from_json(type(config), json.dumps(data)) == config


def test_a_component_can_be_given_by_its_text():
    assert GeneratorConfig(pooling="pool_net,hidden_dim=3").pooling == PoolNet(
        hidden_dim=3
    )
    text: Any = "soft,temperature=0.1"
    own = GeneratorConfig(pooling="as_described", weighting=text)
    assert own.weighting == Soft(temperature=0.1)


def network(change):
    """A generator's configuration from JSON, of which one field is another; or from a text."""
    data = (
        {**to_json(GeneratorConfig()), **change} if isinstance(change, dict) else change
    )
    return from_json(GeneratorConfig, data, "model/config.json")


def change_network(change):
    return changed(GeneratorConfig(), [change], "--network", "network")


def change_recipe(change):
    return make_recipe("ours", changes=[change])


def recipe(change):
    return dataclasses.replace(GeneratorRecipe(), **change)


def anchors(options):
    return AnchorConfig(**options)


NAMED = "model/config.json: "
REFUSED = [
    (
        network,
        {"poolling": "none"},
        f"{NAMED}unknown field 'poolling' for GeneratorConfig",
    ),
    (
        network,
        {"pooling": "mean"},
        "unknown pooling 'mean': there are none, pool_net, social",
    ),
    (network, {"obs_len": 8.0}, f"{NAMED}obs_len must be a whole number, not 8.0"),
    (network, {"obs_len": True}, "obs_len must be a whole number, not True"),
    (
        network,
        {"pool_every_timestep": 1},
        "pool_every_timestep must be true or false, not 1",
    ),
    (
        network,
        {"pooling": "social,neighborhood_size=NaN"},
        "neighborhood_size must be a finite",
    ),
    (
        network,
        {"pooling": {"kind": "social", "grid_size": 0}},
        "pooling: grid_size must lie",
    ),
    (network, {"pooling": {"grid_size": 1}}, f"{NAMED}pooling: unknown pooling 'None'"),
    (
        network,
        {"pooling": {"kind": "none", "grid_size": 1}},
        "field 'grid_size' for NoPooling",
    ),
    (network, {"pooling": 3}, "pooling must be a Pooling, not 3"),
    (network, {"period": 0}, "period must lie in"),
    (network, {"noise_dim": 32}, "noise_dim must lie in"),
    (
        network,
        {"noise_mix_type": "each"},
        "noise_mix_type must be one of global, ped, not 'each'",
    ),
    (
        network,
        {"pooling": "none", "pool_every_timestep": True},
        "needs a pooling other than 'none",
    ),
    (network, {"weighting": "ones"}, f"{NAMED}.*has no symbols"),
    *((network, text, f"{NAMED}not ") for text in ("{", "[1]", "null", "3", "")),
    (network, '{"obs_len": 8, "obs_len": 9}', f"{NAMED}the key 'obs_len' stands twice"),
    (recipe, {"seed": -1}, "seed must lie in"),
    (recipe, {"seed": None}, "seed must be a whole number, not None"),
    (recipe, {"max_agents": 0}, "max_agents must be at least 1 or be null, not 0"),
    (recipe, {"clip_norm": float("nan")}, "clip_norm must be a finite number, not nan"),
    (recipe, {"learning_rate": -0.01}, "learning_rate must be positive, not -0.01"),
    (recipe, {"ema": 1.0}, r"ema must lie in \[0, 1\), not 1.0"),
    (
        recipe,
        {"label_real": (1.2, 0.7)},
        r"label_real must be low, high, not \(1.2, 0.7\)",
    ),
    (recipe, {"label_fake": 0.0}, "label_fake must be 2 finite numbers, not 0.0"),
    (
        recipe,
        {"schedule": "cosin"},
        "schedule must be one of constant, cosine, not 'cosin'",
    ),
    (recipe, {"rotate": 2.0}, r"rotate must lie in \[0, 1\], not 2.0"),
    (
        recipe,
        {"discriminator": 3},
        "discriminator must be a DiscriminatorConfig, not 3",
    ),
    (anchors, {"obs_len": 3}, "obs_len must be at least 4"),
    (anchors, {"geometry": False, "weighting": "cnd"}, "no pairs to weight"),
    (anchors, {"samples": 0}, "samples must lie in"),
    (
        change_network,
        "pooling.grid_size=5",
        "--network pooling.grid_size=5: must be NAME",
    ),
    (change_network, "pooling.kind=social", "must be NAME=VALUE"),
    (change_network, "mlp_dim", "must be NAME=VALUE"),
    (
        change_network,
        "pooling=sociall",
        "network: unknown pooling 'sociall': did you mean",
    ),
    (change_network, "pooling=social,grid_size=0", "grid_size must lie in"),
    (change_recipe, ".ema=0.5", "must be NAME=VALUE"),
    (
        make_config,
        "sgam",
        "family must be one of sgan, neurosym, anchors, anchor_table, not",
    ),
    (make_recipe, "our", "recipe must be one of ours, sgan, anchors, not 'our'"),
    (change_recipe, "emma=0.9", "set emma=0.9: must be NAME=VALUE"),
    (change_recipe, "ema=fast", "recipe ours: ema must be a finite number, not 'fast'"),
    (
        change_recipe,
        'discriminator={"kind": "big"}',
        "kind must be one of global, local, not",
    ),
]


@pytest.mark.parametrize(("make", "given", "message"), REFUSED)
def test_refused(make, given, message):
    with pytest.raises(InputError, match=message):
        make(given)


def test_changes_of_components():
    def made(*changes):
        return changed(GeneratorConfig(), changes, "--network", "network")

    assert made("pooling=social", "pooling.grid_size=5").pooling == Social(grid_size=5)
    assert made("pooling.hidden_dim=16").pooling == PoolNet(hidden_dim=16)
    assert made("pooling=as_described").weighting == Cnd()


def test_recipes():
    assert make_recipe("ours") == known_recipes()["ours"]
    assert (
        make_recipe("sgan", changes=["discriminator.kind=local"]).discriminator.kind
        == "local"
    )
    changes = (
        "rotate=0.5",
        "max_agents=null",
        "label_real=[0.9, 1]",
        "schedule=cosine",
    )
    changed = make_recipe("sgan", seed=3, steps=30, changes=changes)
    assert (changed.seed, changed.steps, changed.rotate, changed.max_agents) == (
        3,
        30,
        0.5,
        None,
    )
    assert (changed.label_real, changed.schedule) == ((0.9, 1), "cosine")
    assert changed.learning_rate == known_recipes()["sgan"].learning_rate


def test_networks():
    assert make_config(pred_len=12).pred_len == 12
    assert make_config(changes=["pooling=social"]).pooling == Social()
    symbolic = make_config("neurosym", changes=["weighting=learned,speed=0.1"])
    assert (symbolic.pooling, symbolic.weighting) == (
        AsDescribed(),
        Learned(speed=0.1),
    )
    changed = make_config(
        "neurosym", changes=["noise_type=uniform", "encoder_h_dim=48"]
    )
    assert (changed.noise_type, changed.encoder_h_dim) == ("uniform", 48)
    assert (changed.pooling, changed.weighting) == (AsDescribed(), Cnd())


def test_names():
    def variant(model, *changes):
        return forecaster_of(make_config(model, pred_len=12, changes=changes)).variant

    assert variant("sgan", "pooling=none") == "sgan_none"
    coarse = variant("neurosym", "weighting=quantised,speed=0.125")
    assert coarse == "neurosym_as_described_quantised"
    assert variant("neurosym", "pooling=neurosym_ros") == "neurosym_ros_cnd"
    assert variant("anchors", "hidden=32") == "anchors_hidden_32"
    assert variant("anchor_table") == "anchor_table"
