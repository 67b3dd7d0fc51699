"""Anchors: k joint forecasts of a scene, each a residual to constant velocity.

Every person has a frame of their own heading, in which residuals are scaled by their
speed. The heading fades with the speed, so that tracking noise does not turn the frame
of a person who stands; a second set of anchors is for standing people. Sample i of all
people is one joint forecast.

The anchor table has the same k residuals for everybody, 961 numbers for 20 samples of
12 steps: a network that does not beat it has learned nothing from the scene but the
speed. The anchors network learns residuals and the probability of each sample from a
person's own track, from neighbours within `radius`, seen by attention, and from the
number of people within 20 m.

The samples cover what a scene may do. The distribution is another output: equally
probable points of each person, trained by that person's energy score, from which
`draws` makes scenes.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jax import Array

from neurosym_jax.models.anchors.config import (
    SLOW,
    AnchorConfig,
    AnchorForecast,
    AnchorTableConfig,
    attend,
    computed_once,
    heading_of,
    length,
)
from neurosym_jax.models.tracking_errors import (
    Repair,
    expansion_of,
    limit_displacement,
    repair_tracks,
    unknown_motion,
)
from neurosym_jax.scene import turned

__all__ = [
    "AnchorConfig",
    "AnchorForecast",
    "AnchorNetwork",
    "AnchorTable",
    "AnchorTableConfig",
]

POINT_DIM = 24
"""The hidden layer of the points: they are many, and a model that ships is to stay small."""
HEADS, PAIR_DIM, MESSAGE_DIM = 4, 32, 16
"""The attention's heads, its hidden layer, and what a person learns from all neighbours."""
BASIS = 5
"""Polynomials of time that a residual is composed of."""
BENDS = np.where(np.arange(BASIS) == 0, 1, 0.1)[:, None]
"""Initial sizes of their coefficients: anchors are almost straight."""
PLANES = (3, 2, 0, 1)
"""`[k, N, T, 2]` with these axes is `[2, T, k, N]`: a CPU computes rows of N, and not of two."""
WIDE = (None, None, None)
"""Index by which `[N]` is `[1, 1, 1, N]`."""
ROUGHNESS = 0.003
"""Differences of a track below this are all alike, metres."""


class AnchorTable(nn.Module):
    """Fixed offsets in each person's frame, scaled by the speed, and further ones for the still."""

    config: AnchorTableConfig

    @nn.compact
    def __call__(
        self, observed: Array, *_: Any, seen: Array | None = None
    ) -> AnchorForecast:
        """Equally probable samples, without points.

        Only `observed [N, obs_len, 2]` and `seen` are used, not the other arguments of
        `AnchorNetwork`.
        """
        config = self.config
        steps = config.pred_len
        repair = _repair(observed, seen, config.period)
        observed = repair.tracks
        expansion = expansion_of(jnp.diff(observed, axis=1), config.period)
        mix = self.param("mix", nn.initializers.constant(0.8), ())
        last = observed[:, -1]
        mean = (last - observed[:, -4]) / 3
        velocity = mix * (last - observed[:, -2]) + (1 - mix) * mean

        shape = (config.samples, steps, 2)
        number = np.arange(1, steps + 1, dtype=np.float32)
        time = number[:, None] / steps
        moving = self.param("moving", _anchors(0.25, time, 1), shape)[:, None]
        still_anchor = self.param("still", _anchors(0.1, time, 1), shape)[:, None]
        scale = (length(mean) * steps)[:, None, None]
        heading = heading_of(mean, SLOW * config.period)[:, None]
        in_own_frame = moving * scale[None] + still_anchor
        residual = turned(in_own_frame, heading[None], 1)

        planes = _straight_on(velocity, steps) + residual.transpose(PLANES)
        ahead = limit_displacement(planes, config.period, expansion)
        likely = jnp.full(config.samples, -np.log(config.samples), observed.dtype)
        forecast = _settled(ahead, observed, repair, config.period)
        return AnchorForecast(forecast, likely, forecast[:0])


