"""Join tracks that occlusions broke."""

import dataclasses
import os
from pathlib import Path
from typing import ClassVar

import numpy as np

from neurosym_jax.commands._options import Positional, Reading, refuse_unused
from neurosym_jax.configuration import Positive, refuse
from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError
from neurosym_jax.runtime import files
from neurosym_robot.tracking.stitching import LinkOptions, stitch


@dataclasses.dataclass(frozen=True)
class Options:
    """Join the tracks of one person that occlusions broke; write rows `frame ped x y`."""

    needs_jax: ClassVar[bool] = False
    tracks: Positional[Path]
    """A recording of any format in docs/data.md."""
    out: Path
    """File to write; nothing is overwritten."""
    period: float = 0.1
    """Seconds between the frames of the file written, and of an input that numbers them: 0.1 for
    most people trackers, 0.4 for ETH/UCY."""
    fill: float = 2.0
    """Fill gaps of up to this many seconds."""
    links: LinkOptions = dataclasses.field(default_factory=LinkOptions)
    """When two tracks are joined."""
    read: Reading = AS_IT_SAYS
    """How the file is read."""


def run(options: Options) -> None:
    """Read, stitch and write; InputError names the file and the reason."""
    if os.path.exists(options.out):
        raise InputError(f"{options.out}: already there, and nothing is overwritten")
    refuse_unused(options.read, ["max_gap"], "here: --fill and --links.max-gap say it")
    files.refuse_unwritable(options.out)
    refuse(Positive, {"period": options.period}, optional=True)
    recordings = read_any(options.tracks, options.read, options.period)
    if len(recordings) != 1:
        raise InputError(
            f"{options.tracks}: holds {len(recordings)} recordings: one is stitched"
        )
    mended = stitch(
        recordings[0], options.links, period=options.period, fill=options.fill
    )
    write_text(options.out, mended.tracks, options.period)
    print(
        f"{mended.before} ids became {len(np.unique(mended.tracks.id))}: {mended.joined} joins"
    )
    print(
        f"{mended.ghosts} points dropped, of people who were seen for less than a second"
    )


def write_text(path: Path, tracks: Tracks, period: float) -> None:
    """Rows `frame ped x y`, frame by frame; `read_any`, with this `frame_period`, reads them."""
    frame = np.rint(tracks.stamp / period).astype(np.int64)
    ids = tracks.ids_as_given()
    rows = [
        f"{frame[n]}\t{ids[n]}\t{tracks.position[n, 0]:.6f}\t{tracks.position[n, 1]:.6f}\n"
        for n in np.lexsort((tracks.id, frame))
    ]
    files.write_text(path, "".join(rows))
