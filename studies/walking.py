"""How fast people walk in ETH/UCY, and how much their positions err.

python -m studies.walking DATA

A walk is smooth over five steps of 0.4 s, errors are not: of independent errors of
standard deviation s, fourth differences have the deviation sqrt(70) s. Printed is s by
their median.
"""

import sys
from pathlib import Path

import numpy as np

from neurosym_jax.data.recordings import SCENES, open_source
from neurosym_jax.data.windows import cut_windows

WALKING, FAST = 0.5, 1.8  # m/s

if __name__ == "__main__":
    source = open_source(Path(sys.argv[1]))
    print(f"{'scene':8}{'split':8}{'mean, m/s':>10}{'95 %':>8}{f'above {FAST}':>12}")
    for scene in source.scenes:
        for split in ("train", "val", "test"):
            windows = cut_windows(source.recordings(scene, split), 8, 12)
            steps = np.linalg.norm(np.diff(windows.position, axis=1), axis=-1)
            speed = steps.mean(axis=1) / windows.period
            spread = f"{speed.mean():10.2f}{np.percentile(speed, 95):8.2f}"
            print(f"{scene:8}{split:8}{spread}{100 * np.mean(speed > FAST):10.1f} %")
    for recording in (name for names in SCENES.values() for name in names):
        windows = cut_windows(source.files([recording]), 8, 12)
        speed = (
            np.linalg.norm(np.diff(windows.position, axis=1), axis=-1) / windows.period
        )
        walks = windows.position[speed.mean(axis=1) > WALKING]
        # 0.6745 is the median of a standard normal's size.
        error = np.median(np.abs(np.diff(walks, n=4, axis=1))) / 0.6745 / np.sqrt(70)
        print(f"{recording:15}{100 * error:6.1f} cm")
