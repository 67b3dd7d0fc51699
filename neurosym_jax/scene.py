"""The Scene: one moment of people who are present together, and the unit of every model function.

A Scene is a pytree, so `jax.vmap` adds a leading axis of scenes for a batch. It is not
a recording (see `data.tracks`) and not a data set (see `data.windows`).

Positions are centred and displacements taken in float64 on the host before the cast to
float32, so that map or UTM coordinates lose no precision. Both are rounded to 10 nm,
which removes the rounding of float64 far from the origin: a scene moved by thousands of
kilometres has the same numbers, and ties (a neighbour on a grid line, a person
standing) stay ties.
"""

import dataclasses
import functools
import zlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Self, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError, brief, refuse_masked

__all__ = [
    "WIDEST",
    "AnyArray",
    "Scene",
    "checked_positions",
    "displacements",
    "make_scene",
    "model_dtype",
    "origin_of",
]
__all__ += ["pad_scene", "relative_positions", "scene_identity", "to_world"]
__all__ += ["moves_of", "turned", "with_steps"]

DECIMALS = 8
"""Decimals of relative positions in metres; float64 resolves 1e-9 m at 5000 km from the origin."""
WIDEST = 400.0
"""Metres along a side of a scene up to which all agents are near its centre."""
FAR = 1e9
"""Largest coordinate in metres; float32 could not hold what is computed of far larger ones."""

AnyArray: TypeAlias = jax.Array | np.ndarray
"""numpy on the host, jax inside a model."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=(
        "observed",
        "displacement",
        "valid",
        "identity",
        "origin",
        "future",
        "near",
        "alpha",
        "seen",
        "extras",
    ),
    meta_fields=("period",),
)
@dataclasses.dataclass(frozen=True)
class Scene:
    """One moment of N agents. Every array may carry leading axes: a batch is a Scene too."""

    observed: AnyArray
    """[N, obs_len, 2] positions in metres, relative to `origin`."""
    displacement: AnyArray
    """[N, obs_len, 2] step from the previous position in metres; the first step is zero."""
    valid: AnyArray
    """[N] bool; False is padding and nothing else."""
    identity: AnyArray
    """[2] uint32 (recording digest, start frame); with a seed it determines the noise."""
    origin: AnyArray | None
    """[2] float64 metres, the centre in the caller's frame; None inside a model."""
    future: AnyArray | None = None
    """[N, pred_len, 2] positions in metres relative to `origin`, where known; None in a model."""
    seen: AnyArray | None = None
    """[N, obs_len] bool, False where a position in `observed` was filled in because nobody saw it;
    None where all were seen. See `models.histories`."""
    near: AnyArray | None = None
    """[N, C] slots of the neighbours that a forecaster sees, and an agent's own in what is left;
    None for all. See `Forecaster.prepared`."""
    period: float = 0.4
    """Seconds between steps; static, so programs are compiled for one period."""
    alpha: AnyArray | None = None
    """[N, N, obs_len] weights of j for i in place of a model's own; None for its own."""
    extras: Mapping[str, AnyArray] = dataclasses.field(default_factory=dict)
    """name: [N, ...] further numbers of each agent, zero in padding; for metrics, not models."""

    def replace(self, **changes: Any) -> Self:
        """The scene with other values in some fields."""
        return dataclasses.replace(self, **changes)

    @property
    def known_future(self) -> AnyArray:
        """`future` of a scene that has one."""
        assert self.future is not None
        return self.future

    def bare(self) -> Self:
        """The scene as forecasters see it: without future, origin and extras."""
        return self.replace(future=None, origin=None, extras={})


def scene_identity(recording: str, frame: int | np.ndarray) -> np.ndarray:
    """[..., 2] uint32 that identifies scenes, however they are batched or ordered.

    `frame [...]` is the index of a scene's first step among the steps of its recording,
    not the number in the file.

    Raises:
        InputError: for a recording that is not text or a frame that is not a whole
            number.
    """
    if not isinstance(recording, str):
        raise InputError(f"recording must be text, not {brief(recording)}")
    if np.asarray(frame).dtype.kind not in "iu":
        raise InputError(f"frame must be a whole number, not {brief(frame)}")
    digest = np.full(np.shape(frame), zlib.crc32(recording.encode()))
    return np.stack([digest, np.asarray(frame) % 2**32], axis=-1).astype(np.uint32)


