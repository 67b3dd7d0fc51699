"""Recordings beyond ETH/UCY, written as text files with steps of 0.4 s, to train on and to test on.

python -m studies.more_data OPENTRAJ OUT

OPENTRAJ is the public repository crowdbotp/OpenTraj. We read its Stanford drone scenes,
as the TrajNet challenge gives them (metres, every person for 20 steps), and HERMES's
corridors (Jülich 2009), where people walk from both ends, split by recording. OUT gets
a folder each for training, `tests`, and `kept_back`, which no choice was made on.
"""

import shutil
import sys
from pathlib import Path

import numpy as np

from neurosym_jax.data.tracks import PERIOD, Tracks, make_tracks, on_grid
from neurosym_jax.errors import InputError

STANFORD = Path("datasets/TrajNet/Train/stanford")
KEPT_BACK = ("bookstore_0", "bookstore_2", "deathCircle_0", "gates_1", "hyang_5")
"""Stanford recordings kept for a last judgement."""
STANFORD_TESTED = ("coupa_3", "hyang_6", "nexus_9")
"""Nothing of the place coupa is in training; of the other two, other recordings are."""

HERMES = Path("datasets/HERMES/Corridor-2D")
FRAMES, METRES = 16.0, 0.01
"""Frame rate of HERMES in 1/s, and its unit of length in metres."""
LEARNED = (
    *("bo-360-075-075", "bo-360-120-120", "boa-300-050-085", "boa-300-065-105"),
    *("boa-300-080-120", "bot-300-050-050", "bot-300-085-085", "bot-300-100-100"),
    *("bot-360-075-075", "bot-360-120-120"),
)
TESTED = ("bo-360-050-050", "bo-360-160-160", "bot-300-075-075", "bot-360-050-050")
"""Runs of HERMES. Others were validated on (boa-300-055-095, bot-360-090-090) or kept
for a last judgement (boa-300-050-070, bo-360-090-090, bot-300-065-065)."""


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


def read_corridor(path: Path) -> Tracks:
    """One run of HERMES, rows of `id frame x y z`, every 0.4 s.

    Raises:
        InputError: for a file that is missing.
    """
    if not path.is_file():
        raise InputError(
            f"{path}: missing; it is HERMES's, in datasets/HERMES of OpenTraj"
        )
    rows = np.loadtxt(path)
    stamp = rows[:, 1] / FRAMES
    tracks = make_tracks(path.stem, stamp, rows[:, 0], rows[:, 2:4] * METRES)
    return on_grid(tracks, PERIOD)


if __name__ == "__main__":
    write(Path(sys.argv[1]), Path(sys.argv[2]))
