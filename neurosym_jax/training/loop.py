"""The training of any family: rounds of steps, validation, the best and the last state."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from tqdm import tqdm

from neurosym_jax.data.tables import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.windows import make_batches
from neurosym_jax.errors import InputError, TrainingError, option
from neurosym_jax.models.disk import load_model
from neurosym_jax.models.forecast import Model
from neurosym_jax.training.custom import SceneLoss, make_custom
from neurosym_jax.training.preparation import prepare
from neurosym_jax.training.recipe import Recipe
from neurosym_jax.training.run import (
    ROUND,
    Advice,
    Row,
    Run,
    RunFiles,
    best_row,
    is_over,
    make_config,
    record_of,
    refuse_other_run,
    usual_recipe,
    validate,
)
from neurosym_jax.training.state import (
    TrainState,
    restore_state,
    save_state,
    sole_writer,
)

__all__ = ["Progress", "train", "train_run"]


# What a training tells while it runs: the bar, and what is compiled.

STEP, VALIDATION = "the training step", "the validation"


class Progress:
    """The progress of a run of `steps` steps on the standard error, from the first second on."""

    def __init__(self, steps: int, *, quiet: bool = False):
        """Show a bar, in a terminal only."""
        self._quiet = quiet
        self._programs = {STEP, VALIDATION}
        # tqdm's None shows the bar in a terminal only.
        self.bar = tqdm(total=steps, unit="step", disable=True if quiet else None)

    def tell_compiling(self, program: str) -> None:
        """Say that a program is compiled, the first time that it is run."""
        if program in self._programs and not self._quiet:
            text = f"compiling {program}: usually 5 to 60 s, once on this machine"
            self.bar.write(text, file=sys.stderr)
        self._programs.discard(program)

    def go_to(self, step: int, metrics: Mapping[str, Any]) -> None:
        """Show a number of steps, and losses and errors."""
        numbers = {}
        for name, value in metrics.items():
            if name.endswith(("loss", "ade")):
                numbers[name] = f"{value:.3f}"
        self.bar.set_postfix(numbers, refresh=False)
        self.bar.update(step - self.bar.n)


# The training loop: rounds of compiled steps, validation and saved states.
#
# The best state by validation is a model on the disk from the first validation on, so a
# run that ends early, whatever ends it, can be used; see `run_files`.


class _Session(NamedTuple):
    """How far a run is: what is saved after each validation."""

    state: TrainState
    best: Any
    """The parameters of the best validation."""
    rows: tuple[Row, ...]
    is_slower: bool
    """Whether the steps are smaller, since numbers were not finite once."""


def train(
    training: Any,
    validation: Any = None,
    folder: Path | str = "runs/run",
    *,
    config: Any = None,
    recipe: Recipe | None = None,
    init: Model | Path | str | None = None,
    tested: Any = None,
    fold: str | None = None,
    read: ReadOptions = AS_IT_SAYS,
    dataset: str | None = None,
    data: Sequence[str] = (),
    loss: SceneLoss | None = None,
    optimizer: Any = None,
    schedule: Mapping[str, Callable[[Any], Any]] | None = None,
    resume: bool = False,
    quiet: bool = False,
    on_row: Callable[[Row], object] = lambda row: None,
) -> Model:
    """Train a model; return the best by validation, which `folder / "model"` then holds.

    Args:
        training: `Windows` (see `windows_from`), or recordings, which are resampled to
            the steps of `config`: `Tracks`, files, folders, dataframes, or several.
        validation: the same; the state with the least error on these is kept. None
            keeps a part of the recordings for it.
        folder: of the run.
        config: of what is trained, such as `AnchorConfig` or a plugin's; default: that
            of `init`, or else SGAN's.
        recipe: how it is trained; default: the usual one of its family.
        init: the model whose parameters it starts from, or what `load_model` takes.
        tested: recordings to be tested on; refused where `training` has them.
        fold: K/N, see `training.preparation.prepare`.
        read: how files are read, and the guards that are waived.
        dataset: the data set that was left out to be tested on; the model records it.
        data: names of the data sets learned from, for the card and licences.
        loss: `(forecast [k, N, pred_len, 2], scene) -> []`, in place of the family's;
            its mean over scenes is trained.
        optimizer: of optax, in place of Adam and the recipe's learning rate; the
            recipe's clipping goes before it.
        schedule: parameters that follow a function of the step in place of learning,
            by dotted path: `{"weighting.log_temperature": lambda step: ...}`.
        resume: continue the run in `folder`, to more steps if the recipe has more.
        quiet: tell no progress.
        on_row: called with each row of `metrics.jsonl`.

    Raises:
        InputError: see `training.preparation.prepare` and `train_run`.
    """
    init = load_model(init) if isinstance(init, Path | str) else init
    seen = init.seen if init else ""
    config = config or (init.config if init else make_config("sgan"))
    recipe = recipe or usual_recipe(config)
    parts = prepare(
        config, recipe, training, validation, tested, read=read, fold=fold, seen=seen
    )
    custom = make_custom(loss, optimizer, schedule)
    run = Run(config, recipe, *parts, dataset, tuple(data), init=init, custom=custom)
    return train_run(run, Path(folder), resume=resume, quiet=quiet, on_row=on_row)


def train_run(
    run: Run,
    folder: Path,
    *,
    resume: bool = False,
    quiet: bool = False,
    on_row: Callable[[Row], object] = lambda row: None,
) -> Model:
    """Train from the start, or from the newest good state in `folder`; see `train`.

    Raises:
        InputError: when `folder` holds a run already (and `resume` is not given), or
            another run.
        TrainingError: when numbers are not finite again after steps were made smaller;
            the best state stays on disk as a model.
    """
    recipe = run.recipe
    record = record_of(run)
    files = RunFiles(run, folder, record)
    progress = Progress(recipe.steps, quiet=quiet)
    with sole_writer(folder), progress.bar:
        rounds = _Rounds(files, progress, on_row)
        session = _begin(run, folder, record if resume else None)
        files.begin(session.rows)
        if session.rows and not files.finished:
            # A run may end between a state and its model.
            files.keep(session.best, best_row(session.rows))
        if run.init is not None and not session.rows:
            row = rounds.validated(session.state, {"step": 0})
            session = rounds.with_row(session, session.state, row)

        good = session
        done = int(session.state.step)
        advance = (run.slower() if session.is_slower else run).rounds()
        if not is_over(run, session.rows, done):
            files.unfinish()
        while not is_over(run, session.rows, done):
            to_validation = recipe.validate_every - done % recipe.validate_every
            count = min(ROUND, to_validation, recipe.steps - done)
            state, row = rounds.advanced(advance, session.state, done, count)
            validates = count == to_validation or row["step"] == recipe.steps
            if validates and not _not_finite(row):
                row = rounds.validated(state, row)
            bad = _not_finite(row)
            if bad:
                session = good = _slower(good, run, folder, done, bad)
                done = int(session.state.step)
                advance = run.slower().rounds()
                files.begin(session.rows)
                continue
            session = rounds.with_row(session, state, row)
            done += count
            if validates:
                good = session
        return files.finish(session.best, session.rows)


class _Rounds:
    """The steps and validations of a run, and what each of them writes and tells."""

    def __init__(
        self, files: RunFiles, progress: Progress, on_row: Callable[[Row], object]
    ):
        self._run = files.run
        self._files = files
        self._progress = progress
        self._on_row = on_row
        self._batches = make_batches(files.run.validation)
        self._advice = Advice(files.run)

    def advanced(
        self, advance: Callable[..., Any], state: TrainState, done: int, count: int
    ) -> tuple[TrainState, Row]:
        """The state after `count` further steps, and their row."""
        self._progress.tell_compiling(STEP)
        state, metrics = advance(state, done, count)
        row: Row = {"step": done + count}
        for name, value in metrics.items():
            row[name] = float(np.mean(value))
        return state, row

    def validated(self, state: TrainState, row: Row) -> Row:
        """A row with the errors on the validation set."""
        self._progress.tell_compiling(VALIDATION)
        return row | validate(self._run, _kept(self._run, state), self._batches)

    def with_row(self, session: _Session, state: TrainState, row: Row) -> _Session:
        """The session after a row, told and, where it was validated, saved."""
        rows = (*session.rows, row)
        best = session.best
        is_best = best_row(rows) is row
        is_validated = "val_score" in row
        if is_best:
            best = _kept(self._run, state)
        if is_validated:
            state = jax.tree.map(np.array, state)
            record = self._files.record | {"rows": rows, "is_slower": session.is_slower}
            # The state first: a run that ends here goes on from it. A model without a
            # state could only be thrown away.
            states = self._files.folder / "checkpoints"
            save_state(states, row["step"], (state, best), record)
        if is_best:
            self._files.keep(best, row)
        self._files.add(row)
        self._on_row(row)
        if is_validated:
            self._advice(rows)
        self._progress.go_to(row["step"], row)
        return _Session(state, best, rows, session.is_slower)


def _not_finite(row: Row) -> str:
    """The numbers of a row that are not finite, as text."""
    return ", ".join(
        f"{name} {value}" for name, value in row.items() if not np.isfinite(value)
    )


def _begin(run: Run, folder: Path, record: dict[str, Any] | None) -> _Session:
    """How far the run is; `record` of a run to be resumed."""
    # A step takes over buffers on the device.
    state = jax.tree.map(np.array, run.init_state())
    best = _kept(run, state)
    steps = [path.name[5:] for path in (folder / "checkpoints").glob("step_*")]
    if record is None and steps:
        step = int(max(steps))
        again = option("resume", True)
        raise InputError(f"{folder}: holds a run at step {step}; {again} continues it")

    def check(before: dict[str, Any]) -> None:
        refuse_other_run(before, record or {}, before["rows"][-1]["step"], folder)

    restored = restore_state(folder / "checkpoints", (state, best), check)
    if restored is not None:
        (state, best), before = restored
        return _Session(state, best, tuple(before["rows"]), before["is_slower"])
    if any((folder / name).exists() for name in ("model", "run.json")):
        raise InputError(
            f"{folder}: holds a model and no state to go on from; choose another"
        )
    if record is None and any((folder / "checkpoints").glob("damaged_*")):
        again = option("resume", True)
        raise InputError(
            f"{folder}: holds a run whose states are damaged; {again} begins it anew"
        )
    return _Session(state, best, (), False)


def _slower(good: _Session, run: Run, folder: Path, done: int, bad: str) -> _Session:
    """The last good session with smaller steps.

    Raises:
        TrainingError: where they are smaller already.
    """
    step = int(good.state.step)
    text = f"{folder}: after step {done} numbers are not finite: {bad}"
    if run.custom.optimizer is not None:
        raise TrainingError(f"{text}; give your optimizer a smaller learning rate")
    if good.is_slower:
        text += ", again, with smaller steps"
        best_step = best_row(good.rows).get("step")
        if best_step is not None:
            text += f"; its model is that of step {best_step}, a run can start there"
        raise TrainingError(text)
    rate = run.slower().recipe.learning_rate
    print(
        f"warning: {text}; it goes on from step {step} at learning_rate {rate:g}",
        file=sys.stderr,
    )
    return good._replace(is_slower=True)


def _kept(run: Run, state: TrainState) -> Any:
    """The parameters that are validated and kept, on the host: a step takes over their buffers."""
    params = state.average if run.recipe.ema else state.params
    return jax.tree.map(np.array, params)
