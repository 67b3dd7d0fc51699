"""What is tested on what: models, and baselines beside them, on the windows of a dataset."""

import dataclasses
import functools
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from neurosym_jax.data.recordings import GENERAL, EthUcy, Source
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import (
    Batch,
    Windows,
    cut_windows,
    make_batches,
    seen_before,
)
from neurosym_jax.errors import InputError, InputWarning, option
from neurosym_jax.evaluation.forecasts import Forecasts
from neurosym_jax.forecasting.forecaster import FORECASTERS
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import find_model, shipped_name
from neurosym_jax.runtime.process import cpu_cores

__all__ = [
    "BASELINES",
    "TABLE",
    "Entries",
    "Test",
    "TestSet",
    "baseline",
    "baselines_of",
]
__all__ += ["load_tests", "make_plan", "make_test"]

BASELINES = ("constant_velocity", "constant_velocity_sampled")
"""Forecasters that every model is tested beside, by name."""
TABLE = "anchor_table"
"""The baseline that ships trained: offsets to constant velocity, without a network."""
LENGTH = 8
"""Steps observed, and forecast, where no model says how many."""

Entries = list[tuple[str | None, Model]]
"""(path as given, model) of what is tested on one test set; baselines, first, have no path."""


@dataclasses.dataclass(frozen=True)
class TestSet:
    """A dataset at a horizon."""

    dataset: str
    """Its name, or names of recordings joined by `+`."""
    obs_len: int
    pred_len: int


@dataclasses.dataclass(frozen=True, eq=False)
class Test:
    """A test set, read, and the models to test on it."""

    test_set: TestSet
    entries: Entries
    windows: Windows
    forecasts: Sequence[tuple[str | None, Forecasts]] = ()
    """(file, forecasts) to test beside the models; those of a function have no file."""

    @functools.cached_property
    def batches(self) -> list[Batch]:
        """All scenes, padded."""
        return make_batches(self.windows)


def make_plan(
    source: Source,
    models: Sequence[tuple[str, Model]],
    *,
    dataset: str | None = None,
    test_on: Sequence[str] = (),
    obs_len: int | None = None,
    pred_len: int | None = None,
    baselines: Sequence[str] | None = None,
    samples: int = 20,
    only_matching: bool = False,
) -> dict[TestSet, Entries]:
    """Plan the entries of each test set, by the source's order of datasets, then by horizon.

    A model is tested on its held-out dataset where the source has it, else on all
    datasets.

    Args:
        source: of the recordings.
        models: (path, model).
        dataset: test on this one only.
        test_on: names of recordings to test on, as one test set.
        obs_len: steps that the models have to observe.
        pred_len: steps that they have to forecast.
        baselines: see `baselines_of`.
        samples: number of forecasts of each scene, k.
        only_matching: leave out models that would be refused.

    Raises:
        InputError: for a model that does not match, or an unknown dataset or baseline.
    """
    if dataset is not None and test_on:
        names = f"{option('dataset')} and {option('test_on')}"
        raise InputError(f"{names} name two test sets: give one of them")
    if dataset is not None and dataset not in source.scenes:
        raise InputError(
            f"unknown dataset {dataset!r}: there are {', '.join(source.scenes)}"
        )
    everywhere = (
        ("+".join(test_on),) if test_on else (dataset,) if dataset else source.scenes
    )
    tested: dict[TestSet, Entries] = {}
    for path, model in models:
        if reason := _contradiction(model, source, dataset, test_on, obs_len, pred_len):
            if only_matching:
                continue
            raise InputError(f"{path}: {reason}")
        own = model.dataset in source.scenes and not test_on
        for name in (str(model.dataset),) if own else everywhere:
            test_set = TestSet(name, model.config.obs_len, model.config.pred_len)
            tested.setdefault(test_set, []).append((path, model))
    if not tested:
        tested = {
            TestSet(name, obs_len or LENGTH, pred_len or LENGTH): []
            for name in everywhere
        }
    order = [*everywhere, *source.scenes]
    sets = sorted(
        tested,
        key=lambda test_set: (
            order.index(test_set.dataset),
            test_set.obs_len,
            test_set.pred_len,
        ),
    )
    return {
        test_set: [
            *baselines_of(
                baselines,
                test_set.obs_len,
                test_set.pred_len,
                test_set.dataset,
                samples,
            ),
            *tested[test_set],
        ]
        for test_set in sets
    }


