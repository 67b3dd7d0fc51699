"""The state of a training: parameters and optimiser, a step by gradients, and the state on
disk.
"""

import contextlib
import dataclasses
import errno
import functools
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jax.core import Tracer

from neurosym_jax.errors import InputError, TrainingError, line_of, printable
from neurosym_jax.runtime.files import (
    folder_digest,
    new_folder,
    refuse_unwritable,
    remove_half_written,
)
from neurosym_jax.runtime.programs import program
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.soft import safe_root
from neurosym_jax.training.batches import Groups, augment
from neurosym_jax.training.recipe import Recipe

__all__ = [
    "TrainState",
    "batch_samples",
    "clipping",
    "gradient_rounds",
    "gradient_step",
    "is_frozen",
    "new_state",
    "optimizer_step",
    "restore_state",
    "save_state",
    "sole_writer",
    "update",
    "variety_loss",
    "warmup_of",
    "with_schedule",
]


# The state of a training, and one update of a forecaster's parameters: clipping, Adam,
# average.


class TrainState(NamedTuple):
    """The state of a training; a pytree of arrays."""

    step: Array
    """[] int32 steps done."""
    params: Any
    """Parameters of the forecaster."""
    optimizer: Any
    average: Any
    """Averaged parameters, () where the recipe averages none."""
    extra: Any = ()
    """What else a family trains, such as SGAN's discriminator."""


def new_state(recipe: Recipe, params: Any, extra: Any = ()) -> TrainState:
    """The state before the first step.

    Raises:
        InputError: for an optimiser whose state cannot be saved.
    """
    # A copy: the loop donates the state's buffers, each of them once.
    average = jax.tree.map(jnp.copy, params) if recipe.ema else ()
    optimizer = _optimizer(recipe).init(params)
    for leaf in jax.tree.leaves(optimizer):
        if jnp.issubdtype(jnp.result_type(leaf), jax.dtypes.prng_key):
            raise InputError(
                "optimizer: its state has a key of jax.random.key, which a run cannot "
                "save: give it one of jax.random.PRNGKey"
            )
    return TrainState(jnp.zeros((), jnp.int32), params, optimizer, average, extra)


def update(
    recipe: Recipe,
    state: TrainState,
    gradient: Any,
    scale: Callable[[Any], Any] = lambda moves: moves,
    value: Array | None = None,
) -> TrainState:
    """The state after clipping the gradient and one step of the forecaster's optimiser.

    Modules that the recipe freezes do not move, and neither do scheduled parameters,
    which get their values of the next step. `scale` may change the step.
    `value` [] is the loss, which some optimisers use. The average has `ema` for its
    decay; early, it is over the last tenth of the steps.
    """
    gradient = _without_frozen(recipe, gradient)
    moves, optimizer = optimizer_step(
        _optimizer(recipe), gradient, state.optimizer, state.params, value
    )
    # Some optimisers move without a gradient, as by weight decay.
    moves = _without_frozen(recipe, scale(moves))
    params: Any = optax.apply_updates(state.params, moves)
    params = with_schedule(recipe, params, state.step + 1)
    average = state.average
    if recipe.ema:
        done = jnp.asarray(state.step, float)
        decay = jnp.minimum(recipe.ema, (1.0 + done) / (10.0 + done))

        def averaged(path: tuple[Any, ...], mean: Array, value: Array) -> Array:
            if is_frozen(recipe, path):  # The mean of equal numbers is rounded.
                return value
            share = decay.astype(mean.dtype)
            return share * mean + (1 - share) * value

        average = jax.tree_util.tree_map_with_path(averaged, average, params)
    return state._replace(
        step=state.step + 1, params=params, optimizer=optimizer, average=average
    )


def optimizer_step(
    optimizer: optax.GradientTransformation,
    gradient: Any,
    state: Any,
    params: Any,
    value: Array | None = None,
) -> tuple[Any, Any]:
    """`optimizer.update`, which itself counts on promotions that JAX's strict mode refuses.

    `value` [] is the loss, which some optimisers use.
    """
    with jax.numpy_dtype_promotion("standard"):
        extra = optax.with_extra_args_support(optimizer)
        return extra.update(gradient, state, params, value=value)


def _without_frozen(recipe: Recipe, tree: Any) -> Any:
    """A tree like the parameters, zero where they do not learn."""
    if not recipe.freeze and not recipe.scheduled():
        return tree
    return jax.tree_util.tree_map_with_path(
        lambda path, leaf: jnp.zeros_like(leaf) if is_frozen(recipe, path) else leaf,
        tree,
    )


