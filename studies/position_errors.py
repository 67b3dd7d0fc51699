"""How much the positions of ETH/UCY's recordings err, which a network that trusts them pays for.

python -m studies.position_errors DATA

A walk is smooth over five steps of 0.4 s, errors are not: of independent errors of standard
deviation s, fourth differences have the deviation sqrt(70) s. Printed is s by their median.
"""

import sys
from pathlib import Path

import numpy as np

from neurosym_jax.data.readers.eth_ucy import SCENES
from neurosym_jax.data.sources import open_source
from neurosym_jax.data.windows import cut_windows

WALKING = 0.5
"""Metres a second; who stands is left out."""

if __name__ == "__main__":
    source = open_source(Path(sys.argv[1]))
    for recording in (name for names in SCENES.values() for name in names):
        windows = cut_windows(source.files([recording]), 8, 12)
        speed = np.linalg.norm(np.diff(windows.position, axis=1), axis=-1) / windows.period
        walks = windows.position[speed.mean(axis=1) > WALKING]
        differences = np.abs(np.diff(walks, n=4, axis=1))
        # 0.6745 is the median of a standard normal's size.
        error = np.median(differences) / 0.6745 / np.sqrt(70)
        print(f"{recording:15}{100 * error:6.1f} cm")
