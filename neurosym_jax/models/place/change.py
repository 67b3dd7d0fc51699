"""By how much scores change with the memory, and how sure that is."""

import dataclasses
import math

__all__ = ["Change"]

BLOCK = 60.0
"""Seconds of a block: people are in view for less, so blocks hardly depend on each other."""
ENOUGH = 10
"""Blocks from which on an interval is told."""
TWO_SIDED = 2.27
"""Standard errors of a 95 % interval with ten blocks, Student's; of more it is a little wide."""


@dataclasses.dataclass(frozen=True)
class Change:
    """Ratio of the scores with the memory to those without it, over blocks of time.

    The interval is that of a ratio of sums over independent blocks: W. Cochran, Sampling
    Techniques, 1977, section 6.4.
    """

    blocks: int = 0
    begun: float = -math.inf
    """Seconds at which the block that is not over began."""
    network: float = 0.0
    """Sum of that block without the memory, metres."""
    saved: float = 0.0
    """What the memory took from it, metres."""
    total_network: float = 0.0
    total_saved: float = 0.0
    """Sums over all blocks that are over, and sums of their products."""
    network_network: float = 0.0
    network_saved: float = 0.0
    saved_saved: float = 0.0

    def add(self, time: float, network: float, used: float) -> "Change":
        """The change with the scores of a step at `time`, seconds."""
        block = self
        if time - self.begun >= BLOCK:
            block = dataclasses.replace(self._closed(), begun=time)
        return dataclasses.replace(
            block,
            network=block.network + network,
            saved=block.saved + network - used,
        )

    def interval(self) -> tuple[float, float] | None:
        """The change, such as -0.12, and half of its 95 % interval; None with few blocks."""
        if self.blocks < ENOUGH:
            return None
        ratio = self.total_saved / self.total_network
        square = self.saved_saved - 2 * ratio * self.network_saved
        square += ratio**2 * self.network_network
        scale = self.blocks / (self.blocks - 1)
        error = math.sqrt(max(square * scale, 0.0)) / self.total_network
        return -ratio, TWO_SIDED * error

    def _closed(self) -> "Change":
        """The change with the block that is over among the others."""
        if self.network == 0:
            return self
        return Change(
            blocks=self.blocks + 1,
            total_network=self.total_network + self.network,
            total_saved=self.total_saved + self.saved,
            network_network=self.network_network + self.network**2,
            network_saved=self.network_saved + self.network * self.saved,
            saved_saved=self.saved_saved + self.saved**2,
        )