def is_frozen(recipe: Recipe, path: tuple[Any, ...]) -> bool:
    """Whether a leaf of the parameters does not learn: it is frozen, or scheduled."""
    keys = [getattr(entry, "key", None) for entry in path]
    if any(key in recipe.freeze for key in keys):
        return True
    return ".".join(map(str, keys)) in recipe.scheduled()


def with_schedule(recipe: Recipe, params: Any, step: Array | int) -> Any:
    """The parameters with the values [...] that scheduled ones have at `step` [].

    Raises:
        InputError: for a path without a parameter, and a value of another shape.
    """
    schedule = recipe.scheduled()
    if not schedule:
        return params
    missing = set(schedule)

    def scheduled(path: tuple[Any, ...], leaf: Array) -> Array:
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        if name not in schedule:
            return leaf
        missing.discard(name)
        value = call_own(f"schedule of {name}", schedule[name], step)
        if not isinstance(value, Array | np.ndarray | np.number | int | float):
            raise InputError(
                f"schedule of {name}: must return numbers, not {type(value).__name__}"
            )
        if jnp.shape(value) not in ((), leaf.shape):
            raise InputError(
                f"schedule of {name}: returns {list(jnp.shape(value))}, "
                f"and the parameter is {list(leaf.shape)}"
            )
        known = not isinstance(value, Tracer)
        if known and not np.isfinite(value).all():
            raise InputError(f"schedule of {name}: is {value} at step {step}")
        return jnp.broadcast_to(jnp.asarray(value, leaf.dtype), leaf.shape)

    params = jax.tree_util.tree_map_with_path(scheduled, params)
    if missing:
        leaves = jax.tree_util.tree_leaves_with_path(params)
        names = [
            jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in leaves
        ]
        # Those of a weighting first: they are what is annealed.
        names.sort(key=lambda name: not name.startswith("weighting"))
        raise InputError(
            f"schedule: there is no parameter {min(missing)!r}; some of those that "
            f"there are: {', '.join(names[:8])}"
        )
    return params


UNTRACEABLE = (
    jax.errors.ConcretizationTypeError,
    jax.errors.NonConcreteBooleanIndexError,
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerIntegerConversionError,
)
"""What JAX raises where code needs the value of a number that is only traced."""