def _contradiction(
    model: Model,
    source: Source,
    dataset: str | None,
    test_on: Sequence[str],
    obs_len: int | None,
    pred_len: int | None,
) -> str | None:
    """Why a model cannot be tested as asked; None where it can."""
    config = model.config
    if reason := model.forecaster.unfit:
        return reason
    for name, requested in (("obs_len", obs_len), ("pred_len", pred_len)):
        if requested not in (None, own := getattr(config, name)):
            return f"has {name} {own}, but {option(name, requested)} is asked for"
    if model.dataset == GENERAL and isinstance(source, EthUcy) and not test_on:
        where = "learned from all of ETH/UCY, so it would be tested"
    elif (
        dataset is not None
        and model.dataset in source.scenes
        and dataset != model.dataset
    ):
        tested = option("dataset", dataset)
        where = f"leaves {model.dataset} out of its training, so {tested} would test it"
    else:
        return None
    hint = f"{option('test_on')} with file names does so all the same"
    return f"{where} on what it was trained on ({hint})"


def baselines_of(
    names: Sequence[str] | None,
    obs_len: int,
    pred_len: int,
    dataset: str | None = None,
    samples: int = 20,
) -> Entries:
    """The baselines of a test set, by names of forecasters.

    None stands for `BASELINES` and, where one of this horizon ships with as many
    `samples`, the anchor table that has not learned from `dataset`.
    """
    if names is None:
        table = _table(obs_len, pred_len, dataset)
        names = (
            [*BASELINES, TABLE]
            if table and samples <= table.config.samples
            else BASELINES
        )
    return [(None, baseline(name, obs_len, pred_len, dataset)) for name in names]


def baseline(
    name: str, obs_len: int, pred_len: int, dataset: str | None = None
) -> Model:
    """Make a registered forecaster without parameters, or load the shipped anchor table.

    Raises:
        InputError: for another forecaster with parameters, or a horizon without a
            table.
    """
    forecaster = FORECASTERS[name]
    config = forecaster.Config(obs_len=obs_len, pred_len=pred_len)
    if not forecaster(config).shapes():
        return Model(config, {}, family=name)
    if name != TABLE:
        raise InputError(
            f"forecaster {name}: cannot be a baseline, it has parameters to learn"
        )
    if (table := _table(obs_len, pred_len, dataset)) is None:
        raise InputError(
            f"forecaster {name}: none of {obs_len} + {pred_len} steps ships"
        )
    return table


def _table(obs_len: int, pred_len: int, dataset: str | None) -> Model | None:
    place = find_model(shipped_name(TABLE, dataset, pred_len))
    return load_model(place) if obs_len == LENGTH and place.is_dir() else None


def load_tests(
    source: Source,
    plan: Mapping[TestSet, Entries],
    *,
    test_on: Sequence[str] = (),
    min_agents: int = 2,
) -> list[Test]:
    """Read the test sets of a plan (see `make_plan`), each recording once."""
    names = list(dict.fromkeys(test_set.dataset for test_set in plan))
    read = (lambda _: source.files(test_on)) if test_on else source.recordings
    # Side by side, for simulations are programs that are compiled first.
    with ThreadPoolExecutor(cpu_cores()) as pool:
        recordings = dict(zip(names, pool.map(read, names)))
    return [
        make_test(test_set, entries, recordings[test_set.dataset], min_agents)
        for test_set, entries in plan.items()
    ]


def make_test(
    test_set: TestSet,
    entries: Entries,
    recordings: Sequence[Tracks],
    min_agents: int = 2,
) -> Test:
    """Cut `recordings` into windows; warn of models that were trained on them, or at other steps.

    The reading of the first recording keeps the warnings of training people, for
    reports.
    """
    windows = cut_windows(
        recordings, test_set.obs_len, test_set.pred_len, min_agents=min_agents
    )
    for path, model in entries:
        name, period = path or model.name, model.config.period
        hits, looked = seen_before(model.seen, windows)
        if hits:
            line = (
                f"{name}: was trained on these people: {hits} of {looked} windows that were "
                "looked for are among its training windows, so its errors are too small"
            )
            warnings.warn(line, InputWarning, stacklevel=2)
            first, *others = windows.reading
            first = dataclasses.replace(first, warnings=(*first.warnings, line))
            windows = dataclasses.replace(windows, reading=(first, *others))
        if (path or model.params) and abs(period - windows.period) > 0.01 * period:
            resample = option("period", round(period, 6))
            line = (
                f"{name}: was trained on steps of {period:g} s and is tested on steps of "
                f"{windows.period:g} s ({resample} resamples the recordings)"
            )
            warnings.warn(line, InputWarning, stacklevel=2)
    return Test(test_set, entries, windows)
