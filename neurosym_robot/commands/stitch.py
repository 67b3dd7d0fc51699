"""Join tracks that occlusions broke."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from neurosym_jax.data.formats import read_any
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError
from neurosym_jax.runtime import files
from neurosym_robot.tracking.linking import LinkOptions
from neurosym_robot.tracking.stitching import LOOKING_BACK, Stitched
from neurosym_robot.tracking.stitching import stitch as mend

__all__ = ["Options", "format_stitched", "read_ids", "run", "write_text"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Join the tracks of one person that occlusions broke; write rows `frame ped x y`."""

    tracks: Annotated[Path, tyro.conf.Positional]
    """A recording of any format in docs/data.md."""
    out: Path
    """File to write; nothing is overwritten."""
    period: float = 0.1
    """Seconds between numbered frames, in the input and in the file written: 0.1 for most people
    trackers, 0.4 for ETH/UCY."""
    fill: float = 2.0
    """Fill gaps of up to this many seconds."""
    ids: Path | None = None
    """JSON file {"old": new} of ids decided by hand."""
    polygon: Path | None = None
    """JSON file [[x, y], ...] of the map's corners; points outside are dropped."""
    report: bool = False
    """List the joined tracks."""
    links: LinkOptions = LOOKING_BACK
    """When two tracks are joined."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How the file is read."""


def run(options: Options) -> None:
    """Read, stitch and write; InputError names the file and the reason."""
    if options.out.exists():
        raise InputError(f"{options.out}: already there, and nothing is overwritten")
    files.refuse_unwritable(options.out)
    polygon = None
    if options.polygon is not None:
        try:
            polygon = np.asarray(_json(options.polygon), np.float64)
        except (TypeError, ValueError) as error:
            raise InputError(f"{options.polygon}: not a list of corners ({error})") from None
    if not 0 < options.period < float("inf"):
        raise InputError(f"period must be positive, not {options.period}")
    ids = None if options.ids is None else read_ids(options.ids)
    recordings = read_any(options.tracks, options.read, options.period)
    if len(recordings) != 1:
        raise InputError(f"{options.tracks}: holds {len(recordings)} recordings: one is stitched")
    mended = mend(recordings[0], options.links, fill=options.fill, polygon=polygon, ids=ids)
    write_text(options.out, mended.tracks, options.period)
    print(format_stitched(mended, joins=options.report))


def read_ids(path: Path) -> dict[int, int]:
    """The map of ids `{"old": new}`; InputError for a file with anything else."""
    data = _json(path)
    try:
        if not isinstance(data, dict):
            raise ValueError("not an object")
        return {int(old): int(new) for old, new in data.items()}
    except (TypeError, ValueError) as error:
        raise InputError(f'{path}: must be {{"old": new}} with whole numbers ({error})') from None


def write_text(path: Path, tracks: Tracks, period: float) -> None:
    """Rows `frame ped x y`, frame by frame, such that `read_text(path, period)` gives them back."""
    place = tracks.stamp / period
    # Points may lie between the usual steps: choose the unit of frame numbers that fits them all.
    fits = [np.abs(place * unit - np.rint(place * unit)).max() < 1e-3 for unit in range(1, 101)]
    unit = 1 + int(np.argmax(fits)) if any(fits) else 1000
    frame = np.rint(place * unit).astype(np.int64)
    rows = np.lexsort((tracks.id, frame))
    points = tracks.position.tolist()
    lines = [f"{frame[n]}\t{tracks.id[n]}\t{points[n][0]:.6f}\t{points[n][1]:.6f}\n" for n in rows]
    files.write_text(path, "".join(lines))


def format_stitched(mended: Stitched, joins: bool = False) -> str:
    """A summary, with a line for each join if `joins`."""
    lines = [
        f"{mended.before} ids became {len(np.unique(mended.tracks.id))}: {len(mended.joins)} joins",
        f"{mended.filled} points filled in, {mended.outside} outside the map dropped",
        f"{mended.ghosts} points of people seen for a moment only dropped",
    ]
    if joins:
        lines += [f"  {j.new} goes on as {j.old} after {j.gap:.1f} s" for j in mended.joins]
    return "\n".join(lines)


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as JSON ({error})") from None
