"""The numbers from which `neurosym_jax.data.evidence.BANDS` were made, and how others compare.

python -m studies.bands SHARED/data/eth_ucy/all SHARED/data/thor [OTHERS ...]

Prints pace, distance, turning and frozen of every recording, and their range. The bands: doubted
is what the range widened by 1.15 below, and by 1.2 above (without SGAN's eth, whose clock is
wrong), leaves out; refused, by 1.35 below and 2.2 above. Distance is halved, as people stand closer
in corridors, and turning and frozen are far beyond any recording.
"""

import sys
import warnings
from pathlib import Path

from neurosym_jax.data.evidence import BANDS, measure
from neurosym_jax.data.formats import recordings_in
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.errors import InputError


def main(places: list[str]) -> None:
    """Print a row for each recording in `places`, and the range of each number."""
    print("| recording | steps | " + " | ".join(BANDS) + " |\n" + "|---" * (len(BANDS) + 2) + "|")
    rows = []
    for place in places:
        try:
            recordings = recordings_in(Path(place), ReadOptions(yes_really=True))
        except InputError as error:
            print(f"| {place} | {error} |" + " |" * len(BANDS))
            continue
        for tracks in recordings:
            rows.append(measure(tracks))
            shown = [f"{rows[-1][name]:.2f}" if name in rows[-1] else "" for name in BANDS]
            print(f"| {tracks.recording} | {rows[-1]['steps']} | {' | '.join(shown)} |")
    for name in BANDS:
        values = [row[name] for row in rows if name in row]
        print(f"\n{name}: {min(values):.2f} to {max(values):.2f}; {BANDS[name][:2]}", end="")
    print()


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(sys.argv[1:])
