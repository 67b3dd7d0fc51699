"""Layouts without a header: what each column is. Numbers alone say which file has one."""

import numpy as np

from neurosym_jax.data.evidence import roughness
from neurosym_jax.data.readers.columns import Layout
from neurosym_jax.data.reading import Head
from neurosym_jax.data.table import Table
from neurosym_jax.errors import InputError, option

__all__ = ["Cliff", "Mot", "MotResults", "Obsmat", "Stanford", "Text"]

SMOOTHER = (
    5  # times, by which another reading of the columns gives the lie to the usual one
)


class Text(Layout):
    """Rows `frame ped x y`, as SGAN arranges ETH/UCY, rounded to four decimals as there."""

    title = "rows of `frame ped x y`"
    uses = frozenset({"unit", "fps", "homography", "flip_y"})
    layout = ("frame", "id", "x", "y")
    decimals = 4

    def knows(self, head: Head) -> bool:
        """Anything, also binary files, which the reader refuses with the reason."""
        return True

    def check(self, table: Table) -> None:
        """Refuse tracks that are smoother with frame and ped exchanged.

        Raises:
            InputError: with the columns that fit.
        """
        table.whole_numbers(1)
        rows = np.column_stack([table.numbers(0, 1), table.numbers(2, 3, missing=True)])
        rows = rows[~np.isnan(rows).any(axis=1)]
        if not len(rows):
            return
        frame, ped, position = rows[:, 0], rows[:, 1], rows[:, 2:]
        usual, other = (
            roughness(*pair, position) for pair in ((frame, ped), (ped, frame))
        )
        if SMOOTHER * np.sum(other) < np.sum(usual):
            raise InputError(
                f"{table.path}: its tracks are smooth where the first column is the person, not "
                f"the frame: say {option('columns', ('id=1', 'frame=2', 'x=3', 'y=4'))}"
            )


class Obsmat(Layout):
    """ETH's own rows, of which z and vz are zero; 6 frames are 0.4 s in eth, 10 in hotel."""

    title = "ETH's obsmat (`frame id x z y vx vz vy`)"
    uses = frozenset({"fps", "flip_y"})
    layout = ("frame", "id", "x", "zero", "y", "vx", "zero2", "vy")
    decimals = 4


class Cliff(Layout):
    """Tracks that CLiFF-LHMP made of THÖR; each agent has a clock of its own.

    Source: Y. Zhu et al., "CLiFF-LHMP", IROS 2023.
    """

    title = "CLiFF-LHMP tracks (`time,id,x,y,speed,heading`)"
    uses = frozenset({"flip_y"})
    layout = ("time", "id", "x", "y", "speed", "heading")


class Stanford(Layout):
    """Annotations of the Stanford drone data set: boxes in pixels at 30 frames a second."""

    title = "Stanford's annotations (`id left top right bottom frame lost ... label`)"
    layout = (
        "id",
        "left",
        "top",
        "right",
        "bottom",
        "frame",
        "lost",
        "flag",
        "flag2",
        "label",
    )


class Mot(Layout):
    """Ground truth of MOTChallenge: boxes in pixels; class 1 are people who walk."""

    title = "MOTChallenge's ground truth (`frame,id,left,top,width,height,flag,class,visible`)"
    layout = (
        "frame",
        "id",
        "left",
        "top",
        "width",
        "height",
        "confidence",
        "label",
        "share",
    )
    people = ("1", "1.0")


class MotResults(Layout):
    """Results of trackers as MOTChallenge has them: boxes in pixels, and -1 at the end."""

    title = (
        "MOTChallenge's results (`frame,id,left,top,width,height,confidence,-1,-1,-1`)"
    )
    layout = (*Mot.layout[:7], "none", "none2", "none3")
