"""Training parity: torch's steps of generator and discriminator, and ours beside them.

Both sides begin with the weights and optimisers of a checkpoint, and get the same
batches, noises and labels. Torch's side is `torch_side.Training`.
"""

import dataclasses
import functools
import itertools
import math
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from neurosym_jax.evaluation.tables import aligned_table
from neurosym_jax.interop import torch_side
from neurosym_jax.interop.cases import (
    Arrays,
    padded,
    placed_alpha,
    state_of,
    weights_pairs,
)
from neurosym_jax.interop.checkpoint import Contents, generator
from neurosym_jax.interop.parity import row_fields, run_torch
from neurosym_jax.interop.torch_training import (
    adam_entries,
    recipe_of,
    training_from_torch,
)
from neurosym_jax.models.forecast import unpacked
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.models.sgan.torch_names import params_from_torch
from neurosym_jax.models.sgan.training import GeneratorRecipe, learn
from neurosym_jax.runtime.foreign import read_arrays
from neurosym_jax.scene import model_dtype

__all__ = ["TRAINING_TOLERANCE", "TrainingParity", "TrainingRow", "compare_training"]

TRAINING_TOLERANCE = 1e-6
"""Largest difference of a parameter that passes after the last step, in float64."""
REPORTED = (1, 10, 25, 50, 100, 250, 500, 1000)
"""Steps after which parameters are compared, besides the last one."""
DEAD = 2 * math.log(2)
"""Loss of a discriminator that scores everything 0, whatever its labels are."""
FRESH_RATE = 0.1
"""Share of its learning rate that a fresh discriminator has: SGAN's ends in a ReLU, and at the
published rate it scores everything 0 after fewer than 20 steps on random walks."""
FAST_COMPILE = {"xla_backend_optimization_level": 0}
"""Options of XLA for a program of a few steps: half the time to compile."""
NETWORKS = "generator", "discriminator"
TYPES = "float64", "float32"

Differences = dict[int, dict[str, float]]
"""By step and network, the largest absolute difference of a parameter."""


@dataclasses.dataclass(frozen=True)
class TrainingRow:
    """Largest absolute differences of parameters after a number of steps."""

    step: int
    generator_float64: float
    discriminator_float64: float
    generator_float32: float
    discriminator_float32: float
    d_loss: float
    """Torch's loss of the discriminator before this step, in float64."""
    moved: float
    """How far torch's training has moved a parameter at most; of the network that moved less."""


@dataclasses.dataclass(frozen=True)
class TrainingParity:
    """A training beside torch's; as text a table with a verdict."""

    rows: tuple[TrainingRow, ...]
    tolerance: float = TRAINING_TOLERANCE
    assumed: tuple[str, ...] = ()
    """What the checkpoint does not say, in words."""

    @property
    def alive(self) -> bool:
        """Whether torch's networks learned and its discriminator scores something."""
        last = self.rows[-1]
        moves = last.moved > self.tolerance
        return moves and abs(last.d_loss - DEAD) > TRAINING_TOLERANCE

    @property
    def ok(self) -> bool:
        """Whether both networks agree in float64 after the last step, and are alive."""
        last = self.rows[-1]
        differences = last.generator_float64, last.discriminator_float64
        # One that is no number is not within.
        return self.alive and all(value <= self.tolerance for value in differences)

    def to_json(self) -> dict[str, Any]:
        """The verdict and all rows; differences that are not finite are null."""
        return {
            "ok": self.ok,
            "alive": self.alive,
            "tolerance": self.tolerance,
            "assumed": list(self.assumed),
            "rows": [row_fields(row) for row in self.rows],
        }

    def __str__(self) -> str:
        """An aligned table and the verdict."""
        types = TYPES[0], TYPES[0], TYPES[1], TYPES[1]
        table: list[tuple[str, ...]] = [
            ("step", *NETWORKS, *NETWORKS, "both", "torch's loss of"),
            ("", *types, "moved", "the discriminator"),
        ]
        for row in self.rows:
            step, *differences, loss, moved = dataclasses.astuple(row)
            numbers = [f"{value:.1e}" for value in (*differences, moved)]
            table.append((str(step), *numbers, f"{loss:.4f}"))
        lines = [aligned_table(table), ""]
        if self.assumed:
            lines.append(f"assumed: {'; '.join(self.assumed)}")
        if not self.alive:
            lines.append(
                "torch's discriminator is dead (it scores everything 0, a loss of "
                "2 log 2), or nothing moved, and agreement says nothing; take another "
                "--seed or checkpoint"
            )
        verdict = "within" if self.ok else "MISS: not within"
        steps = self.rows[-1].step
        lines.append(
            f"parameters after {steps} steps {verdict} {self.tolerance:g} in float64"
        )
        return "\n".join(lines)


