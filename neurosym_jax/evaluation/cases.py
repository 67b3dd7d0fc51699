"""What an evaluation consists of: which model is tested on which scene at which horizon."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.data.sources import Source
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import find_checkpoints, shipped_models
from neurosym_jax.models.pooling import NOT_OF_PAIRS, POOLINGS

__all__ = ["Case", "TestSet", "make_cases"]


@dataclasses.dataclass(frozen=True)
class TestSet:
    """A scene at a horizon."""

    scene: str
    obs_len: int
    pred_len: int


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """A test set and the checkpoints to evaluate on it; the baselines are always evaluated."""

    test_set: TestSet
    recordings: list[Tracks]
    models: list[tuple[str, Model]]
    """(path as given, model), in the order given."""


def make_cases(
    open_for: Callable[[str | None, str | None], Source],
    checkpoints: Sequence[str | Path],
    *,
    scene: str | None = None,
    test_on: tuple[str, ...] = (),
    obs_len: int | None = None,
    pred_len: int | None = None,
) -> list[Case]:
    """Cases in the source's order of scenes, then by horizon.

    A checkpoint is tested on the scene it was trained to be tested on, where the source has it,
    else on all scenes. Without checkpoints, those that ship are taken as far as they fit.

    Args:
        open_for: gives the source, from the scene asked for and the one that the first of the
            given checkpoints was trained to be tested on; either may be None.
        checkpoints: see `load_model`; a folder of several stands for all of them.
        scene: the one to test on.
        test_on: recordings to test on.
        obs_len: observed steps.
        pred_len: steps to forecast.

    Raises:
        InputError: when what is asked for contradicts what a checkpoint is, or is not there.
    """
    if scene is not None and test_on:
        raise InputError("--scene and --test-on name two test sets: give one of them")
    given = [(path, load_model(path)) for path in find_checkpoints(checkpoints)]
    source = open_for(scene, given[0][1].dataset if given else None)
    if scene is not None and scene not in source.scenes:
        raise InputError(f"unknown scene {scene!r}: there are {', '.join(source.scenes)}")
    everywhere = ("+".join(test_on),) if test_on else source.scenes if scene is None else (scene,)
    tested: dict[TestSet, list[tuple[str, Model]]] = {}
    for path, model in given or [(str(p), load_model(p)) for p in shipped_models()]:
        reason = _contradiction(model, source, scene, obs_len, pred_len)
        if reason and checkpoints:
            raise InputError(f"{path}: {reason}")
        if reason:
            continue
        own = model.dataset in source.scenes and not test_on
        for name in (model.dataset,) if own else everywhere:
            test_set = TestSet(str(name), model.config.obs_len, model.config.pred_len)
            tested.setdefault(test_set, []).append((path, model))
    if not tested:
        default = GeneratorConfig()
        lengths = (obs_len or default.obs_len, pred_len or default.pred_len)
        tested = {TestSet(name, *lengths): [] for name in everywhere}
    recordings = {
        name: source.files(test_on) if test_on else source.recordings(name)
        for name in dict.fromkeys(test_set.scene for test_set in tested)
    }
    order = [*everywhere, *source.scenes]
    return [
        Case(test_set, recordings[test_set.scene], tested[test_set])
        for test_set in sorted(
            tested, key=lambda test: (order.index(test.scene), test.obs_len, test.pred_len)
        )
    ]


def _contradiction(
    model: Model, source: Source, scene: str | None, obs_len: int | None, pred_len: int | None
) -> str | None:
    config = model.config
    if isinstance(config, GeneratorConfig) and not POOLINGS[config.pooling].of_pairs:
        return f"{config.pooling} {NOT_OF_PAIRS}"
    for name, asked in (("obs_len", obs_len), ("pred_len", pred_len)):
        has = getattr(model.config, name)
        if asked is not None and asked != has:
            return f"has {name} {has}, but --{name.replace('_', '-')} {asked} is asked for"
    if scene is not None and model.dataset in source.scenes and scene != model.dataset:
        return (
            f"leaves {model.dataset} out of its training, so --scene {scene} would test it on what "
            "it was trained on (--test-on with file names does so all the same)"
        )
    return None