class AnchorNetwork(nn.Module):
    """k joint forecasts of one scene, their log-probabilities, and points of each person."""

    config: AnchorConfig

    @nn.compact
    def __call__(
        self,
        observed: Array,
        valid: Array,
        alpha: Array | None = None,
        company: Array | float = 0.0,
        near: Array | None = None,
        seen: Array | None = None,
    ) -> AnchorForecast:
        """Forecast a scene.

        `observed` is [N, obs_len, 2] metres, `alpha [N, N]` the weight of j for i, None
        for 1, `near` and `seen` a scene's; `company` is the number of further people in
        training, counted and unseen.
        """
        config = self.config
        if self.is_initializing() and config.short:
            seen = jnp.ones(observed.shape[:2], bool)
        repair = computed_once(_repair(observed, seen, config.period))
        observed = repair.tracks
        steps = jnp.diff(observed, axis=1)
        # A network that learned from people who walk sees a cyclist's motion scaled
        # down to theirs, and what it says of it is scaled up again.
        expansion = expansion_of(steps, config.period)
        steps = steps / expansion[:, None, None]
        velocity, roughness = self.velocity(steps, seen)
        speed = length(velocity)
        heading = heading_of(velocity, SLOW * config.period)
        walking = jnp.square(heading).sum(-1)
        per_person = velocity, speed, heading, walking, expansion
        velocity, speed, heading, walking, expansion = computed_once(per_person)
        own = self._own(steps, speed, heading, walking, roughness)
        state = self._units("own", own, seen, with_mask=True)
        if config.interacts:
            # Not the true velocity: of whom a network never saw, others would go astray.
            pairs, gate, crowd = config.pair_features(
                observed, velocity, heading, valid, near
            )
            pairs, gate, crowd = computed_once((pairs, gate, crowd))
            if alpha is not None:
                gate = gate * jnp.maximum(alpha, 0)
            people = jnp.log1p(crowd + company)[:, None]
            state = jnp.concatenate([state, self._attended(pairs, gate), people], -1)
        state = self._units("state", state, seen)

        curves = functools.partial(
            self._curves, speed=speed, heading=heading, walking=walking
        )
        residual = curves(state, config.samples)
        if config.points:
            hidden = nn.relu(_dense(POINT_DIM, "point_hidden")(state))
            points = curves(hidden, config.points, "point_")
            residual = jnp.concatenate([residual, points], 2)
        velocity = velocity * expansion[:, None]
        planes = _straight_on(velocity, config.pred_len) + residual * expansion[WIDE]
        ahead = limit_displacement(planes, config.period, expansion)
        k, period = config.samples, config.period
        samples = _settled(ahead[:, :, :k], observed, repair, period)
        points = _settled(ahead[:, :, k:], observed, repair, period)
        return AnchorForecast(samples, self._log_probability(state, valid), points)

    def _own(
        self,
        steps: Array,
        speed: Array,
        heading: Array,
        walking: Array,
        roughness: Array,
    ) -> Array:
        """[N, F] features of each person's own track, of which the steps are turned.

        Of each person: `steps [N, T, 2]` and `speed [N]` in metres a step, `heading
        [N, 2]` and its squared length `walking [N]`, `roughness [N, R]`.
        """
        hertz = 1 / self.config.period
        past = turned(steps, heading[:, None], -1)
        speeds = jnp.stack([hertz * speed, jnp.square(hertz * speed), walking], -1)
        features = [
            hertz * past.reshape(past.shape[0], -1),
            hertz * length(steps),
            speeds,
            roughness,
        ]
        return jnp.concatenate(features, -1)

    def _attended(self, pairs: Array, gate: Array) -> Array:
        """[N, units] what each person learns of the others: see `AnchorConfig.pair_features`."""
        pairs = nn.relu(_dense(PAIR_DIM, "pair")(pairs))
        # Two layers as one: their kernels are small, and pairs many.
        message = _Layer(MESSAGE_DIM, name="message")(PAIR_DIM)
        score = _Layer(HEADS, 0.5, name="score")(PAIR_DIM)
        kernel, bias = jax.tree.map(
            lambda *parts: jnp.concatenate(parts, -1), message, score
        )
        both = pairs @ kernel + bias[None, None]
        return attend(both[..., MESSAGE_DIM:], both[..., :MESSAGE_DIM], gate)

    def _log_probability(self, state: Array, valid: Array) -> Array:
        """[k] of the samples, by the votes of all people, `state [N, units]` of each."""
        count = self.config.samples
        score = _dense(count, "likely", 0.01)(state)
        score = jnp.where(valid[:, None], score, 0)
        score = score.sum(0) / jnp.sqrt(jnp.maximum(valid.sum(), 1))
        score = self.param("prior", nn.initializers.zeros, (count,)) + score
        return nn.log_softmax(score)

    def _units(
        self,
        name: str,
        values: Array,
        seen: Array | None,
        with_mask: bool = False,
    ) -> Array:
        """[N, hidden] units of `values [N, F]`, by a layer of their own where steps are missing.

        That layer, too, knows which ones are, `with_mask`.
        """
        units = nn.relu(_dense(self.config.hidden, name)(values))
        if seen is None or not self.config.short:
            return units
        if with_mask:
            values = jnp.concatenate([values, (~seen).astype(values.dtype)], -1)
        short = nn.relu(_dense(self.config.hidden, f"short_{name}")(values))
        return jnp.where(seen.all(1)[:, None], units, short)

    def _curves(
        self,
        state: Array,
        count: int,
        prefix: str = "",
        *,
        speed: Array,
        heading: Array,
        walking: Array,
    ) -> Array:
        """[2, pred_len, count, N] residuals to constant velocity, metres.

        `prefix` begins the names of the parameters. Of each person: `state [N, units]`,
        `speed [N]` in metres a step, `heading [N, 2]` and its squared length `walking
        [N]`.
        """
        config = self.config
        shape = (count, BASIS, 2)
        anchor = self.param(f"{prefix}anchor", _anchors(0.25, BENDS, BASIS), shape)
        still_anchor = self.param(f"{prefix}still", _anchors(0.1, BENDS, BASIS), shape)
        bend = _dense(count * BASIS * 2, f"{prefix}bend", 0.01)(state)
        bend = bend.reshape(-1, *shape)
        spread = _dense(count, f"{prefix}spread", 0.01)(state)
        spread = jnp.exp(jnp.clip(spread, -4, 4)).T[None, None]
        scale = (speed * config.pred_len + 0.5)[WIDE]
        # A person who stands is the less certain the longer the horizon: by 1 in 2.4 s.
        horizon = config.pred_len * config.period / 2.4
        stillness = 1 - jnp.sqrt(walking + 1e-6)
        standing = (stillness * horizon)[WIDE]

        curve = jnp.asarray(_polynomials(config.pred_len, BASIS), state.dtype)
        bend = jnp.einsum("tb,nkbc->ctkn", curve, bend)
        anchor = jnp.einsum("tb,kbc->ctk", curve, anchor)[..., None]
        still_anchor = jnp.einsum("tb,kbc->ctk", curve, still_anchor)[..., None]
        residual = scale * (bend + spread * anchor)
        cos, sin = heading.T[:, None, None, None]
        x, y = residual
        across = jnp.stack([-y, x])
        residual = cos * residual + sin * across
        return residual + standing * spread * still_anchor

    def velocity(self, steps: Array, seen: Array | None = None) -> tuple[Array, Array]:
        """Velocity `[N, 2]` in metres a step, and the log differences that it depends on `[N, F]`.

        The velocity is a weighted mean of the observed steps. The weights are learned
        functions of a track's roughness: the last step is best on smooth tracks (univ),
        a mean of several on noisy ones (hotel). Steps from or to a position that was not
        `seen [N, obs_len]` have no weight, unless there is no other.
        """
        differences = (jnp.diff(steps, axis=1), jnp.diff(steps, n=2, axis=1), steps)
        logs = [jnp.log(length(vector) + ROUGHNESS) for vector in differences]
        roughness = jnp.concatenate(logs, -1) / 2 + 1.5
        count = steps.shape[1]
        hidden = nn.relu(nn.Dense(16, name="rough")(roughness))
        recent = np.arange(count, dtype=np.float32)
        score = recent[None] + nn.Dense(count, name="smooth")(hidden)
        if seen is not None:
            is_seen = seen[:, 1:] & seen[:, :-1]
            score = jnp.where(is_seen, score, score - 1e4)
        weight = nn.softmax(score)
        velocity = (weight[..., None] * steps).sum(1)
        return velocity, roughness