def compare_training(
    module: str,
    contents: Contents,
    steps: int,
    *,
    python: str,
    seed: int = 0,
    tolerance: float = TRAINING_TOLERANCE,
) -> TrainingParity:
    """Train the checkpoint for some steps in torch and here, in float64 and in float32.

    A step is one of the discriminator, then one of the generator, each on a batch of
    its own: four scenes of people who walk at random. Pairs of NeuroSyM have random
    weights. Dropout is off.

    Args:
        module: `FILE.py:CLASS`, SGAN's or NeuroSyM's `TrajectoryGenerator`; the file
            has a `TrajectoryDiscriminator`, too.
        contents: what `read_torch_file` read of the checkpoint. Without a `d_state`
            torch draws a discriminator by `seed`; without states of optimisers they
            are new.
        steps: number of steps, at least 1.
        python: the interpreter that has torch.
        seed: of the scenes, noise, labels and fresh weights.
        tolerance: largest difference of a parameter that passes.

    Raises:
        InputError: as `recipe_of` and `run_torch`.
    """
    config, _ = generator(contents["args"], contents["g_state"])
    recipe, assumed = _recipe(contents, steps, seed)
    moments = _moments(contents)
    if not moments:
        assumed += ("new optimisers",)
    inputs = _inputs(config, recipe, seed)
    settings: dict[str, Any] = {}
    for name in ("learning_rate", "d_learning_rate", "clip_norm", "variety_weight"):
        settings[name] = getattr(recipe, name)
    reported = sorted({*(step for step in REPORTED if step < steps), steps})
    settings["reported"] = reported
    with tempfile.TemporaryDirectory() as folder:
        run_torch(
            module,
            contents,
            Path(folder),
            title="training",
            python=python,
            seed=seed,
            training={"settings": settings, "arrays": inputs | moments},
        )
        arrays = read_arrays(Path(folder) / torch_side.TRAINING, "a training")
    rows = _rows(contents, recipe, inputs, arrays, reported)
    return TrainingParity(rows, tolerance, assumed)


def _recipe(
    contents: Contents, steps: int, seed: int
) -> tuple[GeneratorRecipe, tuple[str, ...]]:
    """The recipe of `steps` steps, and what it assumes of the discriminator, in words."""
    recipe = dataclasses.replace(recipe_of(contents), steps=steps)
    if "d_state" in contents:
        return recipe, ()
    rate = FRESH_RATE * recipe.d_learning_rate
    fresh = f"a fresh discriminator, by seed {seed}, at {FRESH_RATE:g} of its rate"
    return dataclasses.replace(recipe, d_learning_rate=rate), (fresh,)


def _rows(
    contents: Contents,
    recipe: GeneratorRecipe,
    inputs: Arrays,
    arrays: Arrays,
    reported: list[int],
) -> tuple[TrainingRow, ...]:
    """Train here, and compare the parameters after each of the `reported` steps with torch's."""
    differences = {}
    for name in TYPES:
        with jax.enable_x64(name == "float64"):
            differences[name] = _differences(
                contents, recipe, inputs, state_of(arrays, f"{name}/"), reported
            )
    rows = []
    for step in reported:
        columns = {}
        for network, name in itertools.product(NETWORKS, TYPES):
            columns[f"{network}_{name}"] = differences[name][step][network]
        loss = float(arrays["float64/d_loss"][step - 1])
        moved = _moved(state_of(arrays, "float64/"), step)
        rows.append(TrainingRow(step=step, d_loss=loss, moved=moved, **columns))
    return tuple(rows)


def _moments(contents: Contents) -> dict[str, np.ndarray]:
    """States of the checkpoint's optimisers, by `torch_side`'s names."""
    moments = {}
    for network in "gd":
        for place, entry in adam_entries(contents, network).items():
            for name in ("step", "exp_avg", "exp_avg_sq"):
                key = f"{torch_side.ADAM}{network}/{place}/{name}"
                moments[key] = np.asarray(entry[name], np.float64)
    return moments


