"""What is tested on, what the chain and the smoothing are learned from, and by which models.

ETH/UCY and THÖR are split as everywhere else. HERMES's corridors are split by recording, as in the
study of weightings: the two recordings that were validated on there choose the smoothing here.
"""

import dataclasses
from pathlib import Path
from typing import NamedTuple

from neurosym_jax.data.sources import Source, Split, open_source
from neurosym_jax.data.tracks import Tracks
from studies.weighting.data import LEARNED, TESTED, read_corridor

__all__ = ["CHOOSING", "TestSet", "sets_of"]

CHOOSING = ("boa-300-055-095", "bot-360-090-090")
"""Recordings of HERMES that serve as validation scenes."""
THOR = (
    "CLiFF-LHMP_thor1_exp-1-run-2",
    "CLiFF-LHMP_thor3_exp-3-run-2",
    "THOR-MAGNI_Scenario_5",
)


class TestSet(NamedTuple):
    """A scene of a source, and whose models forecast it."""

    source: Source
    scene: str
    models: str
    """The part of the models' names behind the kind: what they were not trained on."""


def sets_of(data: Path) -> dict[str, list[TestSet]]:
    """The groups of test sets in `data`, see the module above.

    Raises:
        InputError: for data that is missing.
    """
    eth_ucy, thor = open_source(data / "eth_ucy"), open_source(data / "thor")
    corridors = _Corridors(TESTED, folder=data / "hermes")
    return {
        "ETH/UCY": [TestSet(eth_ucy, scene, scene) for scene in ("eth", "zara1")],
        # No model that ships has seen a corridor or THÖR.
        "THÖR": [TestSet(thor, scene, "zara1") for scene in THOR],
        "HERMES": [TestSet(corridors, scene, "zara1") for scene in TESTED],
    }


@dataclasses.dataclass(frozen=True)
class _Corridors(Source):
    folder: Path = Path()

    def _read(self, scene: str, split: Split) -> list[Tracks]:
        runs = {"train": LEARNED, "val": CHOOSING, "test": (scene,)}[split]
        return [read_corridor(self.folder / f"{run}.txt") for run in runs]
