"""The paces from which the bounds of `neurosym_jax.data.evidence` were made, and those of others.

python -m studies.bands SHARED/data/eth_ucy/all SHARED/data/thor [OTHERS ...]

Doubted is what the range widened by 1.15 below, and by 1.2 above (without SGAN's eth, whose clock
is wrong), leaves out; refused, by 1.35 below and 2.2 above.
"""

import sys
import warnings
from pathlib import Path

import numpy as np

from neurosym_jax.data.evidence import DOUBTED, REFUSED, pace_of
from neurosym_jax.data.formats import recordings_in
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.errors import InputError


def main(places: list[str]) -> None:
    """Print a row for each recording in `places`, and the range of their paces."""
    print("| recording | steps | pace |\n|---|---|---|")
    paces = []
    for place in places:
        try:
            recordings = recordings_in(Path(place), ReadOptions(yes_really=True))
        except InputError as error:
            print(f"| {place} | {error} | |")
            continue
        for tracks in recordings:
            steps, pace = pace_of(tracks)
            paces.append(pace)
            print(f"| {tracks.recording} | {steps} | {pace:.2f} |")
    print(
        f"\n{np.nanmin(paces):.2f} to {np.nanmax(paces):.2f}; doubted {DOUBTED}, refused {REFUSED}"
    )


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(sys.argv[1:])
