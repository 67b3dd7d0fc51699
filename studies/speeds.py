"""How fast people walk in ETH/UCY's splits, which explains what a left-out scene is hard for.

python -m studies.speeds DATA
"""

import sys
from pathlib import Path

import numpy as np

from neurosym_jax.data.sources import open_source
from neurosym_jax.data.windows import cut_windows

FAST = 1.8
"""Metres a second."""

if __name__ == "__main__":
    source = open_source(Path(sys.argv[1]))
    print(f"{'scene':8}{'split':8}{'mean, m/s':>10}{'95 %':>8}{f'above {FAST}':>12}")
    for scene in source.scenes:
        for split in ("train", "val", "test"):
            windows = cut_windows(source.recordings(scene, split), 8, 12)
            steps = np.linalg.norm(np.diff(windows.position, axis=1), axis=-1)
            speed = steps.mean(axis=1) / windows.period
            fast = f"{100 * np.mean(speed > FAST):.1f} %"
            print(
                f"{scene:8}{split:8}{speed.mean():10.2f}{np.percentile(speed, 95):8.2f}{fast:>12}"
            )
