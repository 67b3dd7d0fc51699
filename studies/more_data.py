"""Recordings beyond ETH/UCY, written as text files with steps of 0.4 s, to train on and to test on.

python -m studies.more_data OPENTRAJ OUT

OPENTRAJ is the public repository crowdbotp/OpenTraj. We read its Stanford drone scenes,
as the TrajNet challenge gives them (metres, every person for 20 steps), and HERMES's
corridors, split as in `studies.weighting.data`. OUT gets a folder each for training,
`tests`, and `kept_back`, which no choice was made on.
"""

import shutil
import sys
from pathlib import Path

import numpy as np

from neurosym_jax.data.tracks import PERIOD
from studies.weighting.data import LEARNED, TESTED, read_corridor

STANFORD = Path("datasets/TrajNet/Train/stanford")
HERMES = Path("datasets/HERMES/Corridor-2D")
KEPT_BACK = ("bookstore_0", "bookstore_2", "deathCircle_0", "gates_1", "hyang_5")
"""Stanford recordings kept for a last judgement; HERMES's are in neither of its two lists."""
STANFORD_TESTED = ("coupa_3", "hyang_6", "nexus_9")
"""Nothing of the place coupa is in training; of the other two, other recordings are."""


def write(opentraj: Path, out: Path) -> None:
    """Write all files of both data sets.

    Raises:
        InputError: for a recording that is missing.
    """
    folders = [out / name for name in ("stanford", "hermes", "tests", "kept_back")]
    stanford, hermes, tests, kept_back = folders
    for folder in folders:
        folder.mkdir(parents=True, exist_ok=True)
    places = dict.fromkeys(STANFORD_TESTED, tests) | dict.fromkeys(KEPT_BACK, kept_back)
    for path in sorted((opentraj / STANFORD).glob("*.txt")):
        shutil.copy(path, places.get(path.stem, stanford))
    for names, folder in ((LEARNED, hermes), (TESTED, tests)):
        for name in names:
            tracks = read_corridor(opentraj / HERMES / f"{name}.txt")
            step = np.rint((tracks.stamp - tracks.stamp.min()) / PERIOD)
            rows = np.column_stack([step, tracks.id, tracks.position])
            np.savetxt(folder / f"{name}.txt", rows, fmt=("%d", "%d", "%.4f", "%.4f"))


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]))
