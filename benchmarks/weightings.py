"""Seconds that each weighting takes beside a whole forecast of the same scenes.

    NPROC=1 python benchmarks/weightings.py --data DATA --scene zara1 [--json FILE]

A forecast is NeuroSyM's of 8 + 8 steps with 20 samples, untrained, weighted by `ones`; alpha is
computed on its own, compiled, for the same batches. Rounds alternate between the contestants, so
that what else the machine does falls on all of them.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.sources import open_source
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.forecasting.batched import forecast_batch
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.forecasting.noise import draw_noise
from neurosym_jax.models import AsDescribed, Generator, GeneratorConfig
from neurosym_jax.runtime.process import enable_compilation_cache, tune
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.weighting import Weighting
from neurosym_jax.symbolic.weightings import WEIGHTINGS, Ones, Soft, make_weighting

SAMPLES = 20


def main() -> None:
    """Measure, print a table, write JSON where asked to."""
    parser = argparse.ArgumentParser(description="Time every weighting beside a forecast.")
    parser.add_argument("--data", type=Path, help="ETH/UCY; default: the embedded simulations")
    parser.add_argument("--scene", help="default: the data's first")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path, help="file for the numbers")
    options = parser.parse_args()
    tune()
    enable_compilation_cache()
    source = open_source(options.data)
    scene = options.scene or source.scenes[0]
    windows = cut_windows(source.recordings(scene), 8, 8)
    scenes = [b.scene.bare() for b in make_batches(windows)]

    contestants = {"forecast": forecast(scenes)}
    configs = [*(each() for each in WEIGHTINGS.values()), Soft(learned=True)]
    for config in configs:
        contestants[config.name] = alpha(config, scenes)
    seconds = {name: [] for name in contestants}
    for _ in range(options.rounds + 1):
        for name, run in contestants.items():
            start = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - start)

    medians = {name: statistics.median(times[1:]) for name, times in seconds.items()}
    whole = medians["forecast"]
    print(f"{scene}: {windows.scenes} scenes, {len(windows.position)} agents, {SAMPLES} samples")
    for name, median in medians.items():
        print(f"  {name:20} {1000 * median:9.2f} ms {100 * median / whole:8.2f} %")
    if options.json:
        result = {"format": 1, "scene": scene, "scenes": windows.scenes, "seconds": medians}
        options.json.write_text(json.dumps(result, indent=1) + "\n")


def forecast(scenes: list) -> Callable[[], object]:
    """A call that forecasts all `scenes`."""
    config = GeneratorConfig(pooling=AsDescribed(), weighting=Ones())
    one, noise = make_scene(np.zeros((2, 8, 2))), np.zeros(config.noise_dim)
    params = Generator(config).init(jax.random.key(0), one, noise, np.zeros((2, 2, 8)))
    forecaster = GeneratorForecaster(config)
    noises = [draw_noise(forecaster.noise, 0, s.identity, SAMPLES, 1) for s in scenes]
    return lambda: [forecast_batch(forecaster, params, *each) for each in zip(scenes, noises)]


def alpha(config: Weighting, scenes: list) -> Callable[[], object]:
    """A call that computes alpha of all `scenes`."""
    weigh = jax.jit(jax.vmap(make_weighting(config)))
    return lambda: [weigh(s.observed, s.valid).block_until_ready() for s in scenes]


if __name__ == "__main__":
    main()
