"""How much of a forecast comes from the memory: chosen by scores, with a bound.

A forecast is a mixture of components: the network, and what is recalled. Of all mixtures
that one is taken whose total energy score so far is least, plus `1 / RATE` times its
divergence from the shares before anything was scored (follow the regularised leader).
The energy score is convex in the shares. So without delay the total exceeds that of any
mixture in hindsight by at most `divergence / RATE + RATE * sum(slope**2)`, with the
largest slope of the score of each step, up to a constant for all components
(S. Shalev-Shwartz, Online Learning and Online Convex Optimization, 2012, theorem 2.11).
The delay of the truth adds to it.

People who stand or stroll are forecast with other shares than those who walk. Scores of
the others count for `OTHERS`, so that a place is learned from everybody at first.

That bound grows with time. Against the network alone there is one that does not: a
ledger. When a forecast is made, its score can exceed that of the network by no more
than its risk, whatever happens, by the triangle inequality. The risk is taken from what
the memory may lose and given back once the truth has come, with what was won or lost.
Where too little is left, the
share of the memory is smaller. So the total never exceeds that of the network by more
than `LOSS` times what the network expects of its own scores, summed over the forecasts
whose truth was awaited at once, when that was most; and after any moment by no more
than twice that. A place that is watched for hours loses at most one horizon's score.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.models.place.mixture import energy

__all__ = ["LOSS", "PACES", "RATE", "Commitment", "Ledger", "Scored", "best_mixture"]
__all__ += ["new_ledger", "pace_of", "risk_of"]

RATE = 2.0
"""How fast shares follow scores, per metre."""
ALONE = 1 / 3
"""Share of the network before anything was scored."""
WALKS = 0.5
"""Speed in metres per second from which on a person walks."""
PACES = 2
"""People who stand or stroll, and people who walk."""
OTHERS = 0.1
"""How much the scores of people of another pace count."""
LEAST = 1e-9
"""Least share of a component in what scores choose."""
ROUNDS = 40
"""Steps of descent from the shares before to those now."""
LOSS = 1.0
"""Scores, as the network expects them, that the forecasts of a horizon may lose."""


class Commitment(NamedTuple):
    """What was decided when the forecasts of a step were made."""

    pace: np.ndarray
    """[N] int, see `pace_of`."""
    shares: np.ndarray
    """[PACES, 1 + K] probability of each component in forecasts of people of each pace."""
    risk: np.ndarray
    """[N] by how much each score can exceed that of the network, metres."""
    expected: float
    """Sum of the scores that the network expects of its own forecasts, metres."""


class Scored(NamedTuple):
    """Total energy scores of the forecasts of one step, metres."""

    people: int
    network: float
    used: float


def pace_of(velocity: np.ndarray) -> np.ndarray:
    """[N] 1 for people who walk with `velocity [N, 2]`, m/s, 0 for those who stand or stroll."""
    return (np.linalg.norm(velocity, axis=1) >= WALKS).astype(int)


def best_mixture(
    error: np.ndarray, distances: np.ndarray, first: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """[G, C] shares with the least total energy score, not far from `first`.

    Found by mirror descent from `start`, with steps that cannot overshoot: H. Lu et al.,
    SIAM Journal on Optimization 28 (2018), theorem 3.1.

    Args:
        error: [G, C] summed distances of the components from the truth.
        distances: [G, C, C] summed distances of the components from each other.
        first: [C] positive shares.
        start: [G, C] positive shares.
    """
    within = np.diagonal(distances, axis1=1, axis2=2)
    apart = 2 * distances - within[:, :, None] - within[:, None]
    curvature = apart.max(axis=(1, 2)).clip(0) / 4 + 1 / RATE
    log_share = np.log(start)
    share = start
    for _ in range(ROUNDS):
        slope = error - np.einsum("gcd,gd->gc", distances, share)
        slope += (log_share - np.log(first)) / RATE
        log_share = log_share - slope / curvature[:, None]
        log_share -= log_share.max(axis=1, keepdims=True)
        # A share that has vanished could not come back.
        share = np.maximum(np.exp(log_share), LEAST)
        share /= share.sum(axis=1, keepdims=True)
        log_share = np.log(share)
    return share


@dataclasses.dataclass(frozen=True, eq=False)
class Ledger:
    """Scores of the components so far, and what the memory may still lose."""

    first: np.ndarray
    """[1 + K] shares before anything was scored."""
    shares: np.ndarray
    """[PACES, 1 + K] shares by the scores, of people of each pace."""
    people: np.ndarray
    """[PACES] how many forecasts were scored."""
    error: np.ndarray
    """[PACES, 1 + K] their summed errors, see `best_mixture`."""
    distances: np.ndarray
    """[PACES, 1 + K, 1 + K] and distances."""
    gain: float = 0.0
    """Metres won against the network, no more than may be lost at once."""
    reserved: float = 0.0
    """Metres: the risk of all forecasts whose truth is awaited."""
    awaited: float = 0.0
    """Metres: the sum of `Commitment.expected` of these forecasts."""
    most: float = 0.0
    """The most that was awaited at once."""
    lost: float = 0.0
    """Metres lost against the network since the memory was last at its best."""
    loss: float = LOSS

    @property
    def limit(self) -> float:
        """By how much the total may exceed that of the network, metres."""
        return self.loss * self.most

    @property
    def wanted(self) -> np.ndarray:
        """[PACES, 1 + K] probability of each component by the scores so far."""
        error, distances = (
            (1 - OTHERS) * total + OTHERS * total.sum(axis=0)
            for total in (self.error, self.distances)
        )
        return best_mixture(error, distances, self.first, self.shares)

    def commit(
        self, distances: np.ndarray, filled: np.ndarray, pace: np.ndarray
    ) -> tuple["Ledger", Commitment]:
        """Decide on the forecasts of a step, and take their risk.

        `distances [N, 1 + K, 1 + K]` and `filled [N, K]` are those of `risk_of`,
        `pace [N]` that of `pace_of`.
        """
        # Half the distance between two draws is the score of a truth drawn likewise.
        expected = float(distances[:, 0, 0].sum() / 2)
        awaited = self.awaited + expected
        shares = self.wanted
        ledger = dataclasses.replace(
            self, shares=shares, awaited=awaited, most=max(self.most, awaited)
        )
        risk = risk_of(shares[pace], distances, filled)
        left = max(ledger.limit + self.gain - self.reserved, 0.0)
        # The score is convex: part of the way to the mixture has part of its risk.
        part = min(left / max(risk.sum(), 1e-12), 1.0)
        alone = np.eye(len(self.first))[0]
        shares = part * shares + (1 - part) * alone
        commitment = Commitment(pace, shares, part * risk, expected)
        reserved = self.reserved + commitment.risk.sum()
        return dataclasses.replace(ledger, reserved=reserved), commitment

    def fade(self, kept: float) -> "Ledger":
        """The ledger whose scores so far count for a part of what they did.

        The bound does not depend on it: risk is taken of whatever is wanted.
        """
        if kept == 1:
            return self
        return dataclasses.replace(
            self,
            people=kept * self.people,
            error=kept * self.error,
            distances=kept * self.distances,
        )

    def release(self, commitment: Commitment) -> "Ledger":
        """Give back the risk of forecasts, whether their truth came or not."""
        awaited = max(self.awaited - commitment.expected, 0.0)
        reserved = max(self.reserved - commitment.risk.sum(), 0.0)
        return dataclasses.replace(self, awaited=awaited, reserved=reserved)

    def learn(
        self,
        commitment: Commitment,
        error: np.ndarray,
        distances: np.ndarray,
        pace: np.ndarray,
    ) -> tuple["Ledger", Scored]:
        """Score the forecasts of a step whose truth has come.

        Args:
            commitment: as it was made, already released.
            error: [N, 1 + K] of the people whose truth has come, see `errors`.
            distances: [N, 1 + K, 1 + K] of the same people.
            pace: [N] as they were committed.
        """
        used = energy(commitment.shares[pace], error, distances).sum()
        network = (error[:, 0] - distances[:, 0, 0] / 2).sum()
        gain = min(self.gain + network - used, self.limit)
        lost = max(self.lost + used - network, 0.0)
        is_of = pace == np.arange(PACES)[:, None]
        ledger = dataclasses.replace(
            self,
            people=self.people + is_of.sum(axis=1),
            error=self.error + is_of @ error,
            distances=self.distances + np.einsum("gn,ncd->gcd", is_of, distances),
            gain=gain,
            lost=lost,
        )
        return ledger, Scored(len(error), float(network), float(used))


def new_ledger(components: ArrayLike, loss: float = LOSS) -> Ledger:
    """The ledger of a place where nothing was scored yet.

    `components [K]` are first shares of what is recalled, in proportion.
    """
    recalled = np.asarray(components, float)
    first = np.append(ALONE, (1 - ALONE) * recalled / recalled.sum())
    count = len(first)
    return Ledger(
        first=first,
        shares=np.tile(first, (PACES, 1)),
        people=np.zeros(PACES),
        error=np.zeros((PACES, count)),
        distances=np.zeros((PACES, count, count)),
        loss=loss,
    )


def risk_of(
    shares: np.ndarray, distances: np.ndarray, filled: np.ndarray
) -> np.ndarray:
    """[N] by how much a mixture can score worse than the network, whatever happens.

    What a kernel recalls lies farther from the truth than the network by no more than
    the distance of both. The rest of the score is known beforehand.

    Args:
        shares: [N, 1 + K] probability of each component.
        distances: [N, 1 + K, 1 + K] see `distances_apart`.
        filled: [N, K] how much of each component is recalled; the rest is the network.
    """
    recalled = distances[:, 0, 1:] - (1 - filled) * distances[:, :1, 0]
    farther = (recalled * shares[:, 1:]).sum(axis=1)
    within = np.einsum("ncd,nc,nd->n", distances, shares, shares)
    return np.maximum(farther - (within - distances[:, 0, 0]) / 2, 0.0)
