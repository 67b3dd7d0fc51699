"""The training loop: rounds of compiled steps, validation, saved states, and the files of a run.

A run is a folder: `recipe.yaml` (the options that repeat it), `checkpoints/` (to resume from),
`metrics.jsonl`, and at its end `curves.png`, `run.json` (all facts of the run) and `model/`, the
best state by validation and its card.
"""

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tqdm import tqdm

from neurosym_jax.data.formats import recordings_in
from neurosym_jax.data.leakage import fingerprint
from neurosym_jax.data.sources import licences_of
from neurosym_jax.data.windows import Batch, Windows, cut_windows, make_batches
from neurosym_jax.errors import InputError, TrainingError, option
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.forecaster import forecaster_of
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import save_model
from neurosym_jax.plugins import loaded, names
from neurosym_jax.runtime.files import append_text, write_json, write_text
from neurosym_jax.runtime.process import code_version
from neurosym_jax.training.catalogue import make_config, recipes_of
from neurosym_jax.training.checkpoints import restore_state, save_state, sole_writer
from neurosym_jax.training.recipe import Recipe
from neurosym_jax.training.run import ROUND, Run, model_card, record_of
from neurosym_jax.training.state import TrainState

__all__ = ["train", "train_run"]

Row = dict[str, Any]

EFFECT = ("neighbour_share", "neighbour_near", "neighbour_move")
"""The metrics of a validation by which a pooling is judged."""
LEAST = 0.5
"""Least share of people with somebody within 2 m whom a living pooling changes."""


def train(
    training: Any,
    validation: Any,
    folder: Path | str,
    *,
    config: Any = None,
    recipe: Recipe | None = None,
    dataset: str | None = None,
    data: Sequence[str] = (),
    resume: bool = False,
    on_row: Callable[[Row], object] = lambda row: None,
) -> Model:
    """Train a model; return the best by validation, which `folder / "model"` then holds.

    Args:
        training: `Windows` (see `windows_from`), or what they are cut from: `Tracks` on one grid,
            files, folders, dataframes, or several of these.
        validation: the same; the state with the least error on these is kept.
        folder: of the run.
        config: of what is trained, such as `AnchorConfig` or a plugin's; default: SGAN's. Its
            period becomes that of the data.
        recipe: how it is trained; default: the usual one of its family.
        dataset: the data set that was left out, to be tested on; recorded with the model.
        data: names of the data sets learned from, for the card and licences.
        resume: continue the run in `folder`.
        on_row: called with each row of `metrics.jsonl`.

    Raises:
        InputError: for recordings without windows, and as `train_run`.
    """
    config = config or make_config("sgan")
    recipe = recipe or next(iter(recipes_of(type(forecaster_of(config))).values()))

    lengths = config.obs_len, config.pred_len
    learned, validated = (
        part
        if isinstance(part, Windows)
        else cut_windows(recordings_in(part), *lengths, min_agents=least)
        for part, least in ((training, recipe.min_agents), (validation, 2))
    )
    config = dataclasses.replace(config, period=learned.period)
    run = Run(config, recipe, learned, validated, dataset, tuple(data))
    return train_run(run, Path(folder), resume=resume, on_row=on_row)


def train_run(
    run: Run,
    folder: Path,
    *,
    resume: bool = False,
    on_row: Callable[[Row], object] = lambda row: None,
) -> Model:
    """Train from the start, or from the newest good state in `folder`; see `train`.

    Raises:
        InputError: when `folder` holds a run already (and `resume` is not given), or another run.
        TrainingError: when a loss or metric is not finite; the last good state stays on disk.
    """
    recipe, record = run.recipe, record_of(run)
    # tqdm's None shows the bar in a terminal only.
    bar = tqdm(total=recipe.steps, unit="step", disable=None)
    with sole_writer(folder), bar:
        batches, advance = make_batches(run.validation), run.rounds()
        state, best, rows = _begin(run, folder, record if resume else None)
        log, done = folder / "metrics.jsonl", int(state.step)
        write_text(log, "".join(map(_line, rows)))
        bar.update(done)
        while done < recipe.steps:
            to_validation = recipe.validate_every - done % recipe.validate_every
            count = min(ROUND, to_validation, recipe.steps - done)
            state, metrics = advance(state, done, count)
            row: Row = {"step": done + count}
            row |= {name: float(np.mean(value)) for name, value in metrics.items()}
            validates = count == to_validation or row["step"] == recipe.steps
            if validates and np.isfinite([*row.values()]).all():
                row |= _validate(run, state, batches)
            if bad := [f"{name} {value}" for name, value in row.items() if not np.isfinite(value)]:
                raise TrainingError(
                    f"{folder}: between step {done} and step {row['step']} training came to "
                    f"numbers that are not finite: {', '.join(bad)}; what was saved before is kept"
                )
            rows.append(row)
            if _best(rows) is row:
                best = _kept(run, state)
            append_text(log, _line(row))
            on_row(row)
            if validates:
                saved = {**record, "rows": rows}
                save_state(folder / "checkpoints", row["step"], (state, best), saved)
            done += count
            numbers = {name: f"{row[name]:.3f}" for name in row if name.endswith(("loss", "ade"))}
            bar.set_postfix(numbers, refresh=False)
            bar.update(count)
        return _finish(run, folder, best, rows, record)


