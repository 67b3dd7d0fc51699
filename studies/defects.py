"""What the defects of NeuroSyM's released code do to the numbers, measured on data.

python -m studies.defects [DATA]

DATA is what `python evaluate.py --data` takes; without it, the embedded simulations.
Everything is counted over the ordered pairs of different agents in the observed steps
of the test windows (8 + 8 steps, at least 2 agents), in float64: what a network is
given, so a moment counts as often as it is in a window. The figures are explained in
docs/symbols.md.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.data.recordings import open_source
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.symbolic.qtc import (
    NeighbourRule,
    adjacency,
    alpha_table,
    encode_state,
    observe,
)

STEPS = 8
CHUNK = 65_536
"""Pairs at a time: one compiled shape, and memory that does not grow with the data."""
LABELS = (
    "states without a 0 (the authors' alpha is 1/16)",
    "  quantised at 0.05 m a step",
    "states that differ by convention in q1 or q2",
    "states that lose a - in q3 or q4 (defect 1)",
    "consecutive states with a jump from - to + or back",
    "  quantised at 0.05 m a step",
    "changes of state that continuity allows",
    "changes of state that dominance allows (defect 6)",
    "rows of alpha that are the scene's (defect 3)",
    "rows of alpha that are the pair's (defect 3)",
)


def measure(data: Path | None) -> None:
    """Print a table: a column for each scene, all pairs together, and the mean over scenes."""
    source = open_source(data)
    counts = []
    for scene in source.scenes:
        windows = cut_windows(source.recordings(scene), STEPS, STEPS)
        counts.append(np.array([*count(windows), *rows_served(windows.sizes)]))
    counts.append(np.sum(counts, axis=0))
    shares = np.array(
        [100 * part / total for part, total in (table.T for table in counts)]
    )
    shares = np.concatenate([shares, shares[:-1].mean(axis=0, keepdims=True)])
    width = max(map(len, LABELS))
    titles = "".join(f"{title:>12}" for title in (*source.scenes, "all", "mean"))
    print(f"{'per cent':{width}}  {titles}")
    for label, row in zip(LABELS, shares.T):
        print(f"{label:{width}}  " + "".join(f"{share:12.1f}" for share in row))
    own, reads = counts[-1][-1]
    print(f"the pair's are {own} of {reads} rows ({own / reads:.3%})")


def count(windows: Windows) -> np.ndarray:
    """[labels, 2] (how many, of how many) over all pairs of one test set."""
    total = np.zeros((len(LABELS) - 2, 2), int)
    for k, l, real in pairs(windows):  # noqa: E741
        # The last chunk is filled up with pairs that are not there.
        total += np.asarray(_count(k, l))[..., :real].sum(axis=-1)
    return total


def pairs(windows: Windows) -> Iterator[tuple[np.ndarray, np.ndarray, int]]:
    """Chunks (k, l, real): [CHUNK, STEPS, 2] positions, of which the first `real` are pairs."""
    people = [np.arange(*ends) for ends in zip(windows.bounds, windows.bounds[1:])]
    i, j = (
        np.concatenate([expand(p, len(p)) for p in people])
        for expand in (np.repeat, np.tile)
    )
    i, j = i[i != j], j[i != j]
    observed = windows.position[:, :STEPS]
    for start in range(0, len(i), CHUNK):
        part = slice(start, start + CHUNK)
        fill = [(0, CHUNK - len(i[part]))]
        yield (
            observed[np.pad(i[part], fill)],
            observed[np.pad(j[part], fill)],
            len(i[part]),
        )


@jax.jit
def _count(k: jax.Array, l: jax.Array) -> jax.Array:  # noqa: E741
    """[labels, 2, CHUNK]: for each pair (how many, of how many)."""
    exact = observe(k, l)
    coarse = observe(k, l, quantisation_factor=0.05)
    line = observe(k, l, convention="line")
    unsigned = observe(k, l, convention="as_published")
    codes = encode_state(exact)
    before, after = codes[:, :-1], codes[:, 1:]

    def jumps(states: jax.Array) -> jax.Array:
        return (states[:, 1:] * states[:, :-1] == -1).any(axis=-1)

    def follows(rule: NeighbourRule) -> jax.Array:
        return jnp.asarray(adjacency("c1", rule))[before, after]

    always, moves = jnp.ones_like(codes, bool), jnp.ones_like(before, bool)
    counted = [
        ((exact != 0).all(axis=-1), always),
        ((coarse != 0).all(axis=-1), always),
        ((exact != line)[..., :2].any(axis=-1), always),
        ((exact != unsigned).any(axis=-1), always),
        (jumps(exact), moves),
        (jumps(coarse), moves),
        (follows("continuity"), before != after),
        (follows("dominance"), before != after),
    ]
    return jnp.stack(
        [jnp.stack([hits.sum(1), cases.sum(1)]) for hits, cases in counted]
    )


def rows_served(sizes: np.ndarray) -> tuple[tuple[int, int], tuple[int, int]]:
    """How often the earlier release's collation serves a pair its own row of alpha (defect 3)."""
    ends = np.cumsum(sizes)
    bounds = np.stack([ends - sizes, ends], axis=1)
    scene = np.repeat(np.arange(len(sizes)), sizes**2)
    numbers = np.arange(len(scene))[:, None]
    own_scene = own_pair = 0
    first = np.cumsum(sizes**2) - sizes**2
    # The release has a row for each pair, and slices the rows by the bounds of the
    # agents.
    for s, rows in enumerate(numbers[a:b] for a, b in bounds):
        own_scene += int((scene[rows[:, 0]] == s).sum() * sizes[s])
        own_rows = first[s] + np.arange(sizes[s] ** 2).reshape(sizes[s], sizes[s])
        own_pair += int((own_rows == rows[:, 0]).sum())
    reads = int((sizes**2).sum())
    return (own_scene, reads), (own_pair, reads)


def tables() -> None:
    """Print the weights by number of zero symbols, and how live windows are put out of order."""
    described, shipped = alpha_table("c1"), alpha_table("c1", "continuity", True)
    print("\nalpha by number of zero symbols  " + "".join(f"{z:>9}" for z in range(5)))
    for name, table in (("papers (cnd)", described), ("authors' table", shipped)):
        # A code's digits are q + 1: here z of 1 (the symbol 0) after others of 0 (the
        # symbol -).
        weights = [table[sum(3**place for place in range(z))] for z in range(5)]
        print(f"  {name:31}" + "".join(f"{f'1/{round(1 / w)}':>9}" for w in weights))
    first = [f"{weight:.4f}"[0] for weight in np.unique(shipped)]
    print(f"first characters of the authors' weights (defect 2): {', '.join(first)}")
    stamps = np.random.default_rng(0).uniform(0, 1, 100_000)[:, None] + 0.1 * np.arange(
        STEPS
    )
    shuffled = (np.diff(stamps % 1) < 0).any(axis=1).mean()
    print(
        f"windows of 8 samples at 10 Hz out of order by nanosecond (defect 7): {shuffled:.0%}"
    )


def main(arguments: list[str]) -> None:
    """Measure the data that `arguments` name."""
    jax.config.update("jax_enable_x64", True)
    measure(Path(arguments[0]) if arguments else None)
    tables()


if __name__ == "__main__":
    main(sys.argv[1:])