def _repair(observed: Array, seen: Array | None, period: float) -> Repair:
    """See `repair_tracks`; of somebody who was not `seen [N, obs_len]` twice, nothing is known."""
    repair = repair_tracks(observed, period)
    if seen is None:
        return repair
    is_unknown = seen.sum(1) < 2
    return repair._replace(lost=repair.lost | is_unknown)


def _polynomials(steps: int, count: int) -> np.ndarray:
    """`[steps, count]` orthogonal polynomials of time, 0 at time 0; the first is a line up to 1."""
    time = np.arange(1, steps + 1) / steps
    powers = time[:, None] ** np.arange(1, count + 1)
    basis, upper = np.linalg.qr(powers, mode="reduced")
    sign = np.sign(np.diag(upper))
    basis = basis * sign * np.sqrt((time**2).sum())
    missing = count - basis.shape[1]
    return np.pad(basis, [(0, 0), (0, missing)])


def _straight_on(velocity: Array, steps: int) -> Array:
    """`[2, steps, 1, N]` from the last position at a `velocity [N, 2]` in metres a step."""
    ahead = jnp.arange(1, steps + 1, dtype=velocity.dtype)[:, None, None]
    return velocity.T[:, None, None] * ahead[None]


def _settled(ahead: Array, observed: Array, repair: Repair, period: float) -> Array:
    """[k, N, T, 2] positions, of displacements `ahead [2, T, k, N]`; see `settle`."""
    unknown = unknown_motion(ahead.shape[2], ahead.shape[1], period)
    unknown = jnp.asarray(unknown.transpose(2, 1, 0), ahead.dtype)
    ahead = jnp.where(repair.lost[WIDE], unknown[..., None], ahead)
    start = observed[:, -1] + repair.offset
    positions = start.T[:, None, None] + ahead
    return positions.transpose(2, 3, 1, 0)


