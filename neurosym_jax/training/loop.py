"""The training loop: rounds of compiled steps, validation, checkpoints, and the files of a run.

A run is a folder: `checkpoints/` (to resume from), `metrics.jsonl`, and at its end `curves.png`,
`run.json` (all facts of the run) and `model/`, the best state by validation and its card.
Everything random follows from (seed, step), so a resumed run continues bit for bit.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from neurosym_jax.data.batching import Batch, make_batches
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.plugins import loaded, names
from neurosym_jax.runtime.environment import run_environment
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.symbolic.weighting import initial_parameters
from neurosym_jax.training.checkpoints import TrainingCheckpoints
from neurosym_jax.training.dead_pooling import EFFECT, neighbour_effect, warn_if_dead
from neurosym_jax.training.finish import best_of, write_curves, write_model
from neurosym_jax.training.lock import sole_writer
from neurosym_jax.training.metrics_log import MetricsLog
from neurosym_jax.training.recipe import RECIPES, TrainConfig
from neurosym_jax.training.run import Run, refuse_other_run
from neurosym_jax.training.step import TrainState, initial_state, train_steps
from neurosym_jax.training.stream import SceneStream

__all__ = ["CHUNK", "train", "train_run"]

Row = dict[str, Any]

CHUNK = 25
"""Most steps of one compiled call, between two updates of the progress bar."""


def train(
    training: Windows | Sequence[Tracks],
    validation: Windows | Sequence[Tracks],
    folder: Path | str,
    *,
    generator: GeneratorConfig | None = None,
    recipe: TrainConfig | None = None,
    dataset: str | None = None,
    data_name: str = "data not named",
    resume: bool = False,
    on_row: Callable[[Row], object] = lambda row: None,
) -> Model:
    """Train a generator; the module's text lists the files that it leaves in `folder`.

    Args:
        training: recordings to cut windows from, or the windows.
        validation: the same; the state with the least error on these is kept.
        folder: of the run.
        generator: the network; default: SGAN's. Its period becomes that of the data.
        recipe: how the network is trained; default: `ours`.
        dataset: the data set that was left out, to be tested on; recorded with the model.
        data_name: of the training data, for people.
        resume: continue the run in `folder`.
        on_row: called with each row of `metrics.jsonl`, for a dashboard of one's own.

    Returns:
        The best model by validation, also written to `folder / "model"`.

    Raises:
        InputError: for recordings without windows, and as `train_run`.
    """
    generator = generator or GeneratorConfig()
    lengths = generator.obs_len, generator.pred_len
    learned, validated = (
        part if isinstance(part, Windows) else cut_windows(part, *lengths)
        for part in (training, validation)
    )
    generator = dataclasses.replace(generator, period=learned.period)
    run = Run(generator, recipe or RECIPES["ours"], learned, validated, dataset, data_name)
    return train_run(run, Path(folder), resume=resume, on_row=on_row)


def train_run(
    run: Run,
    folder: Path,
    *,
    resume: bool = False,
    on_row: Callable[[Row], object] = lambda row: None,
) -> Model:
    """Train from the start, or from the newest good checkpoint in `folder`; see `train`.

    Raises:
        InputError: when `folder` holds a run already (and `resume` is not given), or another run.
        TrainingError: when a loss or metric is not finite; the last good step stays on disk.
    """
    with sole_writer(folder):
        return _train(run, folder, resume, on_row)


def _train(run: Run, folder: Path, resume: bool, on_row: Callable[[Row], object]) -> Model:
    config = run.recipe
    networks = 2 if config.adversarial_weight else 1  # A step takes a batch for each.
    stream = SceneStream(run.training, config.batch_scenes, config.seed, config.max_agents)
    _refuse_too_large(run, stream.shapes)
    batches = make_batches(run.validation)
    of_state, of_steps = (jax.random.fold_in(jax.random.key(config.seed), part) for part in (0, 1))
    example = jax.tree.map(lambda leaf: leaf[0, 0], stream.steps(0, 1)[0])
    weighting = initial_parameters(run.generator.weighting, _observed(run.training))
    state = initial_state(run.generator, config, example, of_state, weighting)
    best = _copy(_validated(config, state))
    validations: list[Row] = []
    record = {**run.describe(), "environment": run_environment()}

    checkpoints = TrainingCheckpoints(folder / "checkpoints")
    if (found := checkpoints.restore((state, best))) is not None:
        step, (state, best), before = found
        if not resume:
            raise InputError(f"{folder}: holds a run at step {step}; --resume continues it")
        refuse_other_run(before, record, folder)
        validations = [row for row in before["history"] if "val_score" in row]
    elif (folder / "model").exists():
        raise InputError(f"{folder}: holds a finished model, and nothing is overwritten")
    done = int(state.step)
    log = MetricsLog(folder / "metrics.jsonl", done)
    # tqdm's None shows the bar in a terminal only.
    with tqdm(total=config.steps, initial=done, unit="step", disable=None) as bar:
        while done < config.steps:
            to_validation = config.validate_every - done % config.validate_every
            count = min(CHUNK, to_validation, config.steps - done)
            groups = jax.tree.map(
                lambda leaf, count=count: leaf.reshape(count, networks, *leaf.shape[1:]),
                stream.steps(done * networks, count * networks),
            )
            state, metrics = train_steps(run.generator, config, of_steps, state, groups)
            row: Row = {"step": done + count}
            row |= {name: float(np.mean(value)) for name, value in metrics.items()}
            _refuse_not_finite(row, folder, done, validations)
            if validated := count == to_validation or row["step"] == config.steps:
                row |= _validate(run, _validated(config, state), batches)
                _refuse_not_finite(row, folder, done, validations)
                if row["val_score"] <= min(
                    (old["val_score"] for old in validations), default=np.inf
                ):
                    best = _copy(_validated(config, state))
                validations.append(row)
                warn_if_dead(row)
            log.append(row)
            on_row(row)
            if validated:
                saved = {**record, "history": validations}
                checkpoints.save(row["step"], (state, best), saved, row["val_score"])
            done += count
            bar.set_postfix(_progress(row, validations), refresh=False)
            bar.update(count)
    kept = best_of(validations)
    warn_if_dead(kept)
    model = Model(
        run.generator,
        best,
        run.dataset,
        plugins=names(loaded()),
        neighbours=kept.get("val_neighbour_near"),
    )
    write_curves(folder, log.rows())
    write_model(folder, model, {**record, **run.data_facts()}, validations)
    return model


def _refuse_too_large(run: Run, shapes: Sequence[tuple[int, int]]) -> None:
    """Refuse a batch of these (scenes, slots) of each size class that memory cannot hold.

    A lower bound: positions of a round's batches, the k forecasts of one, and the numbers that
    pooling keeps of each pair for its gradient.
    """
    config, generator = run.recipe, run.generator
    slots = sum(scenes * size for scenes, size in shapes)
    pairs = sum(scenes * size**2 for scenes, size in shapes)
    batches = CHUNK * (2 if config.adversarial_weight else 1)
    numbers = batches * slots * 2 * (2 * generator.obs_len + generator.pred_len)
    numbers += config.best_k * slots * (2 * generator.pred_len + generator.decoder_h_dim)
    numbers += 2 * pairs * generator.pooling.pair_numbers
    remedy = "lower batch_scenes, best_k or max_agents with --set"
    refuse_beyond_memory(f"a batch of {config.batch_scenes} scenes", 4 * numbers, remedy)


def _observed(windows: Windows) -> Iterator[tuple[Any, Any]]:
    """Batches (positions, valid) from which a weighting may be estimated."""
    for batch in make_batches(windows):
        yield batch.scene.observed, batch.scene.valid


def _copy(params: Any) -> Any:
    """A copy on the host: the next step takes over the buffers of `params`."""
    return jax.tree.map(np.array, params)


def _refuse_not_finite(row: Row, folder: Path, done: int, validations: list[Row]) -> None:
    bad = [f"{name} {value}" for name, value in row.items() if not np.isfinite(value)]
    if bad:
        kept = "no step had been saved"
        if validations:
            kept = f"step {validations[-1]['step']} is kept in {folder / 'checkpoints'}"
        raise TrainingError(
            f"{folder}: between step {done} and step {row['step']} training came to numbers that "
            f"are not finite: {', '.join(bad)}; {kept}"
        )


def _progress(row: Row, validations: list[Row]) -> dict[str, str]:
    """Values beside the progress bar."""
    short = {"g_variety": "loss", "g_adversarial": "g_adv", "d_loss": "d"}
    values = {short[name]: row[name] for name in short if name in row}
    values |= {name: row[name] for row in validations[-1:] for name in ("val_ade", "val_fde")}
    return {name: f"{value:.3f}" for name, value in values.items()}


def _validated(config: TrainConfig, state: TrainState) -> Any:
    return state.average if config.ema else state.generator


def _validate(run: Run, params: Any, batches: list[Batch]) -> dict[str, float]:
    """Joint best-of-k errors on the validation windows; `val_score` chooses the best state."""
    forecaster = GeneratorForecaster(run.generator)
    result = score_forecaster(
        forecaster,
        params,
        batches,
        samples=run.recipe.best_k,
        seed=run.recipe.seed,
        metrics=("joint_ade", "joint_fde", *(EFFECT if forecaster.sees_neighbours else ())),
    )
    ade, fde = result.mean("joint_ade"), result.mean("joint_fde")
    score = ade + fde if run.recipe.select_by == "ade_fde" else ade
    row = {"val_ade": ade, "val_fde": fde, "val_score": score}
    return row | neighbour_effect(result, run.generator, params, batches)
