"""Recipes and networks by name, and changes to them."""

import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.models import AsDescribed, Social
from neurosym_jax.symbolic.state_weightings import Cnd, Learned
from neurosym_jax.training.network import model_name, named_network
from neurosym_jax.training.recipe import RECIPES, make_recipe


def test_recipes():
    assert make_recipe("ours") == RECIPES["ours"]
    changes = ("rotate=0.5", "max_agents=null", "label_real=[0.9, 1]", "schedule=cosine")
    changed = make_recipe("sgan", seed=3, steps=30, changes=changes)
    assert (changed.seed, changed.steps, changed.rotate, changed.max_agents) == (3, 30, 0.5, None)
    assert (changed.label_real, changed.schedule) == ((0.9, 1), "cosine")
    assert changed.learning_rate == RECIPES["sgan"].learning_rate
    for change, reason in (
        ("emma=0.9", "--set emma=0.9: must be NAME=VALUE"),
        ("ema=fast", "recipe ours: ema must be a finite number, not 'fast'"),
        ('discriminator={"kind": "big"}', "kind must be one of global, local, not 'big'"),
    ):
        with pytest.raises(InputError, match=reason):
            make_recipe("ours", changes=[change])


def test_networks():
    assert named_network(pred_len=12).pred_len == 12
    assert named_network(pooling="social").pooling == Social()
    symbolic = named_network("neurosym", weighting="learned,quantisation_factor=0.1")
    assert (symbolic.pooling, symbolic.weighting) == (
        AsDescribed(),
        Learned(quantisation_factor=0.1),
    )
    changed = named_network("neurosym", changes=["noise_type=uniform", "encoder_h_dim=48"])
    assert (changed.noise_type, changed.encoder_h_dim) == ("uniform", 48)
    assert (changed.pooling, changed.weighting) == (AsDescribed(), Cnd())


@pytest.mark.parametrize(
    ("named", "message"),
    [
        ({"weighting": "cnd"}, "--weighting cnd: sgan weights no pairs; neurosym does"),
        ({"pooling": "encounter"}, "--pooling encounter: sgan has none, pool_net, social"),
        ({"model": "neurosym", "pooling": "none"}, "--pooling none: neurosym has as_described"),
        ({"model": "neurosym", "weighting": "cdn"}, "weighting: unknown weighting 'cdn'"),
        ({"changes": ["noise_dim=99"]}, "network: noise_dim must lie in"),
        ({"changes": ["noise=uniform"]}, "--network noise=uniform: must be NAME=VALUE"),
    ],
)
def test_networks_that_cannot_be(named, message):
    with pytest.raises(InputError, match=message):
        named_network(**named)


def test_names():
    assert model_name(named_network(pooling="none")) == "sgan_none"
    coarse = named_network("neurosym", weighting="quantised,quantisation_factor=0.05")
    assert model_name(coarse) == "neurosym_as_described_quantised"
    assert model_name(named_network("neurosym", pooling="neurosym_ros")) == "neurosym_ros_cnd"
    anchors = named_network("anchors", changes=["hidden=32"], pred_len=12)
    assert model_name(anchors) == "anchors_hidden_32"