def _inputs(
    config: GeneratorConfig, recipe: GeneratorRecipe, seed: int
) -> dict[str, np.ndarray]:
    """Batches, noises and labels by torch's names, each with a leading axis of steps.

    Two batches a step, `traj` and `traj_rel` [steps, 2, T, A, 2] and `alpha` [steps, 2,
    P, T] of their ordered pairs; `noise_d` [steps, rows, dim], `noise_g` [steps, k,
    rows, dim] and `labels` [steps, 3].
    """
    steps, length = recipe.steps, config.obs_len + config.pred_len
    batches = []
    for number in range(2 * steps):
        scenes = torch_side.random_walks(length, seed + number)
        batches.append(np.concatenate(scenes))
    traj = np.stack(batches).reshape(steps, 2, *batches[0].shape)
    moves = np.diff(traj, axis=3, prepend=traj[:, :, :, :1])

    ends = np.cumsum(torch_side.SIZES)
    rows = len(ends) if config.noise_mix_type == "global" else ends[-1]
    shape = (rows, config.noise_dim)
    pairs = sum(size**2 for size in torch_side.SIZES)
    ranges = [recipe.label_real, recipe.label_fake, recipe.label_real]
    low, high = np.array(ranges).T
    rng = np.random.default_rng(seed)
    return {
        "traj": traj.swapaxes(2, 3),
        "traj_rel": moves.swapaxes(2, 3),
        "bounds": np.stack([np.append(0, ends[:-1]), ends], axis=1),
        "noise_d": rng.normal(size=(steps, *shape)),
        "noise_g": rng.normal(size=(steps, recipe.best_k, *shape)),
        "labels": rng.uniform(low, high, size=(steps, 3)),
        "alpha": rng.uniform(0.1, 1, size=(steps, 2, pairs, length)),
    }


def _differences(
    contents: Contents,
    recipe: GeneratorRecipe,
    inputs: Arrays,
    arrays: Arrays,
    reported: list[int],
) -> Differences:
    """Differences of our training from torch's `arrays` of it, in the current type."""
    states = {}
    for step in (0, *reported):
        states[step] = {
            "g_state": state_of(arrays, f"{step}/g_state/"),
            "d_state": state_of(arrays, f"{step}/d_state/"),
        }
    config, read, state = training_from_torch({**contents, **states[0]})
    recipe = dataclasses.replace(recipe, discriminator=read.discriminator)
    step_both = jax.jit(
        functools.partial(learn, config, recipe), compiler_options=FAST_COMPILE
    )
    differences: Differences = {}
    for number in range(recipe.steps):
        state = step_both(state, **_step_inputs(config, inputs, number))[0]
        step = number + 1
        if step in reported:
            generator_params = params_from_torch(states[step]["g_state"], config)
            critic_params = params_from_torch(
                states[step]["d_state"], read.discriminator
            )
            differences[step] = {
                "generator": _largest(state.params, generator_params),
                "discriminator": _largest(state.extra.params, critic_params),
            }
    return differences


def _step_inputs(config: GeneratorConfig, inputs: Arrays, step: int) -> dict[str, Any]:
    """Arguments of `learn` for a step."""
    bounds = np.append(0, inputs["bounds"][:, 1])
    real, fake, generator_label = inputs["labels"][step].astype(model_dtype())
    noises = inputs["noise_d"][step][None], inputs["noise_g"][step]
    batches = []
    for batch, noise in enumerate(noises):
        positions = inputs["traj"][step, batch].swapaxes(0, 1)
        moves = inputs["traj_rel"][step, batch].swapaxes(0, 1)
        scenes = padded(positions, moves, bounds, config.obs_len)
        valid = np.asarray(scenes.valid)
        if config.noise.per_agent:
            noise = unpacked(noise, valid)
        group = scenes.replace(origin=None)
        if weights_pairs(config):
            alpha = inputs["alpha"][step, batch, :, : config.obs_len]
            alpha = placed_alpha(alpha.astype(model_dtype()), valid, config)
            group = group.replace(alpha=alpha)
        batches.append(((group,), [noise.astype(model_dtype())]))
    first, second = batches
    return {
        "first": first,
        "second": second,
        "real": (real, generator_label),
        "fake": fake,
    }


def _moved(arrays: Arrays, step: int) -> float:
    """See `TrainingRow.moved`."""
    largest = []
    for network in ("g_state", "d_state"):
        before = state_of(arrays, f"0/{network}/")
        after = state_of(arrays, f"{step}/{network}/")
        moves = []
        for name in before:
            difference = after[name] - before[name]
            moves.append(np.abs(difference).max())
        largest.append(max(moves))
    return float(min(largest))


def _largest(variables: Any, torch_params: Any) -> float:
    """Largest absolute difference of our `variables` from torch's parameters."""
    values, _ = ravel_pytree(variables["params"])
    torch_values, _ = ravel_pytree(torch_params)
    return float(np.abs(np.asarray(values - torch_values)).max())
