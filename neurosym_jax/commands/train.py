"""Train a model."""

import contextlib
import dataclasses
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Literal

from neurosym_jax.commands._options import (
    Reading,
    flags,
    given,
    open_data,
    options_text,
    plugin_flags,
    refuse_given,
    refuse_unused,
)
from neurosym_jax.data.recordings import (
    GENERAL,
    EthUcy,
    Files,
    Folders,
    Source,
    Synthetic,
)
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.tracks import PERIOD, describe_readings
from neurosym_jax.data.windows import Windows, cut_windows, make_batches, shared_shapes
from neurosym_jax.errors import InputError, optional_module
from neurosym_jax.evaluation.compare import baselines_of
from neurosym_jax.evaluation.scores import score_forecaster
from neurosym_jax.models.disk import load_model
from neurosym_jax.models.forecast import Model
from neurosym_jax.models.forecaster import forecaster_of
from neurosym_jax.training.loop import train_run
from neurosym_jax.training.preparation import describe_parts, prepare
from neurosym_jax.training.run import (
    OLD_NAMES,
    Run,
    make_config,
    make_recipe,
    recipes_of,
    refuse_other_recipe,
)

__all__ = ["Options", "closing_line", "configured", "make_run", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Train a model: `neurosym train` alone does so on the embedded simulations.

    `neurosym train FILE.yaml` reads options from a file; options after it prevail.
    """

    RENAMED: ClassVar[dict[str, str]] = OLD_NAMES
    FIRST: ClassVar[str] = "data dataset pred_len family weighting init steps out"
    GROUPS: ClassVar[dict[str, str]] = {
        "data": "data dataset pred_len obs_len period fold "
        "train_on validate_on train_also read",
        "model": "family weighting pooling network init steps",
        "output": "out resume quiet log",
    }
    family: str | None = None
    """Family of the model: sgan (default), neurosym (weights pairs of people by symbols),
    anchors (learned residuals with probabilities), anchor_table (its baseline), or a plugin's."""
    pooling: str | None = None
    """Pooling of SGAN: pool_net (default), none or social, or of NeuroSyM: as_described (default)
    or neurosym_ros; or one that a plugin registers."""
    weighting: str | None = None
    """Weighting of NeuroSyM (default: cnd) or anchors (default: none), KIND[,FIELD=VALUE...], see
    docs/extend.md."""
    dataset: str | None = None
    """Data set to leave out of training (eth, hotel, a file's name, ...); `general` trains on all.
    Of the simulations, the one to train on (default: all of them)."""
    obs_len: int | None = None
    """Observed steps; default: the --init model's, else 8."""
    pred_len: int | None = None
    """Steps to forecast; default: the --init model's, else 8."""
    period: float | None = None
    """Seconds between steps, after resampling; default: the --init model's, else 0.4."""
    init: str | None = None
    """Model to start from (name, folder or torch checkpoint), as to fine-tune `recommended`; it
    brings its network."""
    freeze: tuple[str, ...] = ()
    """Modules of the network that do not learn, such as encoder pooling."""
    recipe: str | None = None
    """How the model is trained: anchors for anchors and their table, else ours or sgan (as
    published), see docs/training.md; or a plugin's. Default: the first that fits."""
    seed: int = 0
    """Random seed for initialisation, data order, augmentation and noise."""
    steps: int | None = None
    """Steps of training; default: the recipe's."""
    set: tuple[str, ...] = ()
    """Changes to the recipe, NAME=VALUE, such as ema=0.999 or rotate=0."""
    network: tuple[str, ...] = ()
    """Changes to the network, NAME=VALUE, such as noise_type=uniform or encoder_h_dim=48."""
    data: Path | None = None
    """A recording, a folder of recordings, one with folders train, val and test, or ETH/UCY as SGAN
    arranges it; default: the download that has the data set, else the embedded simulations."""
    train_on: tuple[str, ...] = ()
    """Recordings to train on, files or folders, instead of a leave-one-out split."""
    validate_on: tuple[str, ...] = ()
    """Recordings to validate on, with --train-on; default: the last part of those."""
    train_also: tuple[Path, ...] = ()
    """Further files or folders to train on."""
    fold: str | None = None
    """Validate on part K of N, as 1/5: of the recordings if there are N, else of their times."""
    read: Reading = AS_IT_SAYS
    """How files are read."""
    out: Path | None = None
    """Folder of the run; default: runs/ and a name made of the options."""
    resume: bool = False
    """Continue the run in the folder, to more --steps if you say so."""
    quiet: bool = False
    """Show no progress."""
    log: Literal["tensorboard"] | None = None
    """Also write the metrics as TensorBoard's events to the run's folder."""


def run(options: Options) -> None:
    """Train as `options` say.

    Raises:
        InputError: see `make_run` and `training.train_run`.
    """
    run, source = make_run(options)
    data = options.data.stem if options.data else "simulations"
    where = run.dataset or ("files" if options.train_on else data)
    lengths = run.config.obs_len, run.config.pred_len
    name = "_".join(map(str, (run.forecaster.variant, where, *lengths)))
    recipe = options.recipe or next(iter(recipes_of(type(run.forecaster))))
    folder = options.out or Path("runs") / f"{name}_{recipe}_{options.seed}"
    print(
        f"{name}: {run.training.scenes} scenes, {run.training.agents} agents to train on, "
        f"{run.validation.scenes} scenes to validate on, {run.recipe.steps} steps"
    )
    text = describe_readings([*run.training.reading, *run.validation.reading])
    if text:
        print(f"{text}\n{describe_parts(run.training, run.validation)}")
    repeated = dataclasses.replace(options, out=folder, resume=False)
    run = dataclasses.replace(run, options=options_text(repeated))
    with contextlib.ExitStack() as stack:
        on_row = _tensorboard(folder, stack) if options.log else lambda row: None
        model = train_run(
            run, folder, resume=options.resume, quiet=options.quiet, on_row=on_row
        )
    _print_errors(run, model)
    print(f"model: {folder / 'model'}, step {model.step}")
    print(closing_line(options, run, source, folder))


def closing_line(options: Options, run: Run, source: Source, folder: Path) -> str:
    """The command that tests the model on what it has not seen; or that nothing is left for it."""
    datasets = (
        source.scenes if isinstance(source, Synthetic | Folders) else (run.dataset,)
    )
    if options.train_on:
        datasets = _unseen(run, source) if options.data else ()
    elif not {*datasets} <= {*source.scenes}:
        datasets = ()
    words = ["neurosym", "evaluate", "--model", str(folder)]
    options_of_run = []
    if run.config.period != PERIOD:
        options_of_run += ["--period", f"{run.config.period:g}"]
    options_of_run += plugin_flags()
    if not datasets:
        new = shlex.join([*words, "--data", "NEW_RECORDING", *options_of_run])
        return f"nothing is left to test on: test on a new recording: {new}"
    if options.data:
        words += ["--data", str(options.data)]
    if options.train_on:
        words += ["--test-on", *map(str, datasets)]
    words += [*flags(given(options.read)), *options_of_run]
    return f"test it: {shlex.join(words)}"


def _unseen(run: Run, source: Source) -> list[str]:
    """The recordings of a source that are neither learned from nor validated on, by content."""
    lengths = (run.config.obs_len, run.config.pred_len)
    names = list[str]()
    for path in source.paths:
        with contextlib.suppress(InputError):  # It may be too short for a window.
            windows = cut_windows(source.files([str(path)]), *lengths)
            if _is_new(windows, run.training) and _is_new(windows, run.validation):
                names.append(path.stem if isinstance(source, Files) else str(path))
    return names


def _is_new(windows: Windows, used: Windows) -> bool:
    """Whether hardly any shape in `windows` is in `used`."""
    shared, total = shared_shapes(windows, used)
    return shared <= 0.01 * total


def _tensorboard(
    folder: Path, stack: contextlib.ExitStack
) -> Callable[[dict[str, Any]], None]:
    """A function that writes a row of metrics to an event file in `folder`, closed by `stack`."""
    library = optional_module("tensorboardX", "--log tensorboard", "tensorboard")
    writers: list[Any] = []

    def write(row: dict[str, Any]) -> None:
        if not writers:
            # Steps beyond the saved state that a run resumes from are hidden.
            writers.append(library.SummaryWriter(str(folder), purge_step=row["step"]))
            stack.callback(writers[0].close)
        for name in sorted(row.keys() - {"step"}):
            writers[0].add_scalar(name, row[name], row["step"])
        writers[0].flush()

    return write


def _print_errors(run: Run, model: Model) -> None:
    """Print the validation errors of the model, which they chose, and of the baselines."""
    batches = make_batches(run.validation)
    print(
        f"on the {run.validation.scenes} validation scenes, joint best of {run.samples}, metres:"
    )
    lengths = run.config.obs_len, run.config.pred_len
    baselines = baselines_of(None, *lengths, run.dataset, run.samples)
    for _, scored in ((None, model), *baselines):
        result = score_forecaster(
            scored.forecaster,
            scored.params,
            batches,
            samples=run.samples,
            seed=run.recipe.seed,
            metrics=("joint_ade", "joint_fde"),
        )
        ade = result.mean("joint_ade")
        fde = result.mean("joint_fde")
        print(f"  {scored.name:26}  ADE {ade:.3f}  FDE {fde:.3f}")


def configured(options: Options) -> tuple[Any, Any, Model | None]:
    """The configuration, the recipe and the initial model that `options` describe.

    Raises:
        InputError: for options that contradict each other, or a change that does not
            fit.
    """
    chosen = {"pooling": options.pooling, "weighting": options.weighting}
    changes = [f"{name}={value}" for name, value in chosen.items() if value is not None]
    stated = {
        name: getattr(options, name) for name in ("obs_len", "pred_len", "period")
    }
    lengths = {name: value for name, value in stated.items() if value is not None}
    if options.init is None:
        init = None
        config = make_config(
            options.family or "sgan", **lengths, changes=[*changes, *options.network]
        )
    else:
        refuse_unused(
            options,
            ["family", *chosen, "network"],
            "with --init, which has its network",
        )
        init = load_model(
            options.init, dataset=options.dataset, pred_len=options.pred_len
        )
        config = init.config
        for name, value in lengths.items():
            has = getattr(config, name)
            if value != has:  # As its numbers mean it.
                flag = name.replace("_", "-")
                raise InputError(
                    f"--{flag} {value}: the model {options.init} has {has}"
                )
    forecaster = forecaster_of(config)
    name = options.recipe or next(iter(recipes_of(type(forecaster))))
    recipe = make_recipe(
        name, seed=options.seed, steps=options.steps, changes=options.set
    )
    refuse_other_recipe(forecaster, recipe)
    if options.freeze:
        recipe = dataclasses.replace(recipe, freeze=options.freeze)
    return config, recipe, init


def make_run(options: Options) -> tuple[Run, Source]:
    """The run that `options` describe, its data read, and the source of the data.

    Raises:
        InputError: for options that contradict each other or data that cannot be read.
    """
    config, recipe, init = configured(options)
    place, files = (options.data, options.read), (options.train_on, options.train_also)
    source = open_data(*place, options.dataset, *files, period=config.period)
    dataset, tested = options.dataset, None
    if options.train_on:
        refuse_unused(options, ["dataset"], "with --train-on")
        learned = source.files(options.train_on)
        validated = source.files(options.validate_on)
    else:
        refuse_given("without --train-on", validate_on=options.validate_on)
        if dataset is None and (isinstance(source, Folders) or len(source.scenes) == 1):
            dataset = GENERAL
        elif dataset is None and options.data is not None:
            names = ", ".join(source.scenes)
            raise InputError(f"--dataset is needed: one of {names}, or {GENERAL}")
        names = source.scenes if dataset is None else (dataset,)
        learned, validated = [], []
        for name in names:
            learned += source.recordings(name, "train")
            validated += source.recordings(name, "val")
        if isinstance(source, Folders):
            tested = []
            for name in source.scenes:
                tested += source.recordings(name)
            dataset = options.dataset
        elif dataset in source.scenes and not isinstance(source, Synthetic):
            tested = source.recordings(str(dataset))
    training, validation = prepare(
        config,
        recipe,
        learned,
        validated,
        tested,
        also=options.train_also,
        read=options.read,
        fold=options.fold,
        seen=init.seen if init else "",
    )
    first = source.name or (options.data.stem if options.data else "recordings")
    if isinstance(source, EthUcy):
        first = "ETH/UCY"
    run = Run(
        config=config,
        recipe=recipe,
        training=training,
        validation=validation,
        dataset=None if options.train_on else dataset or source.name or None,
        data=(first, *(place.stem for place in options.train_also)),
        init=init,
    )
    return run, source