class _Layer(nn.Module):
    """Kernel [inputs, features] and bias [features] of an affine layer, see `_dense`."""

    features: int
    scale: float = 2.0

    @nn.compact
    def __call__(self, inputs: int) -> tuple[Array, Array]:
        normal = nn.initializers.variance_scaling(self.scale, "fan_in", "normal")
        kernel = self.param("kernel", normal, (inputs, self.features))
        zeros = nn.initializers.zeros
        return kernel, self.param("bias", zeros, (self.features,))


def _dense(features: int, name: str, scale: float = 2.0) -> nn.Dense:
    """Affine layer whose kernel has the variance `scale` / inputs."""
    normal = nn.initializers.variance_scaling(scale, "fan_in", "normal")
    return nn.Dense(features, name=name, kernel_init=normal)


def _anchors(
    scale: float, weights: np.ndarray, draws: int
) -> nn.initializers.Initializer:
    """Initialiser of `[k, S, 2]`: `draws` normal numbers (S or 1) by `weights [S, 1]`; first 0."""

    def initialise(key, shape, dtype=jnp.float32):
        normal = nn.initializers.normal(1.0)
        drawn = scale * normal(key, (shape[0], draws, 2), dtype)
        anchors = drawn * weights[None].astype(dtype)
        return anchors.at[0].set(0.0)

    return initialise
