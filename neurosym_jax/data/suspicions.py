"""Warnings of what looks wrong in a recording, from orders of magnitude; they change nothing."""

import numpy as np

from neurosym_jax.data.tracks import Tracks

__all__ = ["GAP", "steps_of", "suspicions"]

GAP = 1.5
"""A step of a person longer than this many median steps is a gap."""

FAST = 10.0
"""m/s: no person walks so fast, and hardly any runs."""

HURRY = 2.0
"""m/s: a crowd with a faster median has the wrong clock, as eth in SGAN's reading."""

STROLL = 0.6
"""m/s: hardly any moving person is slower."""

STANDING = 0.02
"""m/s: median speed of people who hardly move."""

FEW = 10
"""Fewer steps say nothing about the speeds in a recording."""

ROOM = 500.0
"""Metres: a longer area is more likely one in millimetres or pixels."""


def steps_of(tracks: Tracks) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and m/s of every step of every person, in the order of the tracks."""
    same = np.diff(tracks.id) == 0
    step = np.diff(tracks.stamp)[same]
    return step, np.linalg.norm(np.diff(tracks.position, axis=0)[same], axis=1) / step


def suspicions(tracks: Tracks, assumed: bool = False) -> tuple[str, ...]:
    """What looks wrong in a recording, a line each; `assumed`: no one gave the frame rate."""
    found = []
    step, speed = steps_of(tracks)
    usual = float(np.median(step)) if len(step) else np.nan
    plain = (step <= GAP * usual) & (len(step) >= FEW)
    median, high, top = (
        float(np.quantile(speed[plain], q)) if plain.any() else np.nan for q in (0.5, 0.95, 1)
    )
    size = float(np.ptp(tracks.position, axis=0).max())
    whole = bool(np.all(tracks.position == np.rint(tracks.position)))
    if median > FAST:
        unit = "millimetres" if median > 300 else "pixels or centimetres"
        found.append(f"the median speed is {median:.0f} m/s: the coordinates look like {unit}")
    elif top > FAST:
        fast = np.flatnonzero((speed > FAST) & plain)
        at = np.flatnonzero(np.diff(tracks.id) == 0)[fast[0]]
        found.append(
            f"{len(fast)} steps are faster than {FAST:g} m/s (the fastest {top:.1f}), the first by "
            f"person {tracks.id[at]} at {tracks.stamp[at]:.2f} s: is a person two, or the rate off?"
        )
    if HURRY < median <= FAST:
        found.append(
            f"the median speed is {median:.2f} m/s, and people walk at 1.3: is the time between "
            "frames longer than it is taken for? (SGAN's eth needs --eth-stride 6)"
        )
    if size > ROOM and not median > FAST:
        found.append(f"the area is {size:.0f} m long: are the coordinates millimetres?")
    if whole and len(tracks.position) > 20 and size > 20:
        found.append("all coordinates are whole numbers: they look like pixels or millimetres")
    if median < STANDING:
        found.append(
            "hardly anybody moves: the coordinates may be in kilometres, or the people sit"
        )
    elif assumed and high < STROLL:
        found.append(
            f"people walk at {median:.2f} m/s where consecutive frames are taken for {usual:g} s: "
            "are they a video's? (--fps says how many make a second)"
        )
    order = np.lexsort((tracks.position[:, 1], tracks.position[:, 0], tracks.stamp))
    stamp, place = tracks.stamp[order], tracks.position[order]
    twins = (np.diff(stamp) == 0) & (np.diff(place, axis=0) == 0).all(axis=1)
    if twins.any():
        found.append(
            f"{twins.sum()} points are duplicates: two people at one place at one time, the first "
            f"at {stamp[np.flatnonzero(twins)[0]]:.2f} s"
        )
    if usual > 1.0:
        found.append(
            f"points are {usual:.2f} s apart: longer gaps than 1 s are not filled (--time-unit "
            "says what a table's times count)"
        )
    return tuple(found)