def make_scene(
    observed: ArrayLike,
    future: ArrayLike | None = None,
    *,
    recording: str = "",
    frame: int = 0,
    period: float = 0.4,
    extras: Mapping[str, ArrayLike] = MappingProxyType({}),
) -> Scene:
    """A scene from world positions [N, obs_len, 2] and, where known, [N, pred_len, 2], metres.

    Under `jax.jit`, `jax.vmap` or `jax.grad` nothing is checked or rounded, and the
    precision is that of `observed`: subtract an origin from map coordinates first. The
    name of the `recording` and the index `frame` of the first step in it are the
    scene's identity. Steps are `period` seconds apart.

    Raises:
        InputError: for a wrong shape or a coordinate that is not finite.
    """
    if isinstance(observed, Tracer) or isinstance(future, Tracer):
        scene = _traced_scene(
            observed, future, scene_identity(recording, frame), extras
        )
        return scene.replace(period=period)
    observed = checked_positions("observed", observed)
    origin = origin_of(observed[:, -1])
    dtype = model_dtype()
    if future is not None:
        future = checked_positions("future", future)
        if len(future) != len(observed):
            raise InputError(
                f"future has {len(future)} agents but observed has {len(observed)}"
            )
        future = relative_positions(future, origin).astype(dtype)
    refuse_masked(extras)
    others = {name: np.asarray(values) for name, values in extras.items()}
    for name, values in others.items():
        if values.shape[:1] != observed.shape[:1]:
            raise InputError(
                f"{name} has {list(values.shape)}, not one for {len(observed)} agents"
            )
    return Scene(
        observed=relative_positions(observed, origin).astype(dtype),
        displacement=displacements(observed).astype(dtype),
        valid=np.ones(len(observed), bool),
        identity=scene_identity(recording, frame),
        origin=origin,
        future=future,
        period=period,
        extras=others,
    )


def _traced_scene(
    observed: Any, future: Any, identity: np.ndarray, extras: Mapping
) -> Scene:
    observed = jnp.asarray(observed)
    origin = jax.lax.stop_gradient(centre(observed[:, -1]))
    return Scene(
        observed=observed - origin[None, None],
        displacement=moves_of(observed),
        # Not len(): an export's N is a symbol.
        valid=jnp.ones(observed.shape[0], bool),
        identity=identity,
        origin=origin,
        future=None if future is None else future - origin[None, None],
        extras={name: jnp.asarray(values) for name, values in extras.items()},
    )


def model_dtype() -> np.dtype:
    """float32, or float64 where jax runs with x64 enabled."""
    return np.dtype(jnp.result_type(float))


def centre(positions: Any) -> Any:
    """Centre of the bounding box of `positions [N, 2]`, which no order of the agents changes."""
    return (positions.min(axis=0) + positions.max(axis=0)) / 2


def origin_of(positions: np.ndarray) -> np.ndarray:
    """Origin [2] of a scene whose agents are last seen at `positions [N, 2]` metres.

    It is their `centre`. In a scene wider than `WIDEST` it is the agent in the middle:
    float32 loses what is far from the origin, and one agent at a wrong place would
    take the others' decimals.
    """
    if np.ptp(positions, axis=0).max() <= WIDEST:
        return centre(positions)
    offset = positions - np.median(positions, axis=0)
    return positions[np.square(offset).sum(axis=1).argmin()]


