"""Conceptual neighbourhood diagrams: which QTC states can follow each other when points move.

Two states are neighbours by the `dominance` rule of the theory (Van de Weghe and De Maeyer,
"Conceptual neighbourhood diagrams for representing moving objects", 2005) if symbols change only
between 0 and another value (continuity), and those that change all arrive at 0 or all leave it: a
value other than 0 holds over an interval, 0 may hold at an instant, so no symbol can leave 0 at the
very instant at which another one arrives there. The `continuity` rule, which NeuroSyM's released
table uses, drops the second condition: 1160 edges of QTC_C1 instead of 544. A QTC_BC state of a
pair apart and one of a pair near are compared by the symbols that both have.

Tables are read-only; their rows are those of `states.all_states`.
"""

import functools
from typing import Literal

import numpy as np

from neurosym_jax.configuration import refuse
from neurosym_jax.symbolic.states import ABSENT, Calculus, all_states

__all__ = ["Rule", "adjacency", "alpha_table"]

Rule = Literal["dominance", "continuity"]


@functools.cache
def adjacency(calculus: Calculus = "c1", rule: Rule = "dominance") -> np.ndarray:
    """[S, S] bool, symmetric: which states are neighbours; none is its own.

    Raises:
        InputError: for an unknown calculus or rule.
    """
    refuse(Rule, {"rule": rule})
    states = all_states(calculus)
    a, b = states[:, None], states[None]
    # A symbol that only one of them has is not compared; staying is no transition.
    same = (a == b) | (a == ABSENT) | (b == ABSENT)
    table = ~(a == b).all(axis=-1) & (same | (a * b == 0)).all(axis=-1)
    if rule == "dominance":
        table &= (same | (b == 0)).all(axis=-1) | (same | (a == 0)).all(axis=-1)
    table.flags.writeable = False
    return table


@functools.cache
def alpha_table(
    calculus: Calculus = "c1", rule: Rule = "dominance", include_self: bool = False
) -> np.ndarray:
    """[S] float64: 1 / N_Tr of every state, N_Tr its number of neighbours.

    Mghames et al., "A Neuro-Symbolic Approach for Enhanced Human Motion Prediction" (2023): the
    more transitions a state has, the less it says. QTC_C1 states with 0, 1, 2, 3 or 4 zeros weigh
    1/15, 1/9, 1/11, 1/27, 1/80. The authors' table is `rule="continuity"` with `include_self=True`,
    which counts staying in the state as a transition: 1 / (2^nonzero 3^zero).
    """
    table = 1 / (adjacency(calculus, rule).sum(axis=1) + include_self)
    table.flags.writeable = False
    return table
