"""The bounds of `neurosym_jax.data.evidence`, and how many true recordings they refuse or doubt.

python -m studies.bands SHARED/data [OPENTRAJ/datasets]

Bounds of the pace: doubted is what the range of ETH/UCY and THÖR (without SGAN's eth,
whose clock is wrong) widened by 1.15 below and 1.2 above leaves out; refused, by 1.35
and 2.2. The bounds were not made from OpenTraj's recordings, https://github.com/crowdbotp/OpenTraj: what is
refused or doubted of them is a false alarm, or a recording of cyclists or with a fault,
and is named.
"""

import dataclasses
import itertools
import sys
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data import ReadOptions, Tracks, read_any
from neurosym_jax.data.evidence import DOUBTED, REFUSED, Doubt, judge, pace_of
from neurosym_jax.data.tables import GUARDS
from neurosym_jax.errors import InputError

FORMATS: dict[str, tuple[str, dict[str, Any]]] = {
    # folder: files, and how they are read
    "eth_ucy": ("all/*.txt", {}),
    "thor": ("*_*_*.csv", {}),
    "TrajNet": ("Train/stanford/*.txt", {}),
    "HERMES": (
        "Corridor-*/*-*-*.txt",
        {"columns": ("id=1", "frame=2", "x=3", "y=4"), "unit": "cm", "fps": 16},
    ),
    "CITR": ("data/trajectories_filtered/*/*_ped_filtered.csv", {"fps": 29.97}),
    "ETH": ("seq_*/obsmat.txt", {}),
    "UCY": ("zara*/obsmat.txt", {}),
}


def recordings_of(folder: Path) -> Iterator[tuple[ReadOptions, Tracks]]:
    """The recordings of a collection, and how they were read."""
    pattern, rules = FORMATS[folder.name]
    options = ReadOptions(**rules, allow=tuple(GUARDS))
    for path in sorted(folder.glob(pattern)):
        try:
            yield from ((options, tracks) for tracks in read_any(path, options))
        except InputError as error:
            print(f"not read: {error}", file=sys.stderr)


SCALES = {
    # mistake: the factor of lengths, from positions about their mean; the factor of
    # times
    "coordinates in 0..1": (lambda position: 1 / np.ptp(position, axis=0).max(), 1.0),
    "z-scores": (lambda position: 1 / position.std(), 1.0),
    "a map at a tenth": (lambda _: 0.1, 1.0),
    "a map at half": (lambda _: 0.5, 1.0),
    "a map at twice": (lambda _: 2.0, 1.0),
    "feet": (lambda _: 1 / 0.3048, 1.0),
    "every 4th frame, read as the 10th": (lambda _: 1.0, 2.5),
    "every 5th frame, read as the 10th": (lambda _: 1.0, 2.0),
    "every 8th frame, read as the 10th": (lambda _: 1.0, 1.25),
    "a map at a tenth, a clock 10 times too fast": (lambda _: 0.1, 0.1),
    "z-scores, a clock 3 times too fast": (lambda position: 1 / position.std(), 1 / 3),
}


def outcomes(tracks: Tracks) -> Iterator[str]:
    """What is said of a recording with each of the mistakes."""
    for length, time in SCALES.values():
        position = tracks.position - tracks.position.mean(axis=0)
        wrong = dataclasses.replace(
            tracks, position=position * length(position), stamp=tracks.stamp * time
        )
        judgements = [refused for _, refused, _ in judge(wrong)]
        yield "refused" if any(judgements) else "doubted" if judgements else "silent"


def main(places: list[str]) -> None:
    """Print what is said of each collection in `places`, and of all recordings with mistakes."""
    print("| collection | recordings | pace, m/s | refused | clock or unit doubted |")
    print("|---|---:|---|---|---|")
    everything = []
    for folder in (
        Path(place) / name for place, name in itertools.product(places, FORMATS)
    ):
        recordings = list(recordings_of(folder))
        if not recordings:
            continue
        everything += recordings
        paces = [pace_of(tracks)[1] for _, tracks in recordings]
        cells = [f"{np.nanmin(paces):.2f} to {np.nanmax(paces):.2f}"]
        for counts in (_refuses, _of_scale):
            names = [
                tracks.recording for _, tracks in recordings if counts(judge(tracks))
            ]
            cells.append(" ".join([str(len(names)), *names]))
        print(f"| {folder.name} | {len(recordings)} | {' | '.join(cells)} |")
    print(f"\npace: doubted outside {DOUBTED}, refused outside {REFUSED}\n")
    kinds = ("refused", "doubted", "silent")
    print(f"| mistake | {' | '.join(kinds)} |\n|---|---:|---:|---:|")
    for name, judgements in zip(
        SCALES, zip(*(outcomes(tracks) for _, tracks in everything))
    ):
        print(
            f"| {name} | {' | '.join(str(judgements.count(kind)) for kind in kinds)} |"
        )


def _refuses(doubts: Iterable[Doubt]) -> bool:
    return any(doubt.refuses for doubt in doubts)


def _of_scale(doubts: Iterable[Doubt]) -> bool:
    return any(doubt.guard in ("slow", "fast") for doubt in doubts)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(sys.argv[1:])