def _begin(
    run: Run, folder: Path, record: dict[str, Any] | None
) -> tuple[TrainState, Any, list[Row]]:
    """The state, the best parameters and the rows so far; `record` of a run to be resumed."""
    state = run.init_state()
    best = _kept(run, state)
    restored, again = restore_state(folder / "checkpoints", (state, best)), option("resume", True)
    if restored is None and (folder / "model").exists():
        raise InputError(f"{folder}: holds a finished model, and nothing is overwritten")
    if restored is None and record is None and any((folder / "checkpoints").glob("damaged_*")):
        raise InputError(f"{folder}: holds a run whose states are damaged; {again} begins it anew")
    rows: list[Row] = []
    if restored is not None:
        (state, best), before = restored
        if record is None:
            raise InputError(f"{folder}: holds a run at step {state.step}; {again} continues it")
        _refuse_other_run(before, record, folder)
        rows = before["rows"]
    if run.options:
        write_text(folder / "recipe.yaml", run.options)
    return state, best, rows


def _refuse_other_run(before: dict[str, Any], record: dict[str, Any], folder: Path) -> None:
    """Refuse to resume a run that differs; warn of another environment."""
    record = json.loads(json.dumps(record))
    for name, value in record.items():
        if name != "environment" and before[name] != value:
            raise InputError(f"{folder}: holds another run: its {name} differs")
    for name, now in record["environment"].items():
        if (then := before["environment"].get(name)) != now:
            text = f"the run began with {name} {then} and goes on with {now}: other bits"
            print(f"warning: {folder}: {text}", file=sys.stderr)


def _finish(run: Run, folder: Path, best: Any, rows: list[Row], record: dict[str, Any]) -> Model:
    """Write what a finished run leaves, unless it is there."""
    from neurosym_jax.plotting import plot_training, save_figure

    best_row = _best(rows)
    origin = {"plugins": names(loaded()), "data": licences_of(run.data)}
    near, seen = best_row.get("val_neighbour_near"), fingerprint(run.training)
    model = Model(
        run.config,
        best,
        run.dataset,
        run.forecaster.key,
        seed=run.recipe.seed,
        neighbours=near,
        seen=seen,
        **origin,
    )
    if (folder / "model").exists():
        return model
    parts = {"training": run.training, "validation": run.validation}
    facts = {
        **record,
        "samples": run.samples,
        "licences": model.data,
        "counts": {name: {"scenes": w.scenes, "agents": w.agents} for name, w in parts.items()},
        "recordings": {
            name: [dataclasses.asdict(reading) for reading in w.reading]
            for name, w in parts.items()
        },
        "parameters": sum(leaf.size for leaf in jax.tree.leaves(best)),
        "code": code_version(),
        "plugins": list(model.plugins),
        "validation": best_row,
    }

    def curves(*metrics: str) -> dict[str, Any]:
        pairs = {name: [(r["step"], r[name]) for r in rows if name in r] for name in metrics}
        return {name: tuple(zip(*points)) for name, points in pairs.items() if points}

    losses = curves("loss", "g_loss", "g_adversarial", "d_loss")
    figure = plot_training(losses, curves("val_ade", "val_fde"), "training")
    save_figure(figure, folder / "curves.png")
    write_json(folder / "run.json", facts)
    # Last: a run that has a model is whole, whatever kills the process.
    save_model(folder / "model", model, model_card(facts))
    return model


def _kept(run: Run, state: TrainState) -> Any:
    """The parameters that are validated and kept, on the host: a step takes over their buffers."""
    return jax.tree.map(np.array, state.average if run.recipe.ema else state.params)


def _best(rows: list[Row]) -> Row:
    """The row of the best validation, of equals the newest; an empty one before the first."""
    validated = [row for row in rows if "val_score" in row]
    return min(reversed(validated), key=lambda row: row["val_score"], default={})


def _line(row: Row) -> str:
    return json.dumps(row, allow_nan=False) + "\n"


def _validate(run: Run, state: TrainState, batches: list[Batch]) -> Row:
    """Joint best-of-k errors on the validation windows; `val_score` chooses the best state.

    Warns of a dead pooling.
    """
    forecaster = run.forecaster
    result = score_forecaster(
        forecaster,
        _kept(run, state),
        batches,
        samples=run.samples,
        seed=run.recipe.seed,
        metrics=("joint_ade", "joint_fde", *(EFFECT if forecaster.sees_neighbours else ())),
    )
    ade, fde = result.mean("joint_ade"), result.mean("joint_fde")
    score = ade + fde if run.recipe.select_by == "ade_fde" else ade
    effect = {name: result.mean(name) for name in EFFECT if name in result.scores}
    if effect.get("neighbour_near", 1.0) < LEAST:
        print(
            f"warning: dead pooling at step {state.step}: {effect['neighbour_share']:.0%} of "
            "people are changed by their neighbours",
            file=sys.stderr,
        )
    row = {"val_ade": ade, "val_fde": fde, "val_score": score}
    return row | {f"val_{name}": value for name, value in effect.items() if np.isfinite(value)}
