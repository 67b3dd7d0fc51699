"""What interpolation between clocks would give away of the future, in the errors of a recording.

python -m studies.look_ahead THOR/CLiFF-LHMP_thor1_exp-1-run-2.csv
"""

import dataclasses
import sys
from pathlib import Path

import numpy as np

from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tracks import SNAP
from neurosym_jax.data.windows import cut_windows, make_batches, on_grid
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.models.baselines import ConstantVelocity


def look_ahead(path: Path) -> None:
    """Print how much of a recording is interpolated, and constant velocity's error both ways."""
    recordings = [on_grid(tracks) for tracks in read_any(path)]
    depends = [
        tracks.stamp if tracks.known is None else tracks.known for tracks in recordings
    ]
    late = [known > tracks.stamp + SNAP for known, tracks in zip(depends, recordings)]
    print(
        f"{100 * np.concatenate(late).mean():.0f} % of the points lie between two observations"
    )
    careless = [
        dataclasses.replace(tracks, known=None, foreseen=None) for tracks in recordings
    ]
    for name, tracks in {"interpolated": careless, "as observed": recordings}.items():
        batches = make_batches(cut_windows(tracks, 8, 8))
        result = score_forecaster(
            ConstantVelocity(Lengths()), (), batches, samples=1, seed=0
        )
        print(f"{name}: joint ADE {result.mean('joint_ade'):.3f} m, 8 + 8 steps")


if __name__ == "__main__":
    look_ahead(Path(sys.argv[1]))
