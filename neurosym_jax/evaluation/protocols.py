"""Protocols by which others evaluate: which windows, how long, and over what means are taken."""

import dataclasses
from typing import Literal

from neurosym_jax.errors import InputError

__all__ = ["PROTOCOLS", "Protocol", "ProtocolName"]

ProtocolName = Literal["sgan", "joint-metrics"]


@dataclasses.dataclass(frozen=True)
class Protocol:
    """What a protocol fixes."""

    min_agents: int
    """Scenes with fewer people are left out."""
    scenes_alike: bool
    """Whether means are over scenes, each weighing the same, and not over people."""
    obs_len: int | None = None
    pred_len: int | None = None
    """Steps, where it says how many."""

    def steps(self, name: str, asked: int | None) -> int | None:
        """`obs_len` or `pred_len`: what is asked for, else the protocol's.

        Raises:
            InputError: where the protocol says something else.
        """
        own = getattr(self, name)
        if None not in (own, asked) and own != asked:
            option = f"--{name.replace('_', '-')}"
            raise InputError(f"{option} {asked}: the protocol has {own} (--protocol sgan has any)")
        return asked if own is None else own


PROTOCOLS: dict[ProtocolName, Protocol] = {
    "sgan": Protocol(2, scenes_alike=False),
    "joint-metrics": Protocol(1, scenes_alike=True, obs_len=8, pred_len=12),
}
"""SGAN's (Gupta et al., CVPR 2018); and that of E. Weng, H. Hoshino, D. Ramanan and K. Kitani,
"Joint Metrics Matter", ICCV 2023."""
