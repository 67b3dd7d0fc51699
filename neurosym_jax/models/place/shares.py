"""How much of a forecast comes from the memory: chosen by scores, with a bound.

Experts are mixtures of the network and one kernel, in several shares, and the network
alone. Each has the weight `exp(-RATE * its total energy score)`, times its weight
before anything was scored. The forecast is the mixture of all of them. The energy score
is convex in the forecast, so the forecast scores at least as well as the experts do on
average, and without delay its total exceeds that of the best expert by at most
`log(1 / weight before) / RATE + RATE / 8 * sum(range**2)`, with the range of the
experts' scores in each step (N. Cesa-Bianchi and G. Lugosi, Prediction, Learning, and
Games, 2006, theorem 2.2). The delay of
the truth adds to it.

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

__all__ = ["LOSS", "RATE", "Commitment", "Ledger", "Scored", "experts", "new_ledger"]
__all__ += ["risk_of"]

RATE = 0.7
"""How fast weights follow scores, per metre."""
ALONE = 0.2
"""Weight of the network alone before anything was scored."""
STEPS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.9)
"""Shares of the memory that experts have."""
LOSS = 1.0
"""Scores, as the network expects them, that the forecasts of a horizon may lose."""


class Commitment(NamedTuple):
    """What was decided when the forecasts of a step were made."""

    shares: np.ndarray
    """[1 + K] probability of each component in the forecasts."""
    risk: np.ndarray
    """[N] by how much each score can exceed that of the network, metres."""
    expected: float
    """Sum of the scores that the network expects of its own forecasts, metres."""


class Scored(NamedTuple):
    """Total energy scores of the forecasts of one step, metres."""

    people: int
    network: float
    used: float


def experts(kernels: int) -> np.ndarray:
    """[E, 1 + K] probability of each component for each expert; the network is first."""
    alone = np.eye(1 + kernels)[0]
    rows = [alone]
    for kernel in np.eye(1 + kernels)[1:]:
        for share in STEPS:
            rows.append((1 - share) * alone + share * kernel)
    return np.array(rows)


@dataclasses.dataclass(frozen=True, eq=False)
class Ledger:
    """Weights of the experts, and what the memory may still lose."""

    experts: np.ndarray
    """[E, 1 + K] see `experts`."""
    first: np.ndarray
    """[E] logarithms of their weights before anything was scored."""
    log_weight: np.ndarray
    """[E] up to a constant."""
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
    rate: float = RATE
    loss: float = LOSS

    @property
    def limit(self) -> float:
        """By how much the total may exceed that of the network, metres."""
        return self.loss * self.most

    @property
    def wanted(self) -> np.ndarray:
        """[1 + K] probability of each component by the weights of the experts."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return weight @ self.experts / weight.sum()

    def commit(
        self, distances: np.ndarray, filled: np.ndarray
    ) -> tuple["Ledger", Commitment]:
        """Decide on the forecasts of a step, and take their risk.

        `distances [N, 1 + K, 1 + K]` and `filled [N, K]` are those of `risk_of`.
        """
        # Half the distance between two draws is the score of a truth drawn likewise.
        expected = float(distances[:, 0, 0].sum() / 2)
        awaited = self.awaited + expected
        ledger = dataclasses.replace(
            self, awaited=awaited, most=max(self.most, awaited)
        )
        shares = self.wanted
        risk = risk_of(shares, distances, filled)
        left = max(ledger.limit + self.gain - self.reserved, 0.0)
        # The score is convex: part of the way to the mixture has part of its risk.
        part = min(left / max(risk.sum(), 1e-12), 1.0)
        alone = np.eye(len(shares))[0]
        shares = part * shares + (1 - part) * alone
        commitment = Commitment(shares, part * risk, expected)
        reserved = self.reserved + commitment.risk.sum()
        return dataclasses.replace(ledger, reserved=reserved), commitment

    def fade(self, kept: float) -> "Ledger":
        """The ledger whose scores so far count for a part of what they did.

        The bound does not depend on it: risk is taken of whatever is wanted.
        """
        if kept == 1:
            return self
        log_weight = self.first + kept * (self.log_weight - self.first)
        return dataclasses.replace(self, log_weight=log_weight)

    def release(self, commitment: Commitment) -> "Ledger":
        """Give back the risk of forecasts, whether their truth came or not."""
        awaited = max(self.awaited - commitment.expected, 0.0)
        reserved = max(self.reserved - commitment.risk.sum(), 0.0)
        return dataclasses.replace(self, awaited=awaited, reserved=reserved)

    def learn(
        self, commitment: Commitment, error: np.ndarray, distances: np.ndarray
    ) -> tuple["Ledger", Scored]:
        """Score the forecasts of a step whose truth has come.

        Args:
            commitment: as it was made, already released.
            error: [N, 1 + K] of the people whose truth has come, see `errors`.
            distances: [N, 1 + K, 1 + K] of the same people.
        """
        score = energy(self.experts, error, distances)
        log_weight = self.log_weight - self.rate * score.sum(axis=0)
        used = energy(commitment.shares[None], error, distances)[:, 0].sum()
        network = score[:, 0].sum()
        gain = min(self.gain + network - used, self.limit)
        lost = max(self.lost + used - network, 0.0)
        ledger = dataclasses.replace(
            self, log_weight=log_weight - log_weight.max(), gain=gain, lost=lost
        )
        return ledger, Scored(len(error), float(network), float(used))


def new_ledger(components: ArrayLike, loss: float = LOSS) -> Ledger:
    """The ledger of a place where nothing was scored yet.

    `components [K]` are first weights of what is recalled, in proportion.
    """
    weight = np.repeat(np.asarray(components, float), len(STEPS))
    weight = np.append(ALONE, (1 - ALONE) * weight / weight.sum())
    first = np.log(weight)
    rows = experts(np.size(components))
    return Ledger(rows, first, first, loss=loss)


def risk_of(
    shares: np.ndarray, distances: np.ndarray, filled: np.ndarray
) -> np.ndarray:
    """[N] by how much a mixture can score worse than the network, whatever happens.

    What a kernel recalls lies farther from the truth than the network by no more than
    the distance of both. The rest of the score is known beforehand.

    Args:
        shares: [1 + K] probability of each component.
        distances: [N, 1 + K, 1 + K] see `distances_apart`.
        filled: [N, K] how much of each component is recalled; the rest is the network.
    """
    recalled = distances[:, 0, 1:] - (1 - filled) * distances[:, :1, 0]
    farther = recalled @ shares[1:]
    within = np.einsum("ncd,c,d->n", distances, shares, shares)
    return np.maximum(farther - (within - distances[:, 0, 0]) / 2, 0.0)
