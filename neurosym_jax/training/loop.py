"""The loop around the step: rounds of compiled steps, validation, checkpoints, what is written.

A run is a folder: `checkpoints/` (to resume from), `metrics.jsonl`, `curves.png`, and at its end
`model/`, the best state by validation. Everything random follows from (seed, step), so a resumed
run continues bit for bit.
"""

import dataclasses
import hashlib
import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from neurosym_jax.checkpoint import TrainingCheckpoints, save_model
from neurosym_jax.config import GeneratorConfig, TrainConfig, to_json
from neurosym_jax.data.batching import Batch, make_batches
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.evaluation.protocol import evaluate
from neurosym_jax.forecast import GeneratorForecaster, Model
from neurosym_jax.runtime import run_environment
from neurosym_jax.training.step import TrainState, initial_state, train_step
from neurosym_jax.training.stream import SceneStream

__all__ = ["CHUNK", "Run", "data_digest", "train"]

CHUNK = 25
"""Steps compiled into one call, between two updates of the progress bar."""


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """What is trained on what; `train` does it."""

    generator: GeneratorConfig
    config: TrainConfig
    training: Windows
    validation: Windows
    scene: str | None
    """The scene left out, recorded with the model."""

    def describe(self) -> dict[str, Any]:
        """All that must be equal for a run to be resumed."""
        return {
            "generator": to_json(self.generator),
            "training": to_json(self.config),
            "scene": self.scene,
            "data": {
                "training": data_digest(self.training),
                "validation": data_digest(self.validation),
            },
        }


def data_digest(windows: Windows) -> str:
    """SHA-256 of the windows themselves, whatever files they came from."""
    sha = hashlib.sha256()
    for array in (windows.position, windows.bounds, windows.identity):
        sha.update(np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()


def train(run: Run, folder: Path, *, resume: bool = False) -> Model:
    """Train, from the start or from the newest good checkpoint in `folder`.

    Returns:
        The best model by validation, also written to `folder / "model"`.

    Raises:
        InputError: when `folder` holds a run already (and `resume` is not said), or another run.
        TrainingError: when a loss or metric is not finite; the last good step stays on disk.
    """
    config = run.config
    per_step = 2 if config.adversarial_weight else 1
    stream = SceneStream(run.training, config.batch_scenes, config.seed, config.max_agents)
    batches = make_batches(run.validation)
    key = jax.random.key(config.seed)
    example = jax.tree.map(lambda leaf: leaf[0, 0], stream.steps(0, 1)[0])
    state = initial_state(run.generator, config, example, jax.random.fold_in(key, 0))
    best = jax.tree.map(np.array, _validated(config, state))
    history: list[dict[str, Any]] = []
    record = {**run.describe(), "environment": run_environment()}

    with TrainingCheckpoints(folder / "checkpoints") as checkpoints:
        found = checkpoints.restore((state, best))
        if found is not None:
            state, best, history = _resumed(found, run, folder, resume)
        advance = _program(run.generator, config, jax.random.fold_in(key, 1))
        done = int(state.step)
        bar = tqdm(total=config.steps, initial=done, unit="step", disable=None)
        while done < config.steps:
            groups = jax.tree.map(
                lambda leaf: leaf.reshape(CHUNK, per_step, *leaf.shape[1:]),
                stream.steps(done * per_step, CHUNK * per_step),
            )
            state, metrics = advance(state, groups)
            losses = {name: float(value.mean()) for name, value in metrics.items()}
            done += CHUNK
            bar.update(CHUNK)
            if not all(np.isfinite(list(losses.values()))):
                raise TrainingError(
                    f"step {done}: a loss is not finite ({losses}); the last good step is kept in "
                    f"{folder / 'checkpoints'}"
                )
            row: dict[str, Any] = {"step": done, **losses}
            if done % config.validate_every == 0 or done >= config.steps:
                row |= _validate(run, _validated(config, state), batches)
                if row["val_score"] <= min(
                    (old["val_score"] for old in history if "val_score" in old), default=np.inf
                ):
                    best = jax.tree.map(np.array, _validated(config, state))
                history.append(row)
                checkpoints.save(
                    done, (state, best), {**record, "history": history}, row["val_score"]
                )
            else:
                history.append(row)
            shown = {"loss": row["g_loss"]} | {
                name: value
                for old in history[-config.validate_every // CHUNK - 1 :]
                for name, value in old.items()
                if name in {"val_ade", "val_fde"}
            }
            bar.set_postfix({name: f"{value:.3f}" for name, value in shown.items()})
            _append(folder / "metrics.jsonl", history)
        bar.close()
    model = Model(run.generator, best, run.scene)
    _write_curves(folder, history)
    if not (folder / "model").exists():
        save_model(folder / "model", model)
    return model


def _program(generator: GeneratorConfig, config: TrainConfig, key: jax.Array):
    """`(state, groups of CHUNK steps) -> (state, metrics [CHUNK])`, compiled; state is donated."""

    def one(state: TrainState, batches):
        # The key follows from the step, not from where the run was interrupted.
        return train_step(generator, config, state, batches, jax.random.fold_in(key, state.step))

    return jax.jit(lambda state, groups: jax.lax.scan(one, state, groups), donate_argnums=0)


def _validated(config: TrainConfig, state: TrainState) -> Any:
    return state.average if config.ema else state.generator


def _validate(run: Run, params: Any, batches: list[Batch]) -> dict[str, float]:
    """Joint best-of-k errors on the validation windows; `val_score` chooses the best state."""
    start = time.perf_counter()
    result = evaluate(
        GeneratorForecaster(run.generator),
        params,
        batches,
        samples=run.config.best_k,
        seed=run.config.seed,
        with_collisions=False,
    )
    ade, fde = result.mean("joint_ade"), result.mean("joint_fde")
    score = ade + fde if run.config.select_by == "ade_fde" else ade
    return {
        "val_ade": ade,
        "val_fde": fde,
        "val_score": score,
        "val_seconds": time.perf_counter() - start,
    }


def _resumed(found: tuple[int, Any, dict[str, Any]], run: Run, folder: Path, resume: bool):
    step, (state, best), record = found
    if not resume:
        raise InputError(f"{folder}: holds a run at step {step}; --resume continues it")
    for name, value in run.describe().items():
        if record.get(name) != json.loads(json.dumps(value)):
            raise InputError(f"{folder}: holds another run: its {name} differs")
    return state, best, list(record["history"])


def _append(path: Path, history: list[dict[str, Any]]) -> None:
    """The whole history, line by line; rewritten, so that a resumed run has no line twice."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(json.dumps(row) + "\n" for row in history))


def _write_curves(folder: Path, history: list[dict[str, Any]]) -> None:
    from neurosym_jax.plotting import plot_training, save_figure

    def curve(name: str) -> tuple[list[float], list[float]]:
        rows = [row for row in history if name in row]
        return [row["step"] for row in rows], [row[name] for row in rows]

    losses = [name for name in ("g_loss", "g_adversarial", "d_loss") if name in history[0]]
    figure = plot_training(
        {name: curve(name) for name in losses},
        {"ADE": curve("val_ade"), "FDE": curve("val_fde")},
        "training",
    )
    save_figure(figure, folder / "curves.png")