def relative_positions(positions: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """`positions [..., 2]` relative to `origin`, in float64 and rounded to 10 nm."""
    return np.round(positions - origin, DECIMALS)


def moves_of(positions: Any) -> jax.Array:
    """Steps [..., T, 2] between `positions [..., T, 2]`, not rounded; the first is zero."""
    return jnp.diff(positions, axis=-2, prepend=positions[..., :1, :])


def displacements(positions: np.ndarray) -> np.ndarray:
    """Steps between `positions [..., T, 2]`, rounded to 10 nm; the first is zero, as in SGAN."""
    steps = np.zeros_like(positions)
    steps[..., 1:, :] = np.round(
        positions[..., 1:, :] - positions[..., :-1, :], DECIMALS
    )
    return steps


def pad_scene(scene: Scene, agents: int) -> Scene:
    """Pad a scene to `agents` slots; added slots are not valid and hold zeros."""
    count = len(np.asarray(scene.valid))

    def pad(array):
        array = np.asarray(array)
        if count == agents:
            return array
        padded = np.zeros((agents, *array.shape[1:]), array.dtype)
        padded[:count] = array
        return padded

    names = ("observed", "displacement", "valid", "seen", "future", "extras")
    fields = {name: getattr(scene, name) for name in names}
    return scene.replace(**jax.tree.map(pad, fields))


def to_world(positions: ArrayLike, scene: Scene) -> np.ndarray:
    """Positions `[..., 2]` of the scene's frame in the caller's frame, float64 metres."""
    return np.asarray(positions, np.float64) + np.asarray(scene.origin, np.float64)


def checked_positions(name: str, positions: ArrayLike) -> np.ndarray:
    """`positions [N, T, 2]` in float64; messages call them `name`.

    Raises:
        InputError: for a wrong shape, no agent or step, or a coordinate that is masked
            or beyond `FAR`.
    """
    refuse_masked({name: positions})
    try:
        positions = np.asarray(positions).astype(np.float64, casting="same_kind")
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{name}: not an array of numbers ({str(error)[:60]})"
        ) from None
    if positions.ndim != 3 or positions.shape[2] != 2:
        raise InputError(
            f"{name} must be [agents, steps, 2], not {list(positions.shape)}"
        )
    if len(positions) == 0:
        raise InputError(f"{name}: a scene needs at least one agent")
    if positions.shape[1] == 0:
        raise InputError(f"{name}: a scene needs at least one step")
    wrong = np.argwhere(~(np.abs(positions) <= FAR))
    if len(wrong):
        agent, step, _ = wrong[0]
        raise InputError(
            f"{name}: agent {agent}, step {step} is not finite, or beyond {FAR:g} m"
        )
    return positions


def turned(vector: jax.Array, direction: jax.Array, sign: int) -> jax.Array:
    """`vector [..., 2]` rotated by the angle of `direction [..., 2]`; with sign -1 rotated back."""
    x, y = vector[..., 0], vector[..., 1]
    cos = direction[..., 0]
    sin = sign * direction[..., 1]
    return jnp.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)


def with_steps(scene: Scene, steps: int) -> Scene:
    """The scene with `steps` observed steps: the newest, or further ones that nobody saw.

    Those before the first lie where agents came from at the velocity of their first step.
    """
    count = scene.observed.shape[-2]
    if count == steps:
        return scene
    observed: Any = jnp.asarray(scene.observed)
    seen: Any = scene.seen
    if count > steps:
        observed = observed[..., -steps:, :]
        seen = None if seen is None else jnp.asarray(seen)[..., -steps:]
        moves = moves_of(observed)
        return scene.replace(observed=observed, displacement=moves, seen=seen)
    if seen is None:
        seen = jnp.ones(observed.shape[:-1], bool)
    missing = steps - count
    step = observed[..., 1:2, :] - observed[..., :1, :] if count > 1 else 0
    back = jnp.arange(-missing, 0, dtype=observed.dtype)[:, None]
    earlier = observed[..., :1, :] + back * step
    padding = jnp.zeros((*seen.shape[:-1], missing), bool)
    moves: Any = jnp.asarray(scene.displacement)
    return scene.replace(
        observed=jnp.concatenate([earlier, observed], axis=-2),
        displacement=jnp.concatenate([jnp.zeros_like(earlier), moves], axis=-2),
        seen=jnp.concatenate([padding, jnp.asarray(seen)], axis=-1),
    )
