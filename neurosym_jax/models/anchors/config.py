"""Configurations of the anchors network and of the anchor table, what both forecast, and the
features of neighbours that a configuration chooses.

These stand apart from the networks: a forecast by a kept program imports no Flax.
"""

import dataclasses
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.experimental.xla_metadata import set_xla_metadata

from neurosym_jax.configuration import Positive, Rule, Size
from neurosym_jax.errors import InputError
from neurosym_jax.models.forecaster import Lengths
from neurosym_jax.scene import turned
from neurosym_jax.symbolic.qtc import observe
from neurosym_jax.symbolic.weighting import WEIGHTINGS, Weighting

__all__ = [
    "SLOW",
    "AnchorConfig",
    "AnchorForecast",
    "AnchorTableConfig",
    "attend",
    "closest_approach",
    "heading_of",
    "length",
]


class AnchorForecast(NamedTuple):
    """The forecast of one scene of N people, metres."""

    samples: Array
    """[k, N, pred_len, 2] joint forecasts."""
    log_probability: Array
    """[k] of the samples."""
    points: Array
    """[P, N, pred_len, 2] equally probable forecasts of each person; P = 0 without any."""


@dataclasses.dataclass(frozen=True)
class AnchorTableConfig(Lengths):
    """Lengths and number of samples of an anchor table or network."""

    obs_len: Annotated[Size, Rule("be at least 4", lambda steps: steps >= 4)] = 8
    """Observed time steps."""
    samples: Size = 20
    """Number of joint forecasts, k."""


@dataclasses.dataclass(frozen=True)
class AnchorConfig(AnchorTableConfig):
    """Architecture of the anchors network."""

    points: Annotated[
        int, Rule("lie in [0, 65536]", lambda points: 0 <= points <= 65536)
    ] = 0
    """Number of equally probable forecasts of each person, of which the distribution consists; 0
    for none."""
    hidden: Size = 96
    """Units of a person's two hidden layers."""
    short: bool = False
    """Whether it learns from incomplete histories, too, and forecasts people seen for fewer steps
    than `obs_len`; it has further parameters for them."""
    radius: Positive = 10.0
    """Distance at which the attention to a neighbour has smoothly fallen to 0, metres; people are
    counted up to 20 m."""
    geometry: bool = True
    """Whether the attention sees neighbours' positions and velocities."""
    symbols: bool = False
    """Whether the attention sees the QTC_C1 symbols of a pair, now and 1.2 s ago at steps of 0.4 s.
    Without `geometry` and `symbols` people do not see each other."""
    weighting: Annotated[Weighting | None, WEIGHTINGS] = None
    """Weights of pairs, alpha, by which the attention is multiplied; None for 1."""

    def __post_init__(self):
        super().__post_init__()
        if self.weighting is not None and not self.interacts:
            raise InputError(
                "weighting: without geometry and symbols there are no pairs to weight"
            )

    @property
    def interacts(self) -> bool:
        """Whether people see each other."""
        return self.geometry or self.symbols

    def pair_features(
        self,
        observed: Array,
        velocity: Array,
        heading: Array,
        valid: Array,
        near: Array | None,
    ) -> tuple[Array, Array, Array]:
        """Features of j seen by i `[N, N, F]`, nearness `[N, N]` and number around `[N]`.

        With `near [N, C]`, j are these and the first two are `[N, C, ...]`. Features are
        the pair's bearing, motion, closest approach and speeds, its QTC_C1 symbols at two
        steps, or all of these; a subclass may add features.
        """
        position = observed[:, -1]
        number = jnp.arange(valid.shape[0])
        offset = position[near] - position[:, None]  # `near` of None adds an axis.
        distance = length(offset)
        features = []
        if self.geometry:
            pace = velocity / self.period
            features += _geometry(self.radius, offset, distance, pace, heading, near)
        if self.symbols:
            features += _symbols(observed, near, SLOW * self.period)
        others = valid[near] & valid[:, None] & (number[near] != number[:, None])
        stacked = jnp.where(others[..., None], jnp.stack(features, -1), 0)
        gate = jnp.where(others, _within(distance, self.radius), 0)
        if near is None:
            around = jnp.where(others, _within(distance, WIDE), 0)
            return stacked, gate, around.sum(1)
        return stacked, gate, _around(position, valid)


# What people see of their neighbours: vectors in the frame of a heading, features, attention.

SLOW = 0.125
"""Speed at which a heading has faded to 0.7, m/s; symbols take slower movement for none."""
WIDE = 20.0
"""Radius in which people are counted, metres."""
LONGEST = 5.0
"""Time within which the closest approach is searched, s."""


def heading_of(velocity: Array, slow: float) -> Array:
    """Direction of `velocity [..., 2]`, with length near 1 above the speed `slow` and 0 at rest.

    Tracking noise of a standing person gives a random direction; this one fades out
    instead.
    """
    return velocity / length(velocity, slow)[..., None]


def length(vector: Array, smooth: float = 1e-3) -> Array:
    """[...] length of `vector [..., 2]`, smooth below `smooth` metres so that 0 has a gradient."""
    return jnp.sqrt(square_length(vector) + smooth**2)


