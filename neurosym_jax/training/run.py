"""The training that `python train.py` runs: its options, and what they mean."""

import dataclasses
import importlib
import json
from pathlib import Path
from typing import Annotated, Literal

import tyro

from neurosym_jax.config import (
    RECIPES,
    GeneratorConfig,
    TrainConfig,
    from_json,
    to_json,
)
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.sources import Source, Synthetic, open_source
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.models.pooling import POOLINGS, pooling_names
from neurosym_jax.symbolic.weighting_config import WeightingConfig
from neurosym_jax.training.loop import Run, train_run

__all__ = [
    "TrainOptions",
    "generator_config",
    "make_run",
    "model_name",
    "named_weighting",
    "recipe",
    "train",
]


@dataclasses.dataclass(frozen=True)
class TrainOptions:
    """Train a model: `python train.py` alone does so on the embedded simulations."""

    model: Literal["sgan", "neurosym"] = "sgan"
    """SGAN with pooling, or NeuroSyM."""
    variant: str = "as_described"
    """Of NeuroSyM: as_described, neurosym_ros, or what a plugin registers."""
    weighting: str = "cnd"
    """Of NeuroSyM: KIND[,FIELD=VALUE...], see docs/weightings.md; MODULE:KIND for one's own."""
    pooling: str = "pool_net"
    """Of SGAN: none, pool_net, social, or what a plugin registers."""
    scene: str | None = None
    """Scene of ETH/UCY left out of training (eth, hotel, ...); of the simulations, the one trained
    on (default: all of them)."""
    obs_len: int = 8
    """Observed steps."""
    pred_len: int = 8
    """Steps to forecast."""
    period: float = 0.4
    """Seconds between steps; recordings that have others are resampled."""
    recipe: Literal["ours", "sgan"] = "ours"
    """How it is trained, see docs/training.md."""
    seed: int = 0
    """Of initialisation, order of scenes, augmentation and noise."""
    steps: int | None = None
    """Generator steps; default: the recipe's."""
    set: tuple[str, ...] = ()
    """Changes to the recipe, NAME=VALUE, such as ema=0.999 or rotate=0."""
    data: Path | None = None
    """ETH/UCY as SGAN arranges it, or a folder of recordings; default: what was downloaded and has
    the scene, else the embedded simulations."""
    train_on: tuple[str, ...] = ()
    """Recordings by file name to train on, instead of a leave-one-out split."""
    validate_on: tuple[str, ...] = ()
    """Recordings by file name to validate on; needed with --train-on."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""
    out: Path | None = None
    """Folder of the run; default: runs/ and a name made of the options."""
    resume: bool = False
    """Continue the run in the folder."""


def train(options: TrainOptions) -> None:
    """Train as `options` say."""
    run = make_run(options)
    where = run.scene or ("files" if options.train_on else "simulations")
    name = f"{model_name(options)}_{where}_{options.obs_len}_{options.pred_len}"
    folder = options.out or Path("runs") / f"{name}_{options.recipe}_{options.seed}"
    print(
        f"{name}: {run.training.scenes} scenes, {run.training.agents} agents to train on, "
        f"{run.validation.scenes} scenes to validate on, {run.config.steps} steps"
    )
    train_run(run, folder, resume=options.resume)
    print(f"model: {folder / 'model'}")


def make_run(options: TrainOptions) -> Run:
    """The run that `options` describe, its data read.

    Raises:
        InputError: for options that contradict each other or data that cannot be read.
    """
    source = open_source(options.data, options.scene, read=options.read, period=options.period)
    if bool(options.train_on) != bool(options.validate_on):
        raise InputError("--train-on and --validate-on go together")
    if options.train_on:
        scene = None
        recordings = [source.files(names) for names in (options.train_on, options.validate_on)]
    elif options.scene is None and options.data is not None:
        raise InputError(f"--scene is needed: one of {', '.join(source.scenes)}")
    else:
        scene = options.scene
        recordings = [
            [
                tracks
                for name in (source.scenes if scene is None else (scene,))
                for tracks in source.recordings(name, split)
            ]
            for split in ("train", "val")
        ]
    training, validation = (
        cut_windows(tracks, options.obs_len, options.pred_len) for tracks in recordings
    )
    return Run(
        generator=dataclasses.replace(generator_config(options), period=training.period),
        config=recipe(options),
        training=training,
        validation=validation,
        scene=scene,
        data_name=_data_name(options, source),
    )


def generator_config(options: TrainOptions) -> GeneratorConfig:
    """The generator that `options` name, with the published sizes.

    Raises:
        InputError: for an unknown pooling or weighting.
    """
    symbolic = options.model == "neurosym"
    pooling = options.variant if symbolic else options.pooling
    known = pooling_names(symbolic=symbolic)
    if pooling not in known:
        option = "variant" if symbolic else "pooling"
        raise InputError(f"--{option} {pooling}: {options.model} has {', '.join(known)}")
    config = GeneratorConfig(obs_len=options.obs_len, pred_len=options.pred_len)
    if POOLINGS[pooling].returns_hidden:
        config = dataclasses.replace(config, bottleneck_dim=config.encoder_h_dim)
    weighting = named_weighting(options.weighting) if symbolic else None
    return dataclasses.replace(config, pooling=pooling, weighting=weighting)


def named_weighting(text: str) -> WeightingConfig:
    """The weighting of a command line; `MODULE:KIND` imports the module that registers the kind.

    Raises:
        InputError: for a module that cannot be imported, or whatever else is not a weighting.
    """
    module, _, name = text.rpartition(":")
    try:
        if module:
            importlib.import_module(module)
    except ImportError as error:
        raise InputError(f"weighting {text}: cannot import {module} ({error})") from None
    return WeightingConfig.from_text(name, f"weighting {text}")


def recipe(options: TrainOptions) -> TrainConfig:
    """The recipe that `options` name, with their changes to it.

    Raises:
        InputError: for a change that is not NAME=VALUE of a field, or a value out of its range.
    """
    fields = to_json(RECIPES[options.recipe]) | {"seed": options.seed}
    if options.steps is not None:
        fields["steps"] = options.steps
    for change in options.set:
        name, equals, value = change.partition("=")
        if not equals or name not in fields or name == "format":
            known = ", ".join(name for name in fields if name != "format")
            raise InputError(f"--set {change}: must be NAME=VALUE, where NAME is one of {known}")
        try:
            fields[name] = json.loads(value)
        except json.JSONDecodeError:
            fields[name] = value
    return from_json(TrainConfig, fields, f"recipe {options.recipe}")


def _data_name(options: TrainOptions, source: Source) -> str:
    if options.train_on:
        return f"trained on {', '.join(Path(name).stem for name in options.train_on)}"
    if isinstance(source, Synthetic):
        return f"trained on simulations ({options.scene or 'all'})"
    return f"trained without {options.scene}"


def model_name(options: TrainOptions) -> str:
    """What tells models apart that are trained on the same data."""
    if options.model == "neurosym":
        weighting = named_weighting(options.weighting).name
        return f"neurosym_{options.variant.removeprefix('neurosym_')}_{weighting}"
    return f"sgan_{options.pooling}"
