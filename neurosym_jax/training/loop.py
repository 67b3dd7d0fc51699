"""The training loop: rounds of compiled steps, validation, checkpoints, and the files of a run.

A run is a folder: `checkpoints/` (to resume from), `metrics.jsonl`, and at its end `curves.png`,
`run.json` (all facts of the run) and `model/`, the best state by validation and its card.
Everything random follows from (seed, step), so a resumed run continues bit for bit.
"""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from neurosym_jax.data.batching import Batch, make_batches
from neurosym_jax.data.leakage import fingerprint
from neurosym_jax.data.licences import licences_of
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.plugins import loaded, names
from neurosym_jax.runtime.environment import run_environment
from neurosym_jax.training.anchor_objective import AnchorObjective
from neurosym_jax.training.checkpoints import TrainingCheckpoints
from neurosym_jax.training.dead_pooling import EFFECT, neighbour_effect, warn_if_dead
from neurosym_jax.training.finish import best_of, write_curves, write_model
from neurosym_jax.training.generator_objective import GeneratorObjective
from neurosym_jax.training.lock import sole_writer
from neurosym_jax.training.metrics_log import MetricsLog
from neurosym_jax.training.objective import CHUNK, Objective
from neurosym_jax.training.recipe import RECIPES, Recipe
from neurosym_jax.training.run import Run, refuse_other_run

__all__ = ["train", "train_run"]

Row = dict[str, Any]

OBJECTIVES: dict[str, Callable[[Run], Objective]] = {
    "generator": GeneratorObjective,
    "anchors": AnchorObjective,
    "anchor_table": AnchorObjective,
}
"""How each kind of forecaster is trained."""


def train(
    training: Windows | Sequence[Tracks],
    validation: Windows | Sequence[Tracks],
    folder: Path | str,
    *,
    network: Any = None,
    recipe: Recipe | None = None,
    dataset: str | None = None,
    data_name: str = "data not named",
    data: Sequence[str] = (),
    resume: bool = False,
    on_row: Callable[[Row], object] = lambda row: None,
) -> Model:
    """Train a model; the module's text lists the files that it leaves in `folder`.

    Args:
        training: recordings to cut windows from, or the windows.
        validation: the same; the state with the least error on these is kept.
        folder: of the run.
        network: a `GeneratorConfig`, `AnchorConfig` or `AnchorTableConfig`; default: SGAN's. Its
            period becomes that of the data.
        recipe: how the network is trained; default: `ours`, or `anchors` for one.
        dataset: the data set that was left out, to be tested on; recorded with the model.
        data_name: of the training data, for people.
        data: names of the data sets learned from, for their licences.
        resume: continue the run in `folder`.
        on_row: called with each row of `metrics.jsonl`, for a dashboard of one's own.

    Returns:
        The best model by validation, also written to `folder / "model"`.

    Raises:
        InputError: for recordings without windows, and as `train_run`.
    """
    network = network or GeneratorConfig()
    if recipe is None:
        recipe = RECIPES["ours" if isinstance(network, GeneratorConfig) else "anchors"]
    learned, validated = (
        part
        if isinstance(part, Windows)
        else cut_windows(part, network.obs_len, network.pred_len, min_agents=least)
        for part, least in ((training, recipe.min_agents), (validation, 2))
    )
    network = dataclasses.replace(network, period=learned.period)
    run = Run(network, recipe, learned, validated, dataset, data_name, tuple(data))
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
    objective = OBJECTIVES[run.kind](run)
    batches = make_batches(run.validation)
    state = objective.start()
    best = _copy(objective.params(state))
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
            state, metrics = objective.advance(state, done, count)
            row: Row = {"step": done + count}
            row |= {name: float(np.mean(value)) for name, value in metrics.items()}
            _refuse_not_finite(row, folder, done, validations)
            if validated := count == to_validation or row["step"] == config.steps:
                row |= _validate(run, objective.params(state), batches)
                _refuse_not_finite(row, folder, done, validations)
                if row["val_score"] <= min(
                    (old["val_score"] for old in validations), default=np.inf
                ):
                    best = _copy(objective.params(state))
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
    about: dict[str, Any] = {
        "plugins": names(loaded()),
        "neighbours": kept.get("val_neighbour_near"),
    }
    about |= {"seen": fingerprint(run.training), "data": licences_of(run.data)}
    model = Model(run.network, best, run.dataset, run.kind, **about)
    write_curves(folder, log.rows())
    write_model(folder, model, {**record, **run.data_facts()}, validations)
    return model


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
    short = {"loss": "loss", "g_variety": "loss", "g_adversarial": "g_adv", "d_loss": "d"}
    values = {short[name]: row[name] for name in short if name in row}
    values |= {name: row[name] for row in validations[-1:] for name in ("val_ade", "val_fde")}
    return {name: f"{value:.3f}" for name, value in values.items()}


def _validate(run: Run, params: Any, batches: list[Batch]) -> dict[str, float]:
    """Joint best-of-k errors on the validation windows; `val_score` chooses the best state."""
    forecaster = FORECASTERS[run.kind](run.network)
    result = score_forecaster(
        forecaster,
        params,
        batches,
        samples=run.samples,
        seed=run.recipe.seed,
        metrics=("joint_ade", "joint_fde", *(EFFECT if forecaster.sees_neighbours else ())),
    )
    ade, fde = result.mean("joint_ade"), result.mean("joint_fde")
    score = ade + fde if run.recipe.select_by == "ade_fde" else ade
    row = {"val_ade": ade, "val_fde": fde, "val_score": score}
    return row | neighbour_effect(result, run.network, params, batches)
