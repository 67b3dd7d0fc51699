"""CPU milliseconds of a training step that pools once, at every predicted step, and with symbols.

NPROC=1 python -m studies.weighting.price DATA

On zara2's training scenes, with the recipe of the arms that pool at every step; rounds alternate.
"""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax

from neurosym_jax.data.windows import Windows
from neurosym_jax.models.sgan.step import init_state, train_steps
from neurosym_jax.runtime import enable_compilation_cache, tune
from neurosym_jax.training.stream import SceneStream
from studies.weighting.arms import POOLINGS, SHORT, WEIGHTINGS, GeneratorConfig
from studies.weighting.control import LENGTHS
from studies.weighting.data import load

CASES = {
    "once": ("ones", False),
    "every step": ("ones", True),
    "every step, with symbols": ("quantised", True),
}
STEPS, ROUNDS = 5, 6


def steps_of(
    training: Windows, pooling: str, weighting: str, every_step: bool
) -> Callable[[], float]:
    """A function that trains some steps and returns CPU milliseconds a step."""
    obs_len, pred_len = LENGTHS
    parts = {"pooling": POOLINGS[pooling](), "weighting": WEIGHTINGS[weighting]()}
    network = GeneratorConfig(obs_len, pred_len, **parts, pool_every_timestep=every_step)
    stream = SceneStream(training, SHORT.batch_scenes, 0, SHORT.max_agents)
    groups = jax.tree.map(lambda leaf: leaf[:, None], stream.steps(0, STEPS))
    state = [init_state(network, SHORT, jax.random.key(0))]

    def run() -> float:
        start = time.process_time()
        done = train_steps(network, SHORT, jax.random.key(1), state[0], groups)
        state[0], _ = jax.block_until_ready(done)
        return 1e3 * (time.process_time() - start) / STEPS

    return run


if __name__ == "__main__":
    enable_compilation_cache()
    tune()
    training, _ = load("zara2", Path(sys.argv[1]))
    for pooling in ("as_described", "encounter"):
        runs = {name: steps_of(training, pooling, *case) for name, case in CASES.items()}
        rounds = [[run() for run in runs.values()] for _ in range(ROUNDS + 1)]
        for name, times in zip(runs, zip(*rounds[1:])):
            print(f"{pooling}, {name}: {statistics.median(times):.1f} ms")
