"""`docs/symbolic_forecast.md` and its table, from the models that ship.

python -m studies.symbolic_forecast DATA OUT

DATA holds ETH/UCY in `eth_ucy`, THÖR's tracks in `thor`, see docs/data.md, and HERMES's
runs in `hermes`, see studies/weighting/data.py. OUT gets `scores.json`,
`symbolic_forecast.md` and `.csv`; with `scores.json` in place of DATA the last two are
made of it.
"""

import dataclasses
import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.data.recordings import Source, Split, open_source
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputWarning
from neurosym_jax.evaluation.intervals import (
    Difference,
    ErrorsByScene,
    mean_difference,
    paired_difference,
)
from neurosym_jax.evaluation.plan import baseline
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.runtime.files import write_json, write_text
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import SymbolSettings
from studies.symbolic_forecast.cases import make_cases
from studies.symbolic_forecast.page import document, table
from studies.symbolic_forecast.scores import evaluate_symbols
from studies.weighting.data import LEARNED, TESTED, read_corridor

LENGTH, SAMPLES, SEED = 8, 20, 0
MOST: dict[Split, int] = {"train": 20_000, "val": 8_000, "test": 30_000}
"""Pairs of each split, about."""
AGAINST = ("Markov chain", "constant velocity", "SGAN", "anchors")
"""What NeuroSyM is compared with."""
CHOOSING = ("boa-300-055-095", "bot-360-090-090")
"""Recordings of HERMES, split as in the study of weightings, on which smoothing is chosen."""
THOR = (
    "CLiFF-LHMP_thor1_exp-1-run-2",
    "CLiFF-LHMP_thor3_exp-3-run-2",
    "THOR-MAGNI_Scenario_5",
)


class TestSet(NamedTuple):
    """A scene of a source, and whose models forecast it."""

    source: Source
    scene: str
    models: str
    """The part of the models' names behind the kind: what they were not trained on."""


def sets_of(data: Path) -> dict[str, list[TestSet]]:
    """The groups of test sets in `data`, see the module above.

    Raises:
        InputError: for data that is missing.
    """
    eth_ucy, thor = open_source(data / "eth_ucy"), open_source(data / "thor")
    corridors = _Corridors(TESTED, folder=data / "hermes")
    return {
        "ETH/UCY": [TestSet(eth_ucy, scene, scene) for scene in ("eth", "zara1")],
        # No model that ships has seen a corridor or THÖR.
        "THÖR": [TestSet(thor, scene, "zara1") for scene in THOR],
        "HERMES": [TestSet(corridors, scene, "zara1") for scene in TESTED],
    }


@dataclasses.dataclass(frozen=True)
class _Corridors(Source):
    folder: Path = Path()

    def _read(self, scene: str, split: Split) -> list[Tracks]:
        runs = {"train": LEARNED, "val": CHOOSING, "test": (scene,)}[split]
        return [read_corridor(self.folder / f"{run}.txt") for run in runs]


def main(data: Path, out: Path) -> None:
    """Score everything on every test set, and write what came out."""
    start = time.perf_counter()
    if data.suffix == ".json":
        scores = json.loads(data.read_text(encoding="utf-8"))
    else:
        scores: dict[str, Any] = {
            name: _group(members) for name, members in sets_of(data).items()
        }
        scores["seconds"] = time.perf_counter() - start
        write_json(out / "scores.json", scores)
    write_text(out / "symbolic_forecast.md", document(scores))
    write_text(out / "symbolic_forecast.csv", table(scores))


def _group(members: list[TestSet]) -> dict[str, Any]:
    """The mean over test sets, each of which weighs the same."""
    scores, sizes = [], {}
    for test_set in members:
        errors, sizes[test_set.scene] = _of_set(test_set)
        scores.append(errors)
        print(test_set.scene, *sizes[test_set.scene].values(), flush=True)
    metrics = tuple(scores[0]["NeuroSyM"].scores)
    return {
        "sets": sizes,
        "means": {name: _means(scores, name) for name in scores[0]},
        "differences": {
            other: _intervals(
                mean_difference(
                    [paired_difference([s["NeuroSyM"]], [s[other]]) for s in scores]
                ),
                metrics,
            )
            for other in AGAINST
        },
    }


def _means(scores: list[dict[str, ErrorsByScene]], name: str) -> dict[str, float]:
    values = np.mean([errors[name].mean for errors in scores], axis=0)
    return dict(zip(scores[0][name].scores, values.round(5).tolist()))


def _intervals(
    difference: Difference, metrics: tuple[str, ...]
) -> dict[str, list[float]]:
    intervals = {}
    for metric in metrics:
        interval = difference.intervals(metric)["scenes"]
        assert interval is not None
        mean = float(difference.mean[difference.metrics.index(metric)])
        intervals[metric] = [round(value, 5) for value in (mean, *interval)]
    return intervals


def _of_set(test_set: TestSet) -> tuple[dict[str, ErrorsByScene], dict[str, Any]]:
    settings, events = SymbolSettings(), tuple(EVENTS)
    train, tune, test = (
        make_cases(
            test_set.source.recordings(test_set.scene, split),
            LENGTH,
            LENGTH,
            settings,
            events,
            most=most,
        )
        for split, most in MOST.items()
    )
    folder = Path(__file__).resolve().parents[2] / "checkpoints"
    models = {
        "NeuroSyM": load_model(folder / f"neurosym_{test_set.models}_8"),
        "SGAN": load_model(folder / f"sgan_{test_set.models}_8"),
        "anchors": load_model(folder / f"anchors_{test_set.models}_8"),
        "constant velocity": baseline("constant_velocity", LENGTH, LENGTH),
        "constant velocity, sampled": baseline(
            "constant_velocity_sampled", LENGTH, LENGTH
        ),
    }
    scores = evaluate_symbols(train, tune, test, models, samples=SAMPLES, seed=SEED)
    share = dict(zip(events, test.after.mean(axis=1).round(4).tolist()))
    return scores, {
        "windows": test.windows.scenes,
        "pairs": len(test.rows),
        "events": share,
    }


if __name__ == "__main__":
    warnings.simplefilter("ignore", InputWarning)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
