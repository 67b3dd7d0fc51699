"""The arms of the study: networks that differ in one thing, on every data set the same."""

import dataclasses
from typing import Any

import jax.numpy as jnp
from jax import Array

import examples.encounter_pooling  # noqa: F401 (registers it)
from neurosym_jax.models.anchors.network import AnchorConfig
from neurosym_jax.models.anchors.recipe import AnchorRecipe
from neurosym_jax.models.sgan.network import POOLINGS, GeneratorConfig
from neurosym_jax.models.sgan.training import RECIPES
from neurosym_jax.symbolic.qtc import encode_state, observe
from neurosym_jax.symbolic.weighting import WEIGHTINGS, register_weighting
from neurosym_jax.training.recipe import Recipe
from studies.weighting.control import LENGTHS, ON_ONES_PATH

__all__ = ["ARMS", "SETS", "Arm", "register"]

# No errors are added to positions: they would blur the symbols of what is learned from.
SHORT = dataclasses.replace(
    RECIPES["ours"],
    steps=600,
    batch_scenes=8,
    max_agents=16,
    best_k=10,
    rotate=0.5,
    jitter=0.0,
)
WHOLE = dataclasses.replace(SHORT, steps=1500, batch_scenes=16, max_agents=None)
ANCHORS = dataclasses.replace(AnchorRecipe(), steps=600, jitter=0.0, min_agents=2)


@dataclasses.dataclass(frozen=True)
class Arm:
    """A network, its training, and the number of seeds on each data set."""

    network: Any
    recipe: Recipe
    seeds: dict[str, int]


def _right(positions: Array, valid: Array) -> Array:
    """[N, N, T] 1 for who was last seen on one's path (see `control`), else 0."""
    codes = encode_state(observe(positions[:, None], positions))
    weights = jnp.asarray(ON_ONES_PATH)[codes]
    return jnp.concatenate([jnp.zeros_like(weights[..., :1]), weights], axis=-1)


def register() -> None:
    """Make the weighting of this study known by name; done again, it replaces itself."""
    register_weighting("on_ones_path", replace=True)(_right)


register()

CONTROLS = {"control_20": 0.2, "control_10": 0.1, "control_05": 0.05}
"""Simulations, and the strength of the reaction to others, of `control`'s full one."""
REAL = ("corridors", "zara2")
PLACES = ("eth", "hotel", "univ", "zara1")
"""Those of the protocol's fourth part, which a command has to name."""
TENTHS = ("corridors_tenth", "zara2_tenth")
SETS = (*CONTROLS, *REAL, *TENTHS)


def _generator(
    pooling: str, weighting: str | None, recipe: Recipe, **seeds: int
) -> Arm:
    network = GeneratorConfig(
        obs_len=LENGTHS[0],
        pred_len=LENGTHS[1],
        pooling=POOLINGS[pooling](),
        weighting=None if weighting is None else WEIGHTINGS[weighting](),
    )
    return Arm(network, recipe, seeds)


def _papers(weighting: str | None, seeds: int, pooling: str = "as_described") -> Arm:
    further = dict.fromkeys(
        PLACES, 4 if weighting in ("ones", "quantised", "shuffled") else 0
    )
    return _generator(
        pooling, weighting, WHOLE, corridors=seeds, zara2=seeds, **further
    )


def _anchors(geometry: bool, symbols: bool, tenths: int = 0) -> Arm:
    network = AnchorConfig(
        obs_len=LENGTHS[0], pred_len=LENGTHS[1], geometry=geometry, symbols=symbols
    )
    seeds = dict.fromkeys(REAL, 24) | dict.fromkeys(TENTHS, tenths)
    return Arm(network, ANCHORS, seeds)


WEAK = dict.fromkeys(CONTROLS, 12)

ARMS = {
    "encounter": _generator("encounter", "ones", SHORT, corridors=24, zara2=24, **WEAK),
    "encounter, quantised": _generator(
        "encounter", "quantised", SHORT, corridors=24, zara2=24
    ),
    "encounter, right": _generator("encounter", "on_ones_path", SHORT, **WEAK),
    "papers": _papers("ones", 24),
    "papers, quantised": _papers("quantised", 24),
    "papers, none": _papers(None, 8, "none"),
    "papers, cnd": _papers("cnd", 24),
    "papers, shuffled": _papers("shuffled", 24),
    "papers, learned": _papers("learned", 8),
    "anchors, nothing": _anchors(False, False),
    "anchors, symbols": _anchors(False, True),
    "anchors, geometry": _anchors(True, False, 12),
    "anchors, both": _anchors(True, True, 12),
}
"""By name. `papers` is SGAN with the pooling that the papers describe, `encounter` and `anchors`
see how neighbours move."""
