"""The speed of light: what the arithmetic alone would cost at the rates this machine has.

Rates are measured in the same run, on all cores: a large single-precision matrix product, and tanh
and sigmoid over arrays that stay in the cache. Work is counted without padding, for the folded
networks: two operations for each multiply-add of a product; what is not a product, a tanh or a
sigmoid is not counted.
"""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

LOOPS = 100
"""Rounds of activations in one call."""


class Work(NamedTuple):
    """Arithmetic of a computation."""

    flops: float
    """In matrix products."""
    transcendentals: float
    """tanh and sigmoid."""

    def __add__(self, other: Any) -> "Work":
        return Work(self.flops + other.flops, self.transcendentals + other.transcendentals)

    def __mul__(self, times: float) -> "Work":
        return Work(times * self.flops, times * self.transcendentals)


def machine_rates() -> dict[str, float]:
    """FLOPs a second of products, and tanh or sigmoid a second, all cores together."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from neurosym_jax.runtime.environment import cpu_cores

    wide = np.random.default_rng(0).normal(size=(1024, 1024)).astype(np.float32)
    gates = np.random.default_rng(0).normal(size=(4, 2**14)).astype(np.float32)

    # One gate in four is a tanh. A loop within the program: 16,000 of them take less than a call.
    def activate(_, rows):
        return jnp.tanh(rows[0]), *map(jax.nn.sigmoid, rows[1:])

    activations = jax.jit(lambda rows: jax.lax.fori_loop(0, LOOPS, activate, tuple(rows)))
    product = jax.jit(jnp.matmul)
    # XLA splits a large product over the cores itself; what stays in a cache it does not.
    return {
        "flops": _rate(lambda: product(wide, wide), 2 * 1024**3, 1, 8),
        "transcendentals": _rate(lambda: activations(gates), LOOPS * gates.size, cpu_cores(), 5),
    }


def _rate(run: Callable[[], Any], work: float, threads: int, repeats: int) -> float:
    """The best of five rounds."""
    import jax

    def some(_: int) -> None:
        for _ in range(repeats):
            jax.block_until_ready(run())

    some(0)
    best = float("inf")
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(5):
            start = time.perf_counter()
            list(pool.map(some, range(threads)))
            best = min(best, time.perf_counter() - start)
    return work * repeats * threads / best


def limit(work: Work, rates: dict[str, float], seconds: float) -> dict[str, float]:
    """The least seconds of `work`, and the fraction of that speed that `seconds` is."""
    least = work.flops / rates["flops"] + work.transcendentals / rates["transcendentals"]
    return {**work._asdict(), "seconds": least, "fraction": least / seconds}


def lstm(agents: float, steps: int, width: int, inputs: int = 2) -> Work:
    """`steps` of an LSTM whose inputs, `inputs` numbers, are folded into its gates."""
    return Work(2.0 * (width + inputs) * 4 * width, 5.0 * width) * (agents * steps)


def encoding(config: Any, agents: float, pairs: float) -> Work:
    """Encoder, pooling and context of a `GeneratorConfig`, `pairs` ordered pairs of agents."""
    hidden, inner, out = config.encoder_h_dim, config.pool_hidden_dim, config.bottleneck_dim
    work = lstm(agents, config.obs_len, hidden)
    pooled = 0
    if config.pooling != "none":
        per_pair = 2 * inner * out
        if config.symbolic:
            per_pair += 2 * 3 * config.obs_len * inner
        work += Work(agents * 2 * (hidden + 2) * inner + pairs * per_pair, 0)
        pooled = out
    context = (hidden + pooled) * config.mlp_dim
    context += config.mlp_dim * (config.decoder_h_dim - config.noise_dim)
    return work + Work(agents * 2 * context, 0)


def decoding(config: Any, agents: float, samples: int) -> Work:
    """`samples` futures of the agents; the chain from hidden state to gates is one matrix."""
    steps = agents * samples * config.pred_len
    width = config.decoder_h_dim
    return Work(2.0 * width * (4 * width + 2), 5.0 * width) * steps
