"""A plan of tests: which models are tested on which dataset at which horizon, by what protocol."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

from neurosym_jax.data.sources import GENERAL, EthUcy, Source, Synthetic
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.test_sets import (
    BASELINES,
    Entries,
    Test,
    TestSet,
    baselines_of,
    make_test,
)
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import RECOMMENDED, find_checkpoints, shipped_models
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.pooling import NO_FORECAST
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.runtime.environment import cpu_cores

__all__ = [
    "PROTOCOLS",
    "Protocol",
    "ProtocolName",
    "load_models",
    "load_tests",
    "make_plan",
    "one_of_each",
]

ProtocolName = Literal["sgan", "joint-metrics"]


@dataclasses.dataclass(frozen=True)
class Protocol:
    """What a published protocol of evaluation fixes."""

    min_agents: int
    """Scenes with fewer people are left out."""
    by_scene: bool
    """Whether means weigh each scene the same, instead of each person."""
    obs_len: int | None = None
    """Observed steps; None for any."""
    pred_len: int | None = None

    def steps(self, name: str, asked: int | None) -> int | None:
        """`obs_len` or `pred_len`: the number asked for, else the protocol's.

        Raises:
            InputError: where the protocol has another number.
        """
        own = getattr(self, name)
        if None not in (own, asked) and own != asked:
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option} {asked}: the protocol has {own} (--protocol sgan has any)")
        return asked if own is None else own


PROTOCOLS: dict[ProtocolName, Protocol] = {
    "sgan": Protocol(2, by_scene=False),
    "joint-metrics": Protocol(1, by_scene=True, obs_len=8, pred_len=12),
}
"""SGAN's (Gupta et al., CVPR 2018); and that of E. Weng, H. Hoshino, D. Ramanan and K. Kitani,
"Joint Metrics Matter", ICCV 2023."""


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

    A model is tested on its held-out dataset where the source has it, else on all datasets.

    Args:
        source: of the recordings.
        models: (path, model).
        dataset: test on this one only.
        test_on: names of recordings to test on, as one test set.
        obs_len: refuse models that observe another number of steps.
        pred_len: refuse models that forecast another number of steps.
        baselines: forecasters by name, see `baselines_of`.
        samples: k that is asked for.
        only_matching: leave out models that would be refused.

    Raises:
        InputError: for a model that does not match, or an unknown dataset or baseline.
    """
    if dataset is not None and test_on:
        raise InputError("--dataset and --test-on name two test sets: give one of them")
    if dataset is not None and dataset not in source.scenes:
        raise InputError(f"unknown dataset {dataset!r}: there are {', '.join(source.scenes)}")
    everywhere = ("+".join(test_on),) if test_on else (dataset,) if dataset else source.scenes
    tested: dict[TestSet, Entries] = {}
    for path, model in models:
        if reason := _contradiction(model, source, dataset, obs_len, pred_len, bool(test_on)):
            if only_matching:
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
    if baselines is None and test_on and isinstance(source, EthUcy):
        baselines = BASELINES[:2]  # The anchor table for other recordings learned from these.
    order = [*everywhere, *source.scenes]
    return {
        test_set: [
            *baselines_of(
                baselines, test_set.obs_len, test_set.pred_len, test_set.dataset, samples
            ),
            *tested[test_set],
        ]
        for test_set in sorted(
            tested, key=lambda test: (order.index(test.dataset), test.obs_len, test.pred_len)
        )
    }


def load_models(
    names: Sequence[str],
    source_of: Callable[[str | None], Source],
    dataset: str | None,
    pred_len: int | None,
) -> list[tuple[str, Model]]:
    """(path, model) of the checkpoints of these names, or of all models that ship.

    Of what ships the baselines are left out: they are tested beside every model.

    Args:
        names: see `find_checkpoints`; `recommended` without a `dataset` is the model of each data
            set of ETH/UCY where the recordings are these.
        source_of: the source of the recordings; None where no model says which.
        dataset: to test on, where given.
        pred_len: steps to forecast, where given.
    """
    datasets: Sequence[str | None] = (dataset,)
    if RECOMMENDED in names and dataset is None:
        source = source_of(None)
        datasets = source.scenes if isinstance(source, EthUcy) else datasets
    shipped = [str(path) for path in shipped_models() if not path.name.startswith(BASELINES)]
    paths = find_checkpoints(names, datasets, pred_len) or shipped
    return [(path, load_model(path)) for path in paths]


def one_of_each(
    source: Source,
    models: Sequence[tuple[str, Model]],
    *,
    dataset: str | None = None,
    obs_len: int | None = None,
    pred_len: int | None = None,
) -> list[tuple[str, Model]]:
    """Choose for each dataset the first model without symbols and the first one with symbols.

    Models held out for these datasets come first; where there are none, as for a user's own
    recordings, those trained for other people, then any trained on real people.
    """
    lengths = (obs_len or GeneratorConfig().obs_len, pred_len or GeneratorConfig().pred_len)
    fitting = [
        (path, model)
        for path, model in models
        if (model.config.obs_len, model.config.pred_len) == lengths
        and not _contradiction(model, source, dataset, obs_len, pred_len)
    ]
    # General models first, and of them what is recommended.
    fitting.sort(key=lambda each: (each[1].dataset != GENERAL, each[1].kind != "anchors"))
    own = [each for each in fitting if each[1].dataset in (*source.scenes, source.name)]
    others = [each for each in fitting if each[1].dataset not in (None, Synthetic.name)]
    chosen: dict[tuple[str | None, bool], tuple[str, Model]] = {}
    for path, model in own or others:
        # Held-out sets of other people's models make no difference here.
        of = model.dataset if own else None
        chosen.setdefault((of, model.weighting is None), (path, model))
    return sorted(chosen.values(), key=lambda each: each[1].weighting is not None)


def _contradiction(
    model: Model,
    source: Source,
    dataset: str | None,
    obs_len: int | None,
    pred_len: int | None,
    named: bool = False,
) -> str | None:
    """Why a model cannot be tested as asked; None where it can. `named`: recordings are."""
    config = model.config
    if isinstance(config, GeneratorConfig) and "alpha_rows" in config.pooling.inputs:
        return f"{POOLINGS.name_of(config.pooling)} {NO_FORECAST}"
    for name, asked in (("obs_len", obs_len), ("pred_len", pred_len)):
        has = getattr(config, name)
        if asked is not None and asked != has:
            return f"has {name} {has}, but --{name.replace('_', '-')} {asked} is asked for"
    if model.dataset == GENERAL and isinstance(source, EthUcy) and not named:
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


def load_tests(
    source: Source,
    plan: Mapping[TestSet, Entries],
    *,
    test_on: Sequence[str] = (),
    min_agents: int = 2,
    start: float | None = None,
) -> list[Test]:
    """Read the test sets of a plan (see `make_plan`), each recording once.

    The first test set's seconds count from `start`, a `time.perf_counter()`.
    """
    since = time.perf_counter() if start is None else start

    def read(name: str) -> list[Tracks]:
        return source.files(test_on) if test_on else source.recordings(name)

    names = list(dict.fromkeys(test_set.dataset for test_set in plan))
    # Side by side, for simulations are programs that are compiled first.
    with ThreadPoolExecutor(cpu_cores()) as pool:
        recordings = dict(zip(names, pool.map(read, names)))
    tests: list[Test] = []
    for test_set, entries in plan.items():
        tests.append(make_test(test_set, entries, recordings[test_set.dataset], min_agents, since))
        since = time.perf_counter()
    return tests
