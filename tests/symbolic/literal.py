"""QTC by the letter: symbols, states, neighbours and weights, in plain loops of Python's floats.

Written from the definitions that docs/symbols.md gives with their papers, and sharing
no code with the package, it is what tests compare with. On positions in eighths of a
metre, and on integers, sums and products of floats are exact, so a tie is a tie.
"""

import itertools
import math
import random

import numpy as np

CALCULI = ("b1", "c1", "bc1")
CONVENTIONS = ("distance", "line", "as_published")


def grid_walks(pairs, steps=7, unit=0.125, seed=0):
    """(k, l), each [pairs, steps + 1, 2] lists in metres: people stand, meet and walk on lines."""
    draw = random.Random(seed)

    def walk():
        at = [(draw.randint(-6, 6), draw.randint(-6, 6))]
        for _ in range(steps):
            at.append(
                tuple(x + draw.choice((0, 0, 0, -1, 1, -2, 2, -3, 3)) for x in at[-1])
            )
        return [[x * unit, y * unit] for x, y in at]

    first = [walk() for _ in range(pairs)]
    return first, [walk() for _ in range(pairs)]


def unit_steps():
    """(k, l), each [81, 2, 2] lists: two people 4 m apart take every step of a king in chess."""
    steps = list(itertools.product((-1, 0, 1), repeat=2))
    pairs = [
        ([[0, 0], [vx, vy]], [[4, 0], [4 + wx, wy]])
        for (vx, vy), (wx, wy) in itertools.product(steps, steps)
    ]
    return tuple(list(side) for side in zip(*pairs))


def sign(value, threshold=0.0):
    return (value > threshold) - (value < -threshold)


def norm(a):
    return math.sqrt(a.real**2 + a.imag**2)


def away_and_aside(k0, k1, l0, convention):
    """Metres that the step from k0 to k1 leads away from l0 (q1), and right of the line (q3)."""
    k0, k1, l0 = (complex(*at) for at in (k0, k1, l0))
    step, line = k1 - k0, l0 - k0
    distance, turned = (
        norm(line),
        step.conjugate() * line,
    )  # Their dot and cross products.
    along, aside = (
        (-turned.real / distance, turned.imag / distance) if distance else (0, 0)
    )
    # The component along the line through both, or by how much the distance grows.
    return along if convention == "line" else norm(k1 - l0) - distance, aside


def margins(k, l, convention="distance"):
    """[T-1, 4] metres of every step of k and l [T, 2], whose signs are q1 to q4."""
    rows = []
    for (k0, k1), (l0, l1) in zip(itertools.pairwise(k), itertools.pairwise(l)):
        ways = (k0, k1, l0), (l0, l1, k0)
        margins = zip(*(away_and_aside(*way, convention) for way in ways))
        rows.append(list(itertools.chain(*margins)))
    return rows


def symbols(k, l, convention="distance", factor=0.0, side_factor=None):
    """[T-1, 4]: q1 to q4 of every step of k and l [T, 2]; thresholds in metres per step."""
    if side_factor is None:
        side_factor = factor if convention == "line" else 0.0
    factors = factor, factor, side_factor, side_factor
    states = [list(map(sign, step, factors)) for step in margins(k, l, convention)]
    if convention == "as_published":  # The norm of the cross product is never negative.
        return [[q1, q2, abs(q3), abs(q4)] for q1, q2, q3, q4 in states]
    return states


def converse(states):
    """States [..., m] of (l, k) from those of (k, l): symbols change places."""
    states = np.asarray(states)
    return states[..., [1, 0, 3, 2][: states.shape[-1]]]


def states(calculus):
    """Sorted tuples of symbols of `b1` or `c1`: every combination is possible."""
    return sorted(itertools.product((-1, 0, 1), repeat=2 if calculus == "b1" else 4))


def may_follow(a, b, rule="dominance"):
    """Whether b may follow a: nothing jumps over 0, by dominance none leaves it as another arrives.

    Staying is not to follow.
    """
    changed = [(x, y) for x, y in zip(a, b) if x != y]
    if any(x * y for x, y in changed):
        return False
    arrive, leave = all(y == 0 for _, y in changed), all(x == 0 for x, _ in changed)
    return bool(changed) and (rule == "continuity" or arrive or leave)


def neighbours(rows, rule="dominance"):
    """[S, S] lists of bool: which of the states may follow which."""
    return [[may_follow(a, b, rule) for b in rows] for a in rows]


def shipped_alpha(state):
    """The authors' weight: 1 / (2^nonzero 3^zero), staying counted as a transition."""
    return 1 / math.prod(3 if q == 0 else 2 for q in state)
