"""Probable events of the pairs of a forecast that come nearest to each other.

They are computed only when asked for: by the page, a topic with subscribers, a bag.
`symbolic.events` defines the events, `symbolic.forecast` turns samples into
probabilities.
"""

from typing import NamedTuple

import numpy as np

from neurosym_robot.online.predictor import Forecast
from neurosym_robot.tracking.names import name_of

AT_LEAST = 0.5  # least probability of an event that is listed
# pairs that are looked at: those whose mean paths come nearest to each other
PAIRS = 16


class LikelyEvent(NamedTuple):
    """A probable event of the pair k, l."""

    name: str  # of `symbolic.events`
    k: int  # row of the subject among the forecast's people
    l: int  # noqa: E741, row of the other; the calculus calls the two k and l
    probability: float
    seconds: float  # from the last step observed to the event, median over samples that have it

    def words(self, ids: np.ndarray) -> str:
        """Such as `3 follows 5: 80 %, in 1.2 s`; `ids` [N] of the people."""
        from neurosym_jax.symbolic.events import EVENTS

        sentence = (
            EVENTS[self.name]
            .in_short(self.name)
            .format(k=name_of(int(ids[self.k])), l=name_of(int(ids[self.l])))
        )
        return f"{sentence}: {100 * self.probability:.0f} %, in {self.seconds:.1f} s"


def likely_events(
    forecast: Forecast, model: str, period: float, at_least: float = AT_LEAST
) -> list[LikelyEvent]:
    """Events of the nearest pairs with a probability of `at_least`, most probable first.

    `period` is that of the steps, seconds.
    """
    from neurosym_jax.symbolic.events import EVENTS
    from neurosym_jax.symbolic.forecast import symbolic_events

    result = forecast.models[model]
    i, j = np.triu_indices(len(result.mean), 1)
    distance = np.square(result.mean[i] - result.mean[j]).sum(axis=-1).min(axis=-1)
    nearest = np.argsort(distance, kind="stable")[:PAIRS]
    if not len(nearest):
        return []
    near = np.stack([i[nearest], j[nearest]], axis=1)
    # Both directions of a pair; always as many, so that one program serves all.
    pairs = np.resize(np.concatenate([near, near[:, ::-1]]), (2 * PAIRS, 2))
    ends = pairs.T.ravel()
    outcomes = symbolic_events(
        result.draws[:, ends],
        forecast.observed[ends, -1:],
        events=tuple(EVENTS),
        pairs=np.arange(len(ends)).reshape(2, -1).T,
        period=period,
    )
    share, seconds = (
        np.asarray(outcomes.probability),
        np.asarray(outcomes.seconds)[..., 1],
    )
    names, listed = tuple(EVENTS), []
    for event, row in np.argwhere(share[:, : 2 * len(near)] >= at_least).tolist():
        # A mutual event has the same probability in both directions, and is listed
        # once.
        once = row < len(near) or not EVENTS[names[event]].mutual
        if once and np.isfinite(seconds[event, row]):
            subject, other = pairs[row].tolist()
            numbers = float(share[event, row]), float(seconds[event, row])
            listed.append(LikelyEvent(names[event], subject, other, *numbers))
    return sorted(listed, key=lambda item: (-item.probability, item.seconds))