def call_own(name: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """`function(*arguments)` of a caller, who gave it as `name`, while it is traced.

    Raises:
        InputError: with the line that failed, and why.
    """
    try:
        return function(*arguments)
    except InputError:
        raise
    except UNTRACEABLE as error:
        raise InputError(
            f"{name}: {line_of(error)} cannot be traced by JAX: use functions of "
            "jax.numpy for Python's and numpy's, and jnp.where for if"
        ) from error
    except Exception as error:
        where = line_of(error)
        # Of an installed optimiser no line is the caller's.
        where = "" if where.startswith(__file__) else f"{where}: "
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{name}: {where}{reason}") from error


def clipping(recipe: Recipe) -> optax.GradientTransformation:
    """The first part of an update: gradients of at most the recipe's norm."""
    if not recipe.clip_norm:
        return optax.identity()
    if not recipe.clip_epsilon:
        return optax.clip_by_global_norm(recipe.clip_norm)

    def clip(gradient: Any, params: Any = None) -> Any:
        norm = optax.tree.norm(gradient) + recipe.clip_epsilon
        share = jnp.minimum(recipe.clip_norm / norm, 1)
        return jax.tree.map(lambda leaf: leaf * share.astype(leaf.dtype), gradient)

    return optax.stateless(clip)


def warmup_of(recipe: Any) -> int:
    """Steps in which the learning rate rises, as they are done."""
    if recipe.schedule == "cosine":
        return min(recipe.warmup_steps, recipe.steps // 2)
    return 0


def _optimizer(recipe: Recipe) -> optax.GradientTransformation:
    own = recipe.optimizer()
    if own is not None:
        return optax.chain(clipping(recipe), _heard(own))
    rate: optax.ScalarOrSchedule = recipe.learning_rate
    if recipe.schedule == "cosine":
        rate = optax.warmup_cosine_decay_schedule(
            0.0, recipe.learning_rate, warmup_of(recipe), max(recipe.steps, 1)
        )
    return optax.chain(clipping(recipe), optax.adam(rate))


def _heard(own: Any) -> optax.GradientTransformationExtraArgs:
    """A caller's optimiser, of which each misfit is one line."""
    own = call_own("optimizer", optax.with_extra_args_support, own)

    def init(params: Any) -> Any:
        return call_own("optimizer", own.init, params)

    def update(updates: Any, state: Any, params: Any = None, **extra: Any) -> Any:
        step = functools.partial(own.update, **extra)
        made = call_own("optimizer", step, updates, state, params)
        if not isinstance(made, tuple) or len(made) != 2:
            raise InputError("optimizer: update must return moves and a state")
        moves, _ = made
        if jax.tree.map(jnp.shape, moves) != jax.tree.map(jnp.shape, updates):
            raise InputError("optimizer: update must return moves of all parameters")
        return made

    return optax.GradientTransformationExtraArgs(init, update)


# One step of training by the gradient of a family's loss, and the loss of a family
# without one.


def gradient_rounds(
    forecaster: Any, batches: Callable[[int], Any], recipe: Any, key: Array
) -> Callable[..., tuple[TrainState, Any]]:
    """See `Forecaster.rounds`; `batches` gives the batch of a step."""

    recipe = dataclasses.replace(recipe, seed=0)  # Seeds share the compiled step.

    def advance(state: TrainState, done: int, count: int) -> tuple[TrainState, Any]:
        rows = []
        for step in range(done, done + count):
            state, metrics = gradient_step(
                forecaster, recipe, key, state, batches(step)
            )
            rows.append(metrics)
        stacks = {}
        for name in rows[0]:
            stacks[name] = jnp.stack([row[name] for row in rows])
        return state, stacks

    return advance


@program((0, 1), donate_argnums=3)
def gradient_step(
    forecaster: Any, recipe: Any, key: Array, state: TrainState, batch: Any
) -> tuple[TrainState, dict[str, Array]]:
    """The state after one step on a batch, and its metrics [], `loss` among them.

    `key` is the run's, the same for all steps. The buffers of `state` are donated.
    """
    # The key follows from the step, not from where the run was interrupted.
    step_key = jax.random.fold_in(key, state.step)

    def loss(params: Any) -> tuple[Array, dict[str, Array]]:
        return forecaster.loss(params, batch, step_key, recipe)

    (value, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(state.params)
    state = update(recipe, state, gradient, value=value)
    return state, {"loss": value, **metrics}


def variety_loss(
    forecaster: Any, params: Any, groups: Groups, key: Array, recipe: Any
) -> tuple[Array, dict[str, Array]]:
    """[] metres: ADE and weighted FDE of the best joint sample of each scene, mean over people.

    The batch is augmented; every scene gets its own noise. Consumes `key`.
    """
    total = jnp.zeros(())
    people = jnp.zeros(())
    for scenes, futures in batch_samples(forecaster, params, groups, key, recipe):
        offset = futures - scenes.known_future[None]
        distance = safe_root(jnp.square(offset).sum(-1))
        error = distance.mean(-1) + recipe.fde_weight * distance[..., -1]  # [k, B, N]
        error = jnp.where(scenes.valid[None], error, 0).sum(-1)
        total += error.min(0).sum()
        people += scenes.valid.sum(dtype=people.dtype)
    return total / people, {}


def batch_samples(
    forecaster: Any, params: Any, groups: Groups, key: Array, recipe: Any
) -> Iterator[tuple[Scene, Array]]:
    """The augmented scenes [B, N, ...] of each group and samples [k, B, N, pred_len, 2].

    Consumes `key`.

    Raises:
        InputError: for a family that forecasts another shape.
    """
    move_key, noise_key = jax.random.split(key)
    samples = forecaster.best_of(recipe)
    spec = forecaster.noise
    for number, scenes in enumerate(augment(groups, move_key, recipe)):
        scenes = jax.tree.map(jnp.asarray, scenes)
        slots = scenes.valid.shape if spec.per_agent else scenes.valid.shape[:1]
        noise = spec.draw(
            jax.random.fold_in(noise_key, number), (samples, *slots, spec.dim)
        )
        forecast = jax.vmap(forecaster.forecast, in_axes=(None, 0, 1), out_axes=1)
        observed = scenes.replace(future=None)
        futures = forecast(params, observed, noise)
        axes = (None, *scenes.valid.shape)
        yield scenes, forecaster.checked_futures(futures, axes)


# The states of a training run on disk: whole or not at all, verified, the two newest.
#
# Each is a folder `step_00000120` of `state/` (arrays, Orbax's), `record.json` and
# `sha256`, the digest of the others: Orbax restores some flipped bits without noticing,
# and a flipped bit in a shape asks for any amount of memory. One process at a time writes
# to a folder.

STATE, RECORD, DIGEST = "state", "record.json", "sha256"
CHECKPOINTS = "checkpoints"
"""The folder of states in that of a run."""
WRITTEN = r"step_\d+|model|recipe|metrics|curves|run"
"""Stems of what a training writes, as a pattern."""
SPARE = 2**20
"""Bytes beyond the arrays that a state may need on the disk."""


def save_state(folder: Path, step: int, state: Any, record: dict[str, Any]) -> None:
    """Save the state after `step` steps, a pytree of arrays, then remove all but the two newest.

    It is on the disk when this returns. `record` is JSON-able.

    Raises:
        TrainingError: where it cannot be written.
    """
    from orbax.checkpoint import v1 as ocp

    path = folder / f"step_{step:08d}"
    # By number, because Orbax or the file system may read a leaf's path otherwise.
    leaves = {}
    for at, leaf in enumerate(jax.tree.leaves(state)):
        leaves[f"{at:06d}"] = np.asarray(leaf)
    context = ocp.Context()
    # In the background, Orbax waits twenty minutes for a folder that cannot be made.
    context.asynchronous.create_directories_asynchronously = False
    try:
        with new_folder(path) as new:
            # Asked before, because Orbax prints thirty tracebacks on a full disk.
            needed = sum(leaf.nbytes for leaf in leaves.values()) + SPARE
            if shutil.disk_usage(new).free < needed:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            with context:
                ocp.save(str((new / STATE).absolute()), leaves)
            (new / RECORD).write_text(json.dumps(record, allow_nan=False))
            (new / DIGEST).write_text(folder_digest(new))
        for old in _steps(folder)[:-2]:
            shutil.rmtree(old)
    except Exception as error:  # Orbax and its storage raise many kinds.
        text = f"{path}: {_reason(error)}"
        if isinstance(error, InputError):
            text = str(error)
        raise TrainingError(f"{text}; what was saved before is kept") from error


def restore_state(
    folder: Path,
    template: Any,
    check: Callable[[dict[str, Any]], object] = lambda record: None,
) -> tuple[Any, dict[str, Any]] | None:
    """The newest whole state, in the structure of `template`, and its record; None without any.

    Its leaves are numpy arrays, bit for bit those saved. Damaged states are renamed to
    `damaged_...`, with a warning. `check` may refuse the record before the state is
    compared.

    Raises:
        InputError: where a whole state has other arrays than `template`.
    """
    from orbax.checkpoint import v1 as ocp

    for path in reversed(_steps(folder)):
        try:
            if folder_digest(path, DIGEST) != (path / DIGEST).read_text():
                raise ValueError("its files do not match their digest")
            record = json.loads((path / RECORD).read_bytes())
            arrays: Any = ocp.load(str((path / STATE).absolute()))
        except Exception as error:
            # Orbax and its storage raise many kinds for damaged files.
            line = f"warning: {path}: is damaged: {_reason(error)}"
            print(printable(line), file=sys.stderr)
            aside = path.with_name(f"damaged_{path.name}")
            shutil.rmtree(aside, ignore_errors=True)
            path.rename(aside)
            continue
        check(record)
        leaves, structure = jax.tree.flatten(template)
        leaves_saved = [arrays[name] for name in sorted(arrays)]
        kinds = [(leaf.shape, leaf.dtype) for leaf in leaves]
        if [(leaf.shape, leaf.dtype) for leaf in leaves_saved] != kinds:
            raise InputError(f"{folder}: holds another run: its network differs")
        return jax.tree.unflatten(structure, leaves_saved), record
    return None


@contextlib.contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock `folder`, which is created if needed; the lock ends with the process.

    Raises:
        InputError: when another process holds it, or nothing can be written there.
    """
    refuse_unwritable(folder / ".lock")
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as file:
        try:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # Not on Windows, where nothing guards the folder.
            pass
        except BlockingIOError:
            raise InputError(f"{folder}: another process is training there") from None
        for part in (folder, folder / CHECKPOINTS):
            remove_half_written(part, WRITTEN)
        yield


def _steps(folder: Path) -> list[Path]:
    paths = folder.glob("step_*")
    return sorted(path for path in paths if path.name[5:].isdecimal())


def _reason(error: Exception) -> str:
    if str(error):
        return str(error).splitlines()[0][:200]
    return type(error).__name__
