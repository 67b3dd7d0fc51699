"""QTC_C1 and alpha of all ordered pairs of a window: compiled, in torch, looped, and the original.

The plain loop goes pair by pair and step by step and must give the same alpha, as torch
must. With `--neurosym-reference` the released labelling does the same pairs. Its sides
are unsigned and its labels are cut to one character, so of it the states are compared,
with ours `as_published`. Both are timed on fewer scenes.
"""

import functools
import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import OURS, Row, Timing, alternate, rows

AGENTS, SCENES, STEPS, OF_LOOP = 32, 64, 8, 2
SAMPLES, CROWD = 20, 50
ORIGINAL = "original"


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    from neurosym_jax.symbolic.qtc import alpha_table

    rng = np.random.default_rng(0)
    walks = rng.uniform(0, 8, (SCENES, AGENTS, 1, 2)) + rng.normal(
        0, 0.4, (SCENES, AGENTS, STEPS, 2)
    ).cumsum(axis=2)
    walks = walks.astype(np.float32)
    table = alpha_table("c1", rule="dominance").astype(np.float32)
    contestants: dict[str, Any] = {OURS: functools.partial(_weighed, walks)}
    if options.torch:
        contestants["torch peer"] = functools.partial(
            functools.partial, _torch_alpha, walks, table
        )
    timings = alternate(contestants, options.repeats, warm=3)
    part = walks[:OF_LOOP]
    loops: dict[str, Any] = {
        "plain loop": functools.partial(functools.partial, _loop, part, table)
    }
    if options.neurosym_reference:
        loops[ORIGINAL] = functools.partial(_original, part, options.neurosym_reference)
    scale = SCENES / OF_LOOP
    for who, timing in alternate(loops, max(1, options.repeats // 2), warm=0).items():
        wall, cpu, *rest = timing
        timings[who] = Timing(
            [scale * value for value in wall], [scale * value for value in cpu], *rest
        )
    for who, timing in timings.items():
        if timing.result is None:
            continue
        agreed = np.mean(timing.result == timings[OURS].result[: len(timing.result)])
        if agreed < 0.9999:
            raise AssertionError(f"{who} agrees in {agreed:.4%} of alpha only")
    pairs = SCENES * AGENTS * (AGENTS - 1)
    table = rows(f"{pairs} pairs, {STEPS} steps", timings)
    table += _of_samples(options.repeats)
    return {"title": "QTC and alpha of all pairs", "rows": table}


def _weighed(walks: np.ndarray) -> Callable[[], np.ndarray]:
    import jax

    from neurosym_jax.symbolic.weighting import make_weighting

    compiled = jax.jit(jax.vmap(make_weighting("cnd")))
    return lambda: np.asarray(compiled(walks))


def _of_samples(repeats: int) -> list[Row]:
    """Symbols, and probabilities of states and events, of all pairs of a scene's samples."""
    cases = ("symbols", "states forecast", "events forecast")
    found: list[Row] = []
    for case in cases:
        ours = {OURS: functools.partial(_of_sample, case)}
        title = f"{case}, {SAMPLES} samples of {CROWD} people"
        found += rows(title, alternate(ours, repeats, warm=3))
    return found


def _of_sample(case: str) -> Callable[[], None]:
    import jax
    import jax.numpy as jnp

    from neurosym_jax.symbolic.forecast import symbolic_events, symbolic_forecast
    from neurosym_jax.symbolic.qtc import observe

    rng = np.random.default_rng(0)
    walks = rng.uniform(0, 8, (CROWD, 1, 2)) + rng.normal(
        0, 0.4, (SAMPLES, CROWD, STEPS + 1, 2)
    ).cumsum(axis=2)
    paths = jnp.asarray(walks, jnp.float32)
    last, samples = paths[0, :, :1], paths[:, :, 1:]

    @jax.jit
    @jax.vmap
    def symbols(tracks: jax.Array) -> jax.Array:
        return observe(tracks[:, None], tracks, quantisation_factor=0.05)

    functions = {
        "symbols": lambda: symbols(paths),
        "states forecast": lambda: symbolic_forecast(samples, last),
        "events forecast": lambda: symbolic_events(samples, last),
    }

    def run() -> None:
        jax.block_until_ready(functions[case]())

    return run


def _original(walks: np.ndarray, reference: Path) -> Callable[[], None]:
    """Every pair labelled by the released code; its first run's states are held against ours."""
    from benchmarks.original import load_labelling
    from neurosym_jax.symbolic.qtc import observe

    label = load_labelling(reference)
    pairs = list(itertools.permutations(range(AGENTS), 2))

    def run() -> None:
        for scene in walks:
            label((scene[i], scene[j]) for i, j in pairs)

    for scene in walks:
        mine = np.asarray(observe(scene[:, None], scene, convention="as_published"))
        labels, _ = label((scene[i], scene[j]) for i, j in pairs)
        agreed = np.mean(labels == np.stack([mine[pair] for pair in pairs]))
        if agreed < 0.9999:
            raise AssertionError(f"the original agrees in {agreed:.4%} of symbols only")
    return run


def _torch_alpha(walks: np.ndarray, table: np.ndarray) -> np.ndarray:
    import torch

    with torch.inference_mode():
        position = torch.from_numpy(walks)
        before, after = position[:, :, :-1], position[:, :, 1:]
        k0, k1, l0 = before[:, :, None], after[:, :, None], before[:, None]
        line, move = l0 - k0, k1 - k0
        towards = torch.linalg.vector_norm(k1 - l0, dim=-1)
        q1 = torch.sign(towards - torch.linalg.vector_norm(line, dim=-1))
        q3 = torch.sign(move[..., 0] * line[..., 1] - move[..., 1] * line[..., 0])
        code = (q1 + 1) * 27 + (q1.transpose(1, 2) + 1) * 9
        code += (q3 + 1) * 3 + q3.transpose(1, 2) + 1
        alpha = torch.zeros(*code.shape[:3], STEPS)
        alpha[..., 1:] = torch.from_numpy(table)[code.long()]
        alpha[:, torch.arange(AGENTS), torch.arange(AGENTS)] = 1
        return alpha.numpy()


def _loop(walks: np.ndarray, table: np.ndarray) -> np.ndarray:
    scenes = walks.tolist()
    alpha = np.zeros((len(scenes), AGENTS, AGENTS, STEPS), np.float32)
    for number, scene in enumerate(scenes):
        for i, k in enumerate(scene):
            for j, l in enumerate(scene):  # noqa: E741
                for step in range(STEPS):
                    if i == j:
                        alpha[number, i, j, step] = 1
                    elif step:
                        mine = _symbols(k[step - 1], k[step], l[step - 1])
                        other = _symbols(l[step - 1], l[step], k[step - 1])
                        code = 27 * mine[0] + 9 * other[0] + 3 * mine[1] + other[1]
                        alpha[number, i, j, step] = table[code]
    return alpha


def _symbols(
    before: list[float], after: list[float], other: list[float]
) -> tuple[int, int]:
    """(q1 + 1, q3 + 1) of a mover."""
    now, then = math.dist(after, other), math.dist(before, other)
    line = other[0] - before[0], other[1] - before[1]
    left = (after[0] - before[0]) * line[1]
    right = (after[1] - before[1]) * line[0]
    return 1 + (now > then) - (now < then), 1 + (left > right) - (left < right)
