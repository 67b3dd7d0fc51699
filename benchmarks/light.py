"""The speed of light: what the arithmetic alone would cost at the rates this machine has.

Rates are measured in the same run, at the decoder's own sizes: products of hidden
states and the recurrent matrix, and an LSTM's gates to its next state as one fused
loop, over some numbers of rows, on one thread and on all; the best counts. Work is
counted without padding, for the folded networks: two operations for each multiply-add
of a product; what is not a product, a tanh or a sigmoid is not counted.
"""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

LOOPS = 50
"""Rounds in one call: a round takes less than a call."""
ROWS = (1024, 2560, 8192)
"""Agents times samples at once."""
WIDTH = 32
"""Hidden features of SGAN's decoder."""


class Work(NamedTuple):
    """Arithmetic of a computation."""

    flops: float
    """In matrix products."""
    transcendentals: float
    """tanh and sigmoid."""

    def __add__(self, other: Any) -> "Work":
        return Work(
            self.flops + other.flops, self.transcendentals + other.transcendentals
        )

    def __mul__(self, times: float) -> "Work":
        return Work(times * self.flops, times * self.transcendentals)


def machine_rates() -> dict[str, float]:
    """FLOPs a second of products, and tanh or sigmoid a second, all cores together."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from neurosym_jax.models.sgan.network import LSTM

    draw = np.random.default_rng(0)
    weight = jnp.asarray(draw.normal(size=(WIDTH, 4 * WIDTH)), jnp.float32)

    def multiply(gates):
        return jax.lax.fori_loop(
            0, LOOPS, lambda _, gates: gates[:, :WIDTH] @ weight, gates
        )

    def update(gates):
        # Gates change with the state, or the compiler would take them out of the loop.
        def step(_, state):
            hidden, cell = state
            return LSTM().update(
                gates + jnp.concatenate([hidden] * 4, axis=1), (hidden, cell)
            )

        return jax.lax.fori_loop(
            0, LOOPS, step, (gates[:, :WIDTH], gates[:, WIDTH : 2 * WIDTH])
        )

    work = {
        "flops": (jax.jit(multiply), 2 * WIDTH * 4 * WIDTH),
        "transcendentals": (jax.jit(update), 5 * WIDTH),
    }
    gates = [
        jnp.asarray(draw.normal(size=(rows, 4 * WIDTH)), jnp.float32) for rows in ROWS
    ]
    fastest = {}
    for name, (program, steps) in work.items():
        counts = [LOOPS * len(arrays) * steps for arrays in gates]
        rates = [_rate(program, *pair) for pair in zip(gates, counts)]
        fastest[name] = max(rates)
    return fastest


def _rate(program: Callable[[Any], Any], argument: Any, work: float) -> float:
    """The best of five rounds on one thread, where XLA splits a product itself, and on all."""
    import jax

    from neurosym_jax.runtime.process import cpu_cores

    def call(_: int) -> None:
        jax.block_until_ready(program(argument))

    call(0)
    best = 0.0
    for threads in {1, cpu_cores()}:
        with ThreadPoolExecutor(threads) as pool:
            for _ in range(5):
                start = time.perf_counter()
                list(pool.map(call, range(threads)))
                best = max(best, work * threads / (time.perf_counter() - start))
    return best


def limit(work: Work, rates: dict[str, float], seconds: float) -> dict[str, Any]:
    """The least seconds of `work` at these rates, and the fraction of that that `seconds` is."""
    least = (
        work.flops / rates["flops"] + work.transcendentals / rates["transcendentals"]
    )
    return {
        **work._asdict(),
        "rates": rates,
        "seconds": least,
        "fraction": least / seconds,
    }


def lstm(agents: float, steps: int, width: int, inputs: int = 2) -> Work:
    """`steps` of an LSTM whose inputs, `inputs` numbers, are folded into its gates."""
    return Work(2.0 * (width + inputs) * 4 * width, 5.0 * width) * (agents * steps)


def encoding(config: Any, agents: float, pairs: float) -> Work:
    """Encoder, pooling and context of a `GeneratorConfig`, `pairs` ordered pairs of agents."""
    hidden = config.encoder_h_dim
    work = lstm(agents, config.obs_len, hidden)
    pooled = 0
    if config.pools:
        inner, out = config.pooling.hidden_dim, config.pooling.bottleneck_dim
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
