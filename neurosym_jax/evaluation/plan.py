"""What an evaluation consists of: which models are tested on which dataset at which horizon.

Nothing is read here but the names of the datasets that there are.
"""

import dataclasses
from collections.abc import Sequence

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.data.sources import ELSEWHERE, EthUcy, Source, Synthetic
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.model import Model
from neurosym_jax.models.pooling import NOT_OF_PAIRS
from neurosym_jax.models.poolings import POOLINGS

__all__ = ["BASELINES", "Entries", "TestSet", "baseline", "make_plan", "one_of_each"]

BASELINES = ("constant_velocity", "constant_velocity_sampled")
"""What every model is tested beside, by names of `register_forecaster`."""

Entries = list[tuple[str | None, Model]]
"""(path as given, model) of what is tested on one test set; baselines, first, have no path."""


@dataclasses.dataclass(frozen=True)
class TestSet:
    """A dataset at a horizon."""

    dataset: str
    """Its name, or those of recordings joined by `+`."""
    obs_len: int
    pred_len: int


def make_plan(
    source: Source,
    models: Sequence[tuple[str, Model]],
    *,
    dataset: str | None = None,
    test_on: Sequence[str] = (),
    obs_len: int | None = None,
    pred_len: int | None = None,
    baselines: Sequence[str] = BASELINES,
    as_far_as_they_fit: bool = False,
) -> dict[TestSet, Entries]:
    """What is tested on each test set: in the source's order of datasets, then by horizon.

    A model is tested on the dataset it was trained to be tested on, where the source has it, else
    on all of them.

    Args:
        source: of the recordings.
        models: (path, model).
        dataset: the one to test on.
        test_on: recordings to test on, as one test set.
        obs_len: observed steps.
        pred_len: steps to forecast.
        baselines: forecasters without parameters, by name.
        as_far_as_they_fit: leave out the models that contradict what is asked for.

    Raises:
        InputError: when what is asked for contradicts what a model is, or is not there.
    """
    if dataset is not None and test_on:
        raise InputError("--dataset and --test-on name two test sets: give one of them")
    if dataset is not None and dataset not in source.scenes:
        raise InputError(f"unknown dataset {dataset!r}: there are {', '.join(source.scenes)}")
    everywhere = ("+".join(test_on),) if test_on else (dataset,) if dataset else source.scenes
    tested: dict[TestSet, Entries] = {}
    for path, model in models:
        if reason := _contradiction(model, source, dataset, obs_len, pred_len, bool(test_on)):
            if as_far_as_they_fit:
                continue
            raise InputError(f"{path}: {reason}")
        own = model.dataset in source.scenes and not test_on
        for name in (str(model.dataset),) if own else everywhere:
            test_set = TestSet(name, model.config.obs_len, model.config.pred_len)
            tested.setdefault(test_set, []).append((path, model))
    if not tested:
        default = GeneratorConfig()
        lengths = (obs_len or default.obs_len, pred_len or default.pred_len)
        tested = {TestSet(name, *lengths): [] for name in everywhere}
    order = [*everywhere, *source.scenes]
    return {
        test_set: [
            *((None, baseline(name, test_set.obs_len, test_set.pred_len)) for name in baselines),
            *tested[test_set],
        ]
        for test_set in sorted(
            tested, key=lambda test: (order.index(test.dataset), test.obs_len, test.pred_len)
        )
    }


def one_of_each(
    source: Source,
    models: Sequence[tuple[str, Model]],
    *,
    dataset: str | None = None,
    obs_len: int | None = None,
    pred_len: int | None = None,
) -> list[tuple[str, Model]]:
    """Of `models`, for each dataset the first one without symbols and the first one with them.

    They are those that were trained to be tested there; where none was, as on a user's own
    recordings, those that were trained to be tested elsewhere, else those trained on other people,
    whoever they are.

    Args:
        source: of the recordings.
        models: (path, model).
        dataset: the one to test on.
        obs_len: observed steps.
        pred_len: steps to forecast; by default, as for the other, a model's default.
    """
    lengths = (obs_len or GeneratorConfig().obs_len, pred_len or GeneratorConfig().pred_len)
    fitting = [
        (path, model)
        for path, model in models
        if (model.config.obs_len, model.config.pred_len) == lengths
        and not _contradiction(model, source, dataset, obs_len, pred_len)
    ]
    # What is for other people than it learned from; the papers' networks before variants of them.
    fitting.sort(key=lambda each: (each[1].dataset != ELSEWHERE, _departures(each[1])))
    own = [each for each in fitting if each[1].dataset in (*source.scenes, source.name)]
    others = [each for each in fitting if each[1].dataset not in (None, Synthetic.name)]
    chosen: dict[tuple[str | None, bool], tuple[str, Model]] = {}
    for path, model in own or others:
        # Of other people's models one is as good as another, so it is not told whose they are.
        of = model.dataset if own else None
        chosen.setdefault((of, model.weighting is None), (path, model))
    return sorted(chosen.values(), key=lambda each: each[1].weighting is not None)


def _departures(model: Model) -> tuple[bool, bool]:
    """In what a model departs from the papers: another pooling, another forecast."""
    pooling = getattr(model.config, "pooling", None)
    return pooling != "as_described", getattr(model.config, "beside_velocity", False)


def baseline(name: str, obs_len: int, pred_len: int) -> Model:
    """A registered forecaster that has no parameters, at a horizon.

    Raises:
        InputError: for a name that nobody registered, or a forecaster that has parameters.
    """
    kind = FORECASTERS[name]
    try:
        config = kind.config(obs_len=obs_len, pred_len=pred_len)
    except TypeError as error:
        raise InputError(f"forecaster {name}: cannot be a baseline ({error})") from None
    if kind.shapes is not None and kind.shapes(config):
        raise InputError(f"forecaster {name}: cannot be a baseline, it has parameters to learn")
    return Model(config, {}, kind=name)


def _contradiction(
    model: Model,
    source: Source,
    dataset: str | None,
    obs_len: int | None,
    pred_len: int | None,
    named: bool = False,
) -> str | None:
    config = model.config
    if isinstance(config, GeneratorConfig) and not POOLINGS[config.pooling].of_pairs:
        return f"{config.pooling} {NOT_OF_PAIRS}"
    for name, asked in (("obs_len", obs_len), ("pred_len", pred_len)):
        has = getattr(config, name)
        if asked is not None and asked != has:
            return f"has {name} {has}, but --{name.replace('_', '-')} {asked} is asked for"
    if model.dataset == ELSEWHERE and isinstance(source, EthUcy) and not named:
        return (
            "learned from all of ETH/UCY, so it would be tested on what it was trained on "
            "(--test-on with file names does so all the same)"
        )
    if dataset is not None and model.dataset in source.scenes and dataset != model.dataset:
        return (
            f"leaves {model.dataset} out of its training, so --dataset {dataset} would test it on "
            "what it was trained on (--test-on with file names does so all the same)"
        )
    return None
