"""`docs/symbolic_forecast.md` and its figure, from the models that ship.

python -m studies.symbolic_forecast DATA OUT

DATA holds ETH/UCY in `eth_ucy` and a folder `thor` of THÖR's tracks, see docs/data.md. OUT gets
`scores.json`, `symbolic_forecast.md` and `symbolic_forecast.png`; with `scores.json` in place of
DATA the last two are made of it.
"""

import json
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.sources import Source, Split, open_source
from neurosym_jax.errors import InputWarning
from neurosym_jax.evaluation.paired import Difference, mean_difference, paired_difference
from neurosym_jax.evaluation.plan import baseline
from neurosym_jax.evaluation.symbol_cases import make_cases
from neurosym_jax.evaluation.symbols import SymbolScores, evaluate_symbols
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.plotting.style import save_figure
from neurosym_jax.runtime.files import write_json, write_text
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.futures import SymbolSettings
from studies.symbolic_forecast.page import document, figure

LENGTH, SAMPLES, SEED = 8, 20, 0
MOST: dict[Split, int] = {"train": 20_000, "val": 8_000, "test": 12_000}
"""Pairs of each split, about."""
THOR = {
    "CLiFF-LHMP_thor1_exp-1-run-2": "thor-1",
    "CLiFF-LHMP_thor3_exp-3-run-2": "thor-3",
    "THOR-MAGNI_Scenario_5": "thor-magni",
}
"""Recordings, and the part of a model's name that says it was not trained on it."""
AGAINST = ("Markov chain", "constant velocity", "SGAN")
"""What NeuroSyM is compared with."""


def main(data: Path, out: Path) -> None:
    """Score everything on every test set, and write what came out."""
    start = time.perf_counter()
    if data.suffix == ".json":
        found = json.loads(data.read_text(encoding="utf-8"))
    else:
        thor = open_source(data / "thor")
        sets = {"ETH/UCY": {name: (open_source(data / "eth_ucy"), name) for name in _eth_ucy()}}
        sets["THÖR"] = {name: (thor, name) for name in THOR}
        found: dict[str, Any] = {group: _group(members) for group, members in sets.items()}
        found["seconds"] = time.perf_counter() - start
        write_json(out / "scores.json", found)
    write_text(out / "symbolic_forecast.md", document(found))
    print(save_figure(figure(found), out / "symbolic_forecast.png"))


def _eth_ucy() -> tuple[str, ...]:
    return ("eth", "hotel", "univ", "zara1", "zara2")


def _group(members: dict[str, tuple[Source, str]]) -> dict[str, Any]:
    """The mean over test sets, each of which weighs the same."""
    scores, sizes = [], {}
    for name, (source, scene) in members.items():
        found, sizes[name] = _of_set(source, scene)
        scores.append(found)
        print(name, *sizes[name].values(), flush=True)
    metrics = scores[0]["NeuroSyM"].errors.metrics
    return {
        "sets": sizes,
        "means": {name: _means(scores, name) for name in scores[0]},
        "differences": {
            other: _intervals(
                mean_difference(
                    [paired_difference([s["NeuroSyM"].errors], [s[other].errors]) for s in scores]
                ),
                metrics,
            )
            for other in AGAINST
        },
        "reliability": {
            name: {
                target: np.sum([s[name].reliability[target] for s in scores], axis=0).tolist()
                for target in scores[0][name].reliability
            }
            for name in scores[0]
        },
    }


def _means(scores: list[dict[str, SymbolScores]], name: str) -> dict[str, float]:
    metrics = scores[0][name].errors.metrics
    values = np.mean([found[name].errors.mean for found in scores], axis=0)
    return dict(zip(metrics, values.round(5).tolist()))


def _intervals(difference: Difference, metrics: tuple[str, ...]) -> dict[str, list[float]]:
    found = {}
    for metric in metrics:
        interval = difference.intervals(metric)["scenes"]
        assert interval is not None
        mean = float(difference.mean[difference.metrics.index(metric)])
        found[metric] = [round(value, 5) for value in (mean, *interval)]
    return found


def _of_set(source: Source, scene: str) -> tuple[dict[str, SymbolScores], dict[str, Any]]:
    settings, events = SymbolSettings(), tuple(EVENTS)
    train, tune, test = (
        make_cases(source.recordings(scene, split), LENGTH, LENGTH, settings, events, most=most)
        for split, most in MOST.items()
    )
    part = THOR.get(scene, scene)
    folder = Path(__file__).resolve().parents[2] / "checkpoints"
    models = {
        "NeuroSyM": load_model(folder / f"neurosym_{part}_8_8"),
        "SGAN": load_model(folder / f"sgan_{part}_8_8"),
        "constant velocity": baseline("constant_velocity", LENGTH, LENGTH),
        "constant velocity, sampled": baseline("constant_velocity_sampled", LENGTH, LENGTH),
    }
    found = evaluate_symbols(train, tune, test, models, samples=SAMPLES, seed=SEED)
    share = dict(zip(events, test.after.mean(axis=1).round(4).tolist()))
    return found, {"windows": test.windows.scenes, "pairs": len(test.rows), "events": share}


if __name__ == "__main__":
    warnings.simplefilter("ignore", InputWarning)
    main(Path(sys.argv[1]), Path(sys.argv[2]))
