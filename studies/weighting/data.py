"""The data sets of the study: what is learned from, and what is tested on.

- `control_20`, `_10`, `_05`: simulated, see `control`.
- `corridors`: HERMES (Jülich 2009; `datasets/HERMES/Corridor-2D` of the public
  repository crowdbotp/OpenTraj): people in corridors from both ends, 16 frames a
  second, centimetres.
- `zara2`: ETH/UCY's, left out as everywhere else.

Corridors and zara2 are split by recording. Two runs of the corridors (boa-300-055-095
and bot-360-090-090) were validated on while the pooling was chosen, so they are neither
learned from nor tested on. boa-300-050-070, bo-360-090-090 and bot-300-065-065 are kept
for other judgements.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.data.recordings import open_source
from neurosym_jax.data.tracks import PERIOD, Tracks, make_tracks
from neurosym_jax.data.windows import Windows, cut_windows, on_grid
from neurosym_jax.errors import InputError
from studies.weighting.arms import CONTROLS
from studies.weighting.control import LENGTHS, control

__all__ = ["load"]

FRAMES, METRES = 16.0, 0.01
"""Frame rate of HERMES in 1/s, and its unit of length in metres."""

LEARNED = (
    *("bo-360-075-075", "bo-360-120-120", "boa-300-050-085", "boa-300-065-105"),
    *("boa-300-080-120", "bot-300-050-050", "bot-300-085-085", "bot-300-100-100"),
    *("bot-360-075-075", "bot-360-120-120"),
)
TESTED = ("bo-360-050-050", "bo-360-160-160", "bot-300-075-075", "bot-360-050-050")
SKIP = 3
"""Test windows start at every third step of the real recordings."""


def load(name: str, data: Path) -> tuple[Windows, Windows]:
    """What is learned from, and what is tested on, of one set.

    Args:
        name: of the set.
        data: holds HERMES's runs in `hermes`, ETH/UCY in `eth_ucy`.

    Raises:
        InputError: for a file that is missing.
    """
    if name in CONTROLS:
        return tuple(
            control(scenes, seed, CONTROLS[name])
            for scenes, seed in ((1500, 1), (200, 2))
        )
    if name.endswith("_tenth"):
        training, test = load(name.removesuffix("_tenth"), data)
        tenth = np.random.default_rng(0).permutation(training.scenes)[
            : training.scenes // 10
        ]
        return training.take(np.sort(tenth)), test
    if name == "corridors":
        training, test = (
            [read_corridor(data / "hermes" / f"{run}.txt") for run in runs]
            for runs in (LEARNED, TESTED)
        )
    else:
        source = open_source(data / "eth_ucy")
        training, test = source.recordings(name, "train"), source.recordings(name)
    return cut_windows(training, *LENGTHS), cut_windows(test, *LENGTHS, skip=SKIP)


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
    tracks = make_tracks(
        path.stem, rows[:, 1] / FRAMES, rows[:, 0], rows[:, 2:4] * METRES
    )
    return on_grid(tracks, PERIOD)
