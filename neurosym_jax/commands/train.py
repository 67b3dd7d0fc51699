"""Train a model."""

import contextlib
import dataclasses
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from neurosym_jax.commands._options import Reading, open_data, options_text, refuse_unused
from neurosym_jax.data.clock import on_grid
from neurosym_jax.data.formats import recordings_in
from neurosym_jax.data.leakage import shared_shapes
from neurosym_jax.data.reading import AS_IT_SAYS
from neurosym_jax.data.sources import GENERAL, EthUcy, Source, Synthetic
from neurosym_jax.data.tracks import Tracks, describe_readings
from neurosym_jax.data.windows import Windows, cut_windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.plan import baselines_of
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.forecaster import forecaster_of
from neurosym_jax.forecasting.model import Model
from neurosym_jax.plugins import loaded
from neurosym_jax.training.catalogue import (
    make_config,
    make_recipe,
    recipes_of,
    refuse_other_recipe,
)
from neurosym_jax.training.loop import train_run
from neurosym_jax.training.run import Run

__all__ = ["Options", "configured", "make_run", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Train a model: `neurosym train` alone does so on the embedded simulations.

    `neurosym train FILE.yaml` reads options from a file; those after it override the file.
    """

    model: str = "sgan"
    """Network to train: sgan, neurosym (weights pairs of people by symbols), anchors (learned
    residuals with probabilities), anchor_table (its baseline, fixed offsets), or a plugin's."""
    pooling: str | None = None
    """Pooling of SGAN: pool_net (default), none or social, or of NeuroSyM: as_described (default)
    or neurosym_ros; or one that a plugin registers."""
    weighting: str | None = None
    """Weighting of NeuroSyM (default: cnd) or anchors (default: none), KIND[,FIELD=VALUE...], see
    docs/weightings.md."""
    dataset: str | None = None
    """Data set to leave out of training (eth, hotel, ...); `general` trains on all of ETH/UCY. Of
    the simulations, the one to train on (default: all of them)."""
    obs_len: int = 8
    """Observed steps."""
    pred_len: int = 8
    """Steps to forecast."""
    period: float = 0.4
    """Seconds between steps; recordings that have others are resampled."""
    recipe: str | None = None
    """How the model is trained: anchors for anchors and their table, else ours or sgan (as
    published), see docs/recipe.md; or a plugin's. Default: the first that fits."""
    seed: int = 0
    """Random seed for initialisation, data order, augmentation and noise."""
    steps: int | None = None
    """Steps of training; default: the recipe's."""
    set: tuple[str, ...] = ()
    """Changes to the recipe, NAME=VALUE, such as ema=0.999 or rotate=0."""
    network: tuple[str, ...] = ()
    """Changes to the network, NAME=VALUE, such as noise_type=uniform or encoder_h_dim=48."""
    data: Path | None = None
    """ETH/UCY as SGAN arranges it, or a folder of recordings; default: the download that has the
    data set, else the embedded simulations."""
    train_on: tuple[str, ...] = ()
    """Recordings to train on, by file name, instead of a leave-one-out split."""
    validate_on: tuple[str, ...] = ()
    """Recordings to validate on, by file name; needed with --train-on."""
    train_also: tuple[Path, ...] = ()
    """Additional recordings to train on, each a file or a folder of them."""
    read: Reading = AS_IT_SAYS
    """How files are read."""
    out: Path | None = None
    """Folder of the run; default: runs/ and a name made of the options."""
    resume: bool = False
    """Continue the run in the folder."""
    log: Literal["tensorboard"] | None = None
    """Also write the metrics as TensorBoard's events to the run's folder."""


def run(options: Options) -> None:
    """Train as `options` say.

    Raises:
        InputError: see `make_run` and `training.train_run`.
    """
    run = make_run(options)
    where = run.dataset or ("files" if options.train_on else "simulations")
    name = f"{run.forecaster.variant}_{where}_{options.obs_len}_{options.pred_len}"
    recipe = options.recipe or next(iter(recipes_of(type(run.forecaster))))
    folder = options.out or Path("runs") / f"{name}_{recipe}_{options.seed}"
    print(
        f"{name}: {run.training.scenes} scenes, {run.training.agents} agents to train on, "
        f"{run.validation.scenes} scenes to validate on, {run.recipe.steps} steps"
    )
    if text := describe_readings([*run.training.reading, *run.validation.reading]):
        print(text)
    repeated = dataclasses.replace(options, out=folder, resume=False)
    run = dataclasses.replace(run, options=options_text(repeated))
    with contextlib.ExitStack() as stack:
        on_row = _tensorboard(folder, stack) if options.log else lambda row: None
        model = train_run(run, folder, resume=options.resume, on_row=on_row)
    _print_errors(run, model)
    data = "" if options.data is None else f" --data {shlex.quote(str(options.data))}"
    place = shlex.quote(str(folder / "model"))
    plugins = "".join(f" --plugin {shlex.quote(plugin)}" for plugin in loaded())
    print(f"model: {place}\ntest it: neurosym evaluate --checkpoint {place}{data}{plugins}")


def _tensorboard(folder: Path, stack: contextlib.ExitStack) -> Callable[[dict[str, Any]], None]:
    """A function that writes a row of metrics to an event file in `folder`, closed by `stack`."""
    try:
        from tensorboardX import SummaryWriter  # pyright: ignore[reportMissingImports]
    except ImportError:
        needed = "pip install 'neurosym-jax[tensorboard]'"
        raise InputError(f"--log tensorboard needs tensorboardX: {needed}") from None
    writers: list[Any] = []

    def write(row: dict[str, Any]) -> None:
        if not writers:
            # Steps beyond the saved state that a run resumes from are hidden.
            writers.append(SummaryWriter(str(folder), purge_step=row["step"]))
            stack.callback(writers[0].close)
        for name in sorted(row.keys() - {"step"}):
            writers[0].add_scalar(name, row[name], row["step"])
        writers[0].flush()

    return write


def _print_errors(run: Run, model: Model) -> None:
    """Print the validation errors of the model, which they chose, and of the baselines."""
    batches = make_batches(run.validation)
    print(f"on the {run.validation.scenes} validation scenes, joint best of {run.samples}, metres:")
    lengths = run.config.obs_len, run.config.pred_len
    baselines = baselines_of(None, *lengths, run.dataset, run.samples)
    for each in (model, *(baseline for _, baseline in baselines)):
        found = score_forecaster(
            each.forecaster,
            each.params,
            batches,
            samples=run.samples,
            seed=run.recipe.seed,
            metrics=("joint_ade", "joint_fde"),
        )
        ade, fde = found.mean("joint_ade"), found.mean("joint_fde")
        print(f"  {each.name:26}  ADE {ade:.3f}  FDE {fde:.3f}")


def configured(options: Options) -> tuple[Any, Any]:
    """The configuration and the recipe that `options` describe.

    Raises:
        InputError: for options that contradict each other, or a change that does not fit.
    """
    chosen = {"pooling": options.pooling, "weighting": options.weighting}
    changes = [f"{name}={value}" for name, value in chosen.items() if value is not None]
    config = make_config(
        options.model,
        obs_len=options.obs_len,
        pred_len=options.pred_len,
        changes=[*changes, *options.network],
    )
    forecaster = forecaster_of(config)
    name = options.recipe or next(iter(recipes_of(type(forecaster))))
    recipe = make_recipe(name, seed=options.seed, steps=options.steps, changes=options.set)
    refuse_other_recipe(forecaster, recipe)
    return dataclasses.replace(config, period=options.period), recipe


def make_run(options: Options) -> Run:
    """The run that `options` describe, its data read.

    Raises:
        InputError: for options that contradict each other or data that cannot be read.
    """
    config, recipe = configured(options)
    place, files = (options.data, options.read), (options.train_on, options.train_also)
    source = open_data(*place, options.dataset, *files, period=options.period)
    learned, validated = _recordings(options, source)
    lengths = options.obs_len, options.pred_len
    training = cut_windows(learned, *lengths, min_agents=recipe.min_agents)
    parts = {"validated": cut_windows(validated, *lengths)}
    if options.dataset in source.scenes and not isinstance(source, Synthetic):
        with contextlib.suppress(InputError):  # It may be too short for a window.
            parts["tested"] = cut_windows(source.recordings(str(options.dataset)), *lengths)
    _refuse_seen(parts, training)
    if isinstance(source, EthUcy):
        first = "ETH/UCY"
    else:
        first = source.name or (options.data.stem if options.data else "recordings")
    return Run(
        config=dataclasses.replace(config, period=training.period),
        recipe=recipe,
        training=training,
        validation=parts["validated"],
        dataset=None if options.train_on else options.dataset or source.name or None,
        data=(first, *(place.stem for place in options.train_also)),
    )


def _recordings(options: Options, source: Source) -> tuple[list[Tracks], list[Tracks]]:
    """Those to train on and those to validate on."""
    if bool(options.train_on) != bool(options.validate_on):
        raise InputError("--train-on and --validate-on go together")
    if options.train_on:
        refuse_unused(options, ["dataset"], "with --train-on")
    if options.dataset is None and options.data is not None and not options.train_on:
        names = ", ".join(source.scenes)
        raise InputError(f"--dataset is needed: one of {names}, or {GENERAL}")
    besides = [
        on_grid(tracks, options.period, options.read.max_gap)
        for place in options.train_also
        for tracks in recordings_in(place, options.read)
    ]
    if options.train_on:
        return [*source.files(options.train_on), *besides], source.files(options.validate_on)
    names = source.scenes if options.dataset is None else (options.dataset,)
    learned, validated = (
        [tracks for name in names for tracks in source.recordings(name, split)]
        for split in ("train", "val")
    )
    return [*learned, *besides], validated


def _refuse_seen(parts: dict[str, Windows], training: Windows) -> None:
    """Refuse to train on what the model is tested or validated on, by what is in it."""
    for use, windows in reversed(parts.items()):
        found, all_ = shared_shapes(windows, training)
        if found > 0.01 * all_:
            names = ", ".join(dict.fromkeys(how.recording for how in windows.reading))
            raise InputError(
                f"the training data has {found} of the {all_} shapes of windows in {names}, and "
                f"that is what the model is {use} on"
            )
