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

        k, other = (name_of(int(ids[row])) for row in (self.k, self.l))
        form = EVENTS[self.name].in_short(self.name)
        sentence = form.format(k=k, l=other)
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
    offset = result.mean[i] - result.mean[j]
    square = np.square(offset).sum(axis=-1)
    distance = square.min(axis=-1)
    nearest = np.argsort(distance, kind="stable")[:PAIRS]
    if not len(nearest):
        return []
    near = np.stack([i[nearest], j[nearest]], axis=1)
    # Both directions of a pair; always as many, so that one program serves all.
    both = np.concatenate([near, near[:, ::-1]])
    pairs = np.resize(both, (2 * PAIRS, 2))
    ends = pairs.T.ravel()
    outcomes = symbolic_events(
        result.draws[:, ends],
        forecast.observed[ends, -1:],
        events=tuple(EVENTS),
        pairs=np.arange(len(ends)).reshape(2, -1).T,
        period=period,
    )
    share = np.asarray(outcomes.probability)[:, : len(both)]
    seconds = np.asarray(outcomes.seconds)[..., 1]
    names = tuple(EVENTS)
    listed = []
    for event, row in np.argwhere(share >= at_least).tolist():
        name = names[event]
        # A mutual event has the same probability in both directions, and is listed
        # once.
        is_twice = EVENTS[name].mutual and row >= len(near)
        if is_twice or not np.isfinite(seconds[event, row]):
            continue
        subject, other = pairs[row].tolist()
        likely = LikelyEvent(
            name=name,
            k=subject,
            l=other,
            probability=float(share[event, row]),
            seconds=float(seconds[event, row]),
        )
        listed.append(likely)
    return sorted(listed, key=lambda item: (-item.probability, item.seconds))
