"""Summarise a recording, or every recording in a folder."""

import dataclasses
import warnings
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.data.formats import FORMATS, files_below, is_folder, read_any
from neurosym_jax.data.inspection import describe
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError, InputWarning, printable

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Summarise a recording, or every recording in a folder."""

    path: Annotated[Path, tyro.conf.Positional]
    """A file, or a folder, which is searched with its subfolders."""
    figure: Path | None = None
    """PNG file for a figure of all tracks."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""


def run(options: Options) -> int:
    """Print the summaries; return 2 if no file in a folder could be read.

    Raises:
        InputError: for a single file that cannot be read, or a folder without files.
    """
    folder = is_folder(options.path)
    paths = files_below(options.path) if folder else [options.path]
    recordings: list[Tracks] = []
    for path in paths:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputWarning)  # They stand in the recordings, too.
            try:
                found = read_any(path, options.read)
            except InputError as error:
                if not folder:
                    raise
                print(f"{printable(str(error))}\n")
                continue
        names = {tracks.reading.format for tracks in found if tracks.reading}
        kinds = ", ".join(FORMATS[name].title for name in names if name)
        print("\n".join([printable(f"{path}: {kinds}"), *map(describe, found), ""]))
        recordings += found
    if len(recordings) > 1:
        print(f"altogether {len(recordings)} recordings of {len(paths)} files")
    if options.figure and recordings:
        from neurosym_jax.plotting import save_figure
        from neurosym_jax.plotting.tracks import plot_tracks

        print(f"wrote {save_figure(plot_tracks(recordings), options.figure)}")
    return 0 if recordings else 2
