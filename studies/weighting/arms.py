"""The arms of the study: networks that differ in one thing, on every data set the same."""

import dataclasses

import jax.numpy as jnp
from jax import Array

from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.symbolic.cnd import alpha_from_states
from neurosym_jax.symbolic.qtc import observe
from neurosym_jax.symbolic.state_weightings import to_wrong_pairs
from neurosym_jax.symbolic.weightings import WEIGHTINGS, register_weighting
from neurosym_jax.training.recipe import RECIPES
from studies.weighting.control import LENGTHS, ON_ONES_PATH

__all__ = ["ARMS", "RECIPE", "SETS", "Arm", "register"]

RECIPE = dataclasses.replace(
    RECIPES["ours"],
    steps=600,
    batch_scenes=8,
    max_agents=16,
    best_k=10,
    rotate=0.5,
    jitter=0.0,
)
"""No errors are added to positions: they would blur the symbols of what is learned from."""


@dataclasses.dataclass(frozen=True)
class Arm:
    """A network, and how many seeds it is trained with on each data set."""

    generator: GeneratorConfig
    seeds: dict[str, int]
    about: str
    first: bool = False
    """Whether the answer rests on it."""


def _right(positions: Array, valid: Array) -> Array:
    """[N, N, T] 1 for who was last seen on one's path (see `control`), else 0."""
    return _from_first(alpha_from_states(observe(positions[:, None], positions), ON_ONES_PATH))


def _wrong(positions: Array, valid: Array) -> Array:
    """[N, N, T] the weights of `_right` with the wrong pairs, as `shuffled` has those of `cnd`."""
    right = alpha_from_states(observe(positions[:, None], positions), ON_ONES_PATH)
    return _from_first(to_wrong_pairs(right, positions[:, -1], valid))


def _from_first(observed: Array) -> Array:
    return jnp.concatenate([jnp.zeros_like(observed[..., :1]), observed], axis=-1)


def _constant(positions: Array, valid: Array) -> Array:
    """[N, N, T] 1/15, what `cnd` is of real tracks, but at the first step, too."""
    return jnp.full((len(positions), *positions.shape[:2]), 1 / 15, positions.dtype)


def register() -> None:
    """Make the weightings of this study known by name; done again, they replace themselves."""
    register_weighting("on_ones_path", replace=True)(_right)
    register_weighting("on_ones_path_wrong_pairs", replace=True)(_wrong)
    register_weighting("fifteenth", replace=True)(_constant)


register()


def _network(pooling: str, weighting: str | None = None) -> GeneratorConfig:
    return GeneratorConfig(
        obs_len=LENGTHS[0],
        pred_len=LENGTHS[1],
        pooling=POOLINGS[pooling](),
        weighting=None if weighting is None else WEIGHTINGS[weighting](),
    )


def _arm(about: str, seeds: tuple[int, int, int], *network: str, first: bool = False) -> Arm:
    return Arm(_network(*network), dict(zip(SETS, seeds)), about, first)


SETS = ("control", "corridors", "zara2")

ARMS = {
    "ones": _arm("encounter pooling", (4, 24, 24), "encounter", "ones", first=True),
    "quantised": _arm("symbols, 5 cm a step", (0, 24, 24), "encounter", "quantised", first=True),
    "shuffled": _arm("with the wrong pairs", (0, 24, 24), "encounter", "shuffled", first=True),
    "right": _arm("what people go by", (4, 0, 0), "encounter", "on_ones_path", first=True),
    "wrong": _arm(
        "with the wrong pairs", (4, 0, 0), "encounter", "on_ones_path_wrong_pairs", first=True
    ),
    "no pooling": _arm("nobody looks at anybody", (4, 4, 12), "none"),
    "SGAN": _arm("SGAN's pooling", (0, 4, 4), "pool_net"),
    "learned": _arm("81 weights, from `cnd`", (4, 4, 4), "encounter", "learned"),
    "NeuroSyM ones": _arm("the papers' pooling", (0, 4, 0), "as_described", "ones"),
    "NeuroSyM 1/15": _arm("a constant", (0, 4, 0), "as_described", "fifteenth"),
    "NeuroSyM quantised": _arm("symbols, 5 cm a step", (0, 4, 0), "as_described", "quantised"),
}
"""By name."""