def square_length(vector: Array) -> Array:
    """[...] square length of `vector [..., 2]`; a sum over an axis of two is slow on a CPU."""
    return jnp.square(vector[..., 0]) + jnp.square(vector[..., 1])


def computed_once(values: Any) -> Any:
    """`values`, arrays, which a CPU computes once, and not again for all that depends on them.

    XLA repeats cheap arithmetic for each element of a larger array that it broadcasts
    to: that of a person for each sample and step.
    """
    with set_xla_metadata(inlineable="false"):
        return _held(values)


@jax.jit
def _held(values: Any) -> Any:
    return jax.lax.optimization_barrier(values)


def closest_approach(
    bearing: Array, motion: Array, slack: float, longest: float, smooth: float = 1e-3
) -> tuple[Array, Array]:
    """Time [...] from now to the closest approach, up to `longest`, and the distance [...] then.

    `bearing [..., 2]` is a relative position, `motion [..., 2]` its change in a unit of
    time; `slack` is added to the square of the motion, so that a pair at rest has the
    time 0.
    """
    square = square_length(motion) + slack
    product = bearing * motion
    soon = -(product[..., 0] + product[..., 1]) / square
    soon = jnp.clip(soon, 0, longest)
    offset = bearing + motion * soon[..., None]
    return soon, length(offset, smooth)


def _geometry(
    radius: float,
    offset: Array,
    distance: Array,
    pace: Array,
    heading: Array,
    near: Array | None,
) -> list[Array]:
    """Features `[N, N]` of where others are, how they move, and how near they will come.

    `offset [N, N, 2]` and `distance [N, N]` are to the others, `pace [N, 2]` is in m/s.
    """
    bearing = turned(offset, heading[:, None], -1)
    relative = pace[near] - pace[:, None]
    motion = turned(relative, heading[:, None], -1)
    soon, miss = closest_approach(bearing, motion, 0.05, LONGEST)
    close = 1 / jnp.maximum(distance, 1)
    speed = length(pace)
    other_speed = jnp.broadcast_to(speed[near], distance.shape)
    if near is None:
        # Equal to the other, which would change the last bits of a training.
        own_speed = other_speed.T
    else:
        own_speed = jnp.broadcast_to(speed[:, None], distance.shape)
    return [
        bearing[..., 0] * close,
        bearing[..., 1] * close,
        motion[..., 0],
        motion[..., 1],
        length(relative),
        jnp.exp(-distance),
        distance / radius,
        1 / (distance + 0.3),
        soon,
        jnp.exp(-2 * miss - soon),
        own_speed,
        other_speed,
    ]


def _symbols(observed: Array, near: Array | None, factor: float) -> list[Array]:
    """Features `[N, N]`: the QTC_C1 symbols of pairs at two steps, and their absolute values."""
    steps = observed.shape[1]
    features = []
    for end in (steps, max(steps - 3, 2)):
        own_track = observed[:, None, end - 2 : end]
        other_track = observed[near][..., end - 2 : end, :]
        states = observe(
            own_track,
            other_track,
            quantisation_factor=factor,
            side_quantisation_factor=factor,
        )
        state = states[..., 0, :].astype(observed.dtype)
        features.extend(jnp.moveaxis(state, -1, 0))
        features.extend(jnp.moveaxis(jnp.abs(state), -1, 0))
    return features


def attend(score: Array, value: Array, gate: Array) -> Array:
    """Attention with an empty slot, `sum_j g_ij exp(s_ij) v_ij / (1 + sum_j g_ij exp(s_ij))`.

    A softmax over neighbours alone would give a single neighbour the full weight at any
    distance. `score [N, N, HEADS]` and `value [N, N, M]`, an equal part for each head,
    give [N, M]; `gate [N, N]` is 0 for a neighbour that is not attended to.
    """
    weight = gate[..., None] * jnp.exp(jnp.clip(score, -8, 8))
    share = computed_once(weight / (1 + weight.sum(1, keepdims=True)))
    value = value.reshape(*share.shape, -1)
    sums = (share[..., None] * value).sum(1)
    return sums.reshape(gate.shape[0], -1)


def _around(position: Array, valid: Array) -> Array:
    """[N] the number of people around each; each is added for all others at once, in 4 N bytes."""
    x, y = position.T  # Apart, the loop runs in wide instructions: 25 times faster.

    def count(total: Array, other: Array) -> tuple[Array, None]:
        distance = jnp.hypot(x - x[other], y - y[other])
        return total + valid[other] * _within(distance, WIDE), None

    numbers = jnp.arange(valid.shape[0])
    start = jnp.full(valid.shape[0], -1, position.dtype)  # Nobody is around themselves.
    total, _ = jax.lax.scan(count, start, numbers, unroll=8)
    return jnp.maximum(total, 0)


def _within(distance: Array, radius: float) -> Array:
    """1 at distance 0, falling smoothly to 0 at `radius`."""
    share = jnp.square(distance / radius)
    return jnp.square(jnp.maximum(1 - share, 0))
