"""The built-in formats: how each is recognised by the head of a file, and where its reader is."""

import numpy as np

from neurosym_jax.data.reading import Format
from neurosym_jax.data.rows import consecutive
from neurosym_jax.data.text import Head

__all__ = ["Cliff", "Columns", "Obsmat", "Qtm", "Text", "Tracklets", "Trajnet"]

_READERS = "neurosym_jax.data.readers"


class Text(Format):
    """Rows `frame ped x y`, as SGAN arranges ETH/UCY."""

    title = "rows of `frame ped x y`"
    uses = frozenset({"unit", "stride", "fps"})
    general = True
    reader = f"{_READERS}.eth_ucy:read_text"

    def knows(self, head: Head) -> bool:
        """Also binary files, which the reader refuses with the reason."""
        return not head.named


class Obsmat(Format):
    """ETH's own rows `frame id x z y vx vz vy`, of which z and vz are zero."""

    title = "ETH's obsmat (`frame id x z y vx vz vy`)"
    uses = frozenset({"stride", "fps"})
    reader = f"{_READERS}.eth_ucy:read_obsmat"

    def knows(self, head: Head) -> bool:
        """Eight numbers a row, of which z and vz are zero and the others agree."""
        if head.columns != 8 or head.rows[:, [3, 6]].any():
            return False
        return _mismatch(head.rows, head.rows[:, [2, 4]], head.rows[:, [5, 7]], True) < 0.5


class Qtm(Format):
    """Motion capture of THÖR and THÖR-MAGNI."""

    title = "QTM export (THÖR, THÖR-MAGNI)"
    reader = f"{_READERS}.qtm:read_qtm"

    def knows(self, head: Head) -> bool:
        """A header that begins with `Frame`."""
        return any(
            line.startswith(("Frame\t", "Frame,")) and ("Helmet" in line or " X" in line)
            for line in head.lines
        )


class Tracklets(Format):
    """Tracklets of THÖR-MAGNI."""

    title = "THÖR-MAGNI tracklets"
    reader = f"{_READERS}.thor:read_tracklets"

    def knows(self, head: Head) -> bool:
        """By five names of columns."""
        names = {name.strip() for name in head.first.split(",")}
        return {"Time", "x", "y", "tracklet_id", "ag_id"} <= names


class Cliff(Format):
    """Tracks that CLiFF-LHMP made of THÖR."""

    title = "CLiFF-LHMP tracks (`time,id,x,y,speed,heading`)"
    reader = f"{_READERS}.thor:read_cliff"

    def knows(self, head: Head) -> bool:
        """Six numbers a row, the last two speed and heading, and not a velocity's x and y."""
        if head.columns != 6:
            return False
        xy, speed, heading = head.rows[:, 2:4], head.rows[:, 4:5], head.rows[:, 5]
        if speed.min() < 0 or np.abs(heading).max() > np.pi + 1e-3:
            return False
        polar = speed * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        mismatch = _mismatch(head.rows, xy, polar)
        return mismatch < 0.4 and mismatch < 0.5 * _mismatch(head.rows, xy, head.rows[:, 4:])


class Trajnet(Format):
    """TrajNet++."""

    title = "TrajNet++"
    uses = frozenset({"stride"})
    reader = f"{_READERS}.trajnet:read_trajnet"

    def knows(self, head: Head) -> bool:
        """Also a first row that is cut short, which the reader reports."""
        return head.first.replace(" ", "").startswith(('{"track":{', '{"scene":{'))


class Columns(Format):
    """A user's own table."""

    title = "table with named columns"
    uses = frozenset({"columns", "keep", "unit", "time_unit", "fps", "stride"})
    general = True
    reader = f"{_READERS}.columns:read_columns"

    def knows(self, head: Head) -> bool:
        """Names of columns, JSON, Parquet or Arrow."""
        return head.named or head.columnary

    def lacks_tracks(self, head: Head) -> bool:
        """Whether the names in a header of CSV are not those of tracks."""
        from neurosym_jax.data.readers.columns import names_tracks

        header = head.named and "," in head.first and head.first[0] not in "{["
        return header and not names_tracks(head.first.split(","))


def _mismatch(
    rows: np.ndarray, position: np.ndarray, velocity: np.ndarray, numbered: bool = False
) -> float:
    """How much velocities differ from the moves between rows, as a share of these.

    A velocity may be that of the step to its row, from its row, or the mean of both.

    Args:
        rows: [R, columns], time and id first.
        position: [R, 2].
        velocity: [R, 2].
        numbered: whether times are frame numbers; their unit is then taken as it fits best.
    """
    before, after = consecutive(rows[:, 0], rows[:, 1])
    time = rows[after, 0] - rows[before, 0]
    near = (time > 0) & (time <= 5 * np.median(time) if len(time) else False)
    before, after, time = before[near], after[near], time[near, None]
    moved = (position[after] - position[before]) / time
    errors = [np.inf]
    for said in (velocity[before], velocity[after], (velocity[before] + velocity[after]) / 2):
        scale = np.vdot(moved, said) / max(float(np.vdot(said, said)), 1e-12) if numbered else 1.0
        if scale > 0:
            errors.append(np.abs(moved - scale * said).sum() / max(np.abs(moved).sum(), 1e-12))
    return float(min(errors))
