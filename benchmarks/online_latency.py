"""Milliseconds from a frame's arrival to its forecast, by model and number of people.

A stream of 10 frames a second of people walking at random through a square, as fast as it can be
pushed; each model alone, 20 samples, the models that ship for zara1 at 8 + 8. What is measured is
`Forecast.latency`: window, forecast, mean and most central sample.

    python benchmarks/online_latency.py [--people 2 50] [--forecasts 500] [--json FILE]
"""

import argparse
import json
import os
from pathlib import Path

import numpy as np

MODELS = ("sgan_zara1_8_8", "neurosym_zara1_8_8")
PERCENTILES = (50, 90, 99)
WARM = 20
"""Forecasts that are not counted: the first ones fill caches."""


def main() -> None:
    """Measure, print a table, write JSON where asked to."""
    parser = argparse.ArgumentParser(description="Time online forecasts.")
    parser.add_argument("--people", type=int, nargs="+", default=[2, 50], help="at once")
    parser.add_argument("--samples", type=int, default=20, help="futures of each model")
    parser.add_argument("--forecasts", type=int, default=500, help="measured, of each")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="of XLA")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    options = parser.parse_args()
    os.environ["NPROC"] = str(options.threads)  # Before jax is imported.

    from neurosym_jax.environment import run_environment
    from neurosym_jax.evaluation.cases import SHIPPED
    from neurosym_jax.runtime import enable_compilation_cache

    enable_compilation_cache()
    rows = []
    print(f"{options.samples} samples, {options.threads} threads, {options.forecasts} forecasts:")
    print(f"  {'model':20} {'people':>6}" + "".join(f"  p{p:<2} [ms]" for p in PERCENTILES))
    for people in options.people:
        for name in MODELS:
            latency = measure(SHIPPED / name, people, options.samples, options.forecasts)
            values = np.percentile(1e3 * latency, PERCENTILES).tolist()
            print(f"  {name:20} {people:6}" + "".join(f"{value:10.2f}" for value in values))
            milliseconds = {f"p{p}": value for p, value in zip(PERCENTILES, values)}
            rows.append({"model": name, "people": people, "latency_ms": milliseconds})
    if options.json:
        result = {
            "format": 1,
            "environment": run_environment(),
            "samples": options.samples,
            "forecasts": options.forecasts,
            "rows": rows,
        }
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def measure(path: Path, people: int, samples: int, forecasts: int) -> np.ndarray:
    """[forecasts] seconds."""
    from neurosym_jax import load_model
    from neurosym_jax.online.predictor import Predictor

    predictor = Predictor(load_model(path), samples=samples, max_people=people)
    rng = np.random.default_rng(0)
    position = rng.uniform(0, 2 * people**0.5, (people, 2))
    velocity = rng.normal(0, 1.0, (people, 2))
    ids, latency, frame = np.arange(people), [], 0
    while len(latency) < forecasts + WARM:
        velocity += rng.normal(0, 0.05, velocity.shape)
        position = position + 0.1 * velocity
        forecast = predictor.push(frame / 10, ids, position)
        frame += 1
        if forecast is not None:
            latency.append(forecast.latency)
    return np.array(latency[WARM:])


if __name__ == "__main__":
    main()
