"""One parity case: arrays that are checked, scenes, and what our networks make of them."""

import functools
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.data.batching import gather_scenes
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.batched import unpacked
from neurosym_jax.interop.arguments import discriminator_config, generator_config
from neurosym_jax.interop.names import params_from_torch, plain_state
from neurosym_jax.models import Discriminator, Generator
from neurosym_jax.models.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.decoder import pool
from neurosym_jax.scene import Scene, model_dtype

__all__ = ["Arrays", "Compared", "GeneratorCase", "checked", "placed"]

Arrays = Mapping[str, np.ndarray]
Compared = dict[str, tuple[np.ndarray, np.ndarray]]
"""Per output, ours and theirs, of one shape."""


def checked(arrays: Arrays, name: str, *shape: int | None, kinds: str = "f") -> np.ndarray:
    """The finite array `name` of this shape; None is any size, `kinds` are those of its dtype.

    Raises:
        InputError: naming the array and what is wrong with it.
    """
    if name not in arrays:
        raise InputError(f"the array {name!r} is missing")
    array = arrays[name]
    if array.ndim != len(shape) or any(b not in (None, a) for a, b in zip(array.shape, shape)):
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(f"{name!r} has the shape {list(array.shape)}, not [{wanted}]")
    if array.dtype.kind not in kinds:
        words = "floating point" if kinds == "f" else "whole numbers"
        raise InputError(f"{name!r} is {array.dtype}, not {words}")
    if not np.isfinite(array).all():
        raise InputError(f"{name!r} holds a value that is not finite")
    return array


class GeneratorCase:
    """A generator of torch with its weights, scenes, noise and outputs, in our terms."""

    def __init__(
        self,
        row: Mapping[str, Any],
        arrays: Arrays,
        weights: str = "g_state/",
        *,
        of: tuple[GeneratorConfig, dict[str, Any]] | None = None,
    ):
        """Read the case.

        Args:
            row: of the manifest.
            arrays: of its file.
            weights: prefix of the weights' names.
            of: configuration and parameters, if they are not those of `row` and `weights`.

        Raises:
            InputError: for an argument or an array that is missing or wrong.
        """
        self.row, self.arrays = row, arrays
        if of is None:
            state = self.state(weights)
            config = generator_config(row, state, "manifest", variant=row.get("variant"))
            of = config, params_from_torch(state, config)
        self.config, self.params = of
        steps = self.config.obs_len + self.config.pred_len
        traj = checked(arrays, "traj", None, steps, 2)
        self.moves = checked(arrays, "traj_rel", *traj.shape)
        bounds = checked(arrays, "scene_start_end", None, 2, kinds="iu")
        if not len(bounds):
            raise InputError("'scene_start_end' must be of at least one scene")
        starts, ends = bounds.astype(np.int64).T
        follows = np.array_equal(starts, [0, *ends[:-1]]) and ends[-1] == len(traj)
        if not follows or (ends <= starts).any():
            raise InputError(
                f"'scene_start_end' does not cut {len(traj)} agents into scenes one after another"
            )
        self.bounds = np.append(0, ends)
        self.windows = self._windows(traj.astype(np.float64), self.config.obs_len)
        self.scenes = self.padded(self.windows, self.moves)

    def state(self, prefix: str) -> dict[str, Any]:
        """The state dict that is stored under `prefix`, see `plain_state`."""
        arrays = self.arrays.items()
        state = {k.removeprefix(prefix): v for k, v in arrays if k.startswith(prefix)}
        return plain_state(state, self.row)

    def noise(self) -> np.ndarray:
        """The stored noise by scene, [S, D], or by slot, [S, N, D]."""
        config, valid = self.config, np.asarray(self.scenes.valid)
        if config.noise_dim == 0:
            return np.zeros((len(valid), 0), model_dtype())
        if config.noise_mix_type == "global":
            return checked(self.arrays, "noise", len(valid), config.noise_dim)
        return placed(checked(self.arrays, "noise", valid.sum(), config.noise_dim), valid)

    def stages(self, alpha: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Our forecast [A, pred_len, 2] and the vectors [A, ...] before it, by torch's names."""
        found = _stages(self.config, self.params, self.scenes.bare(), self.noise(), alpha)
        return {name: np.asarray(each)[self.scenes.valid] for name, each in found.items()}

    def scores(self, absolute: np.ndarray, relative: np.ndarray) -> np.ndarray:
        """Our discriminator's scores [A] of the observation and this forecast."""
        state = self.state("d_state/")
        config = discriminator_config(self.row, state, "manifest")
        params = params_from_torch(state, config)
        observed = self.windows.position[:, : self.config.obs_len]
        whole = np.concatenate([observed, absolute.astype(np.float64)], axis=1)
        moves = np.concatenate([self.moves[:, : self.config.obs_len], relative], axis=1)
        fakes = self.padded(self._windows(whole, whole.shape[1]), moves)
        return np.asarray(_scores(config, params, fakes.bare()))[fakes.valid]

    def padded(self, windows: Windows, moves: np.ndarray) -> Scene:
        """All scenes padded to one size, [S, ...] on every array, with the stored displacements."""
        scenes = gather_scenes(windows, np.arange(windows.scenes), int(windows.sizes.max()))
        observed = moves[:, : windows.obs_len].astype(scenes.observed.dtype)
        displacement = placed(observed, np.asarray(scenes.valid))
        return scenes.replace(displacement=displacement, identity=None)

    def _windows(self, position: np.ndarray, obs_len: int) -> Windows:
        identity = np.zeros((len(self.bounds) - 1, 2), np.uint32)
        return Windows(position, np.arange(len(position)), self.bounds, identity, obs_len)


def placed(values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """`values [A, ...]` in the A places `there [S, ...]` (bool) of zeros: `[S, ..., ...]`."""
    return unpacked(values[None], there)[0]


@functools.partial(jax.jit, static_argnums=0)
def _stages(config: GeneratorConfig, params: Any, *given: Any) -> dict[str, Array]:
    """[S, N, ...] by torch's names; one scene after another, so memory is that of one."""

    def of_scene(network: Generator, scene: Scene, noise: Array, alpha: Array | None) -> Any:
        hidden = network.observe(jnp.asarray(scene.displacement))
        context = network.interact(hidden, scene, alpha)
        found = {"encoder": hidden, "pred_rel": network.decode(context, scene, noise)}
        if config.pools:
            track = jnp.asarray(scene.observed)
            sizes = (config.pooling, hidden, track, scene.valid, alpha)
            found["pool_net"] = pool(network.pooling, *sizes)
        if config.needs_context_mlp:
            found["mlp_decoder_context"] = context
        return found

    every = functools.partial(Generator(config).apply, {"params": params}, method=of_scene)
    return jax.lax.map(lambda scene: every(*scene), given)


@functools.partial(jax.jit, static_argnums=0)
def _scores(config: DiscriminatorConfig, params: Any, scenes: Scene) -> Array:
    """[S, N] scores of whole trajectories, held by `scenes` as what was observed."""
    score = functools.partial(Discriminator(config).apply, {"params": params})
    return jax.lax.map(lambda s: score(s.observed, s.displacement, s.valid), scenes)
