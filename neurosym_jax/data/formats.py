"""The table of file formats, and reading with the one that knows how a file begins."""

import dataclasses
import os
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from neurosym_jax.configuration import component
from neurosym_jax.data.evidence import judge
from neurosym_jax.data.readers import columns, layouts, storage, thor, trajnet
from neurosym_jax.data.readers.storage import FRAME, is_frame, table_of
from neurosym_jax.data.reading import AS_IT_SAYS, Format, ReadOptions, read_head
from neurosym_jax.data.schema import names_in_comments, names_tracks
from neurosym_jax.data.tracks import PERIOD, Reading, Tracks
from neurosym_jax.errors import InputError, InputWarning, brief, option, printable
from neurosym_jax.plugins import Registry, load_entry_points

__all__ = ["FORMATS", "data_files", "files_in", "format_of", "is_folder", "read_any"]
__all__ += ["recordings_in", "refuse_useless", "register_format"]

# Endings of the files that are taken from a folder.
SUFFIXES = (".txt", ".csv", ".tsv", ".ndjson", ".json", ".gz", ".parquet", ".feather")
SUFFIXES += (".arrow", ".sqlite", ".db", ".h5", ".hdf5")

FORMATS: Registry[type[Format]] = Registry(
    "format",
    {
        "text": layouts.Text,
        "columns": columns.Columns,
        "obsmat": layouts.Obsmat,
        "stanford": layouts.Stanford,
        "mot": layouts.Mot,
        "mot_results": layouts.MotResults,
        "qtm": thor.Qtm,
        "tracklets": thor.Tracklets,
        "cliff": layouts.Cliff,
        "storage": storage.Storage,
        "json": storage.Json,
        "trajnet": trajnet.Trajnet,
    },
)
"""The last is asked first whether it knows a file, and `text` knows what nobody else does."""

register_format = FORMATS.register
"""Decorate a class of `Format` with its name."""


def format_of(path: Path, options: ReadOptions = AS_IT_SAYS) -> Format:
    """The format of a file, as `options` or the file itself say."""
    if options.format is not None:
        load_entry_points()
        return component(options.format, FORMATS, str(path))
    if owner := _owner(path):
        return owner
    head = read_head(path)
    if options.columns:
        forms = (storage.Storage(), storage.Json())
        return next((form for form in forms if form.knows(head)), columns.Columns())
    return next(
        form for kind in reversed(FORMATS.values()) if (form := kind()).knows(head)
    )


def is_folder(path: Path) -> bool:
    """Whether a path is a folder of files, and not one that is a recording itself."""
    return os.path.isdir(path) and not _owner(
        path
    )  # os's also for a name that is too long.


def _owner(path: Path) -> Format | None:
    """The format that a path is of by its name."""
    load_entry_points()
    return next(
        (form for kind in reversed(FORMATS.values()) if (form := kind()).owns(path)),
        None,
    )


def read_any(
    data: Any, options: ReadOptions = AS_IT_SAYS, frame_period: float = PERIOD
) -> list[Tracks]:
    """The recordings in a file or dataframe, on their own clocks; each has a `reading`.

    `data` is the path of a file of any known format, or a table of pandas, polars,
    pyarrow, GeoPandas, PedPy or MovingPandas, which is read as a table with named
    columns. The most common step of frame numbers is `frame_period` seconds where
    nothing else is said.

    Raises: InputError: naming file, row and reason; for an option that the format does
        not use, and
            for people who move as none do (see `evidence`), unless `options.allow`
            names the guard.

    Warns:
        InputWarning: of what looks wrong, which is in `reading` too.
    """
    path = FRAME if is_frame(data) else Path(data)
    form = columns.Columns() if is_frame(data) else format_of(path, options)
    if is_frame(data) and options.format not in (None, "columns"):
        raise InputError(
            f"{path}: it is a {form.title}, not {option('format', options.format)}"
        )
    refuse_useless(path, form, options)
    if isinstance(form, columns.Columns) and is_frame(data):
        recordings = form.take(table_of(data), options, frame_period)
    else:
        recordings = form.read(path, options, frame_period)
    judged = []
    for tracks in recordings:
        reading = tracks.reading or Reading(
            tracks.recording, printable(str(path)), rows=len(tracks.id)
        )
        lines = reading.warnings
        for name, value in (("unit", options.unit_of), ("fps", options.fps_of)):
            if (text := getattr(options, name)) and value(path.stem) is None:
                lines = (
                    *lines,
                    f"{option(name, text)} does not name {printable(path.stem)}",
                )
        for guard, refused, line in judge(tracks, options):
            if refused and guard not in options.allow:
                waive = option("allow", (guard,))
                raise InputError(
                    f"{path}: {line} (where it is true all the same: {waive})"
                )
            lines = (*lines, f"allowed {guard}: {line}" if refused else line)
        for line in lines:
            warnings.warn(f"{path}: {line}", InputWarning, stacklevel=2)
        file, name = None if is_frame(data) else reading.file, FORMATS.name_of(form)
        reading = dataclasses.replace(reading, file=file, format=name, warnings=lines)
        judged.append(dataclasses.replace(tracks, reading=reading))
    return judged


def refuse_useless(path: Path, form: Format, options: ReadOptions) -> None:
    """Refuse options of reading that a format does not use.

    Raises:
        InputError: naming the first.
    """
    for name in columns.Columns.uses - form.uses:
        if getattr(options, name):
            raise InputError(
                f"{path}: {option(name)} is of no use for {form.title}, which fixes it"
            )


def recordings_in(data: Any, options: ReadOptions = AS_IT_SAYS) -> list[Tracks]:
    """The recordings in a file, folder, dataframe (see `read_any`), tracks, or several of these.

    Raises:
        InputError: as `read_any`, and for what is none of these.
    """
    if isinstance(data, Tracks):
        return [data]
    if is_frame(data):
        return read_any(data, options)
    if isinstance(data, str | Path):
        path = Path(data)
        data = data_files(path, options) if is_folder(path) else [path]
        return [tracks for path in data for tracks in read_any(path, options)]
    if not isinstance(data, Iterable):
        raise InputError(
            f"{brief(data)}: is no recording: give a file, table or `make_tracks`"
        )
    return [tracks for item in data for tracks in recordings_in(item, options)]


def data_files(folder: Path, options: ReadOptions = AS_IT_SAYS) -> list[Path]:
    """The recordings of a folder, in order of name; warn of tables without columns of tracks.

    Raises:
        InputError: for a folder that is missing or has none.
    """
    paths = files_in(folder)
    if options.columns or options.format:
        return paths
    tables = [path for path in paths if isinstance(format_of(path), columns.Columns)]
    others = [path for path in tables if not _names_tracks(path)]
    for path in others:
        warnings.warn(
            f"{path}: left out: it has no columns of tracks", InputWarning, stacklevel=2
        )
    if len(paths) == len(others):
        raise InputError(
            f"{folder}: its tables have no columns of tracks; name them, or others"
        )
    return [path for path in paths if path not in others]


def _names_tracks(path: Path) -> bool:
    """Whether a header or a comment names columns of tracks."""
    head = read_head(path)
    return names_tracks(
        head.names or names_in_comments(head.comments, len(head.fields[0]))
    )


def files_in(folder: Path, pattern: str = "*") -> list[Path]:
    """Every file of `folder` that may be a recording, by its ending (`SUFFIXES`); at least one.

    Raises:
        InputError: if there is none.
    """
    paths = [
        path
        for path in sorted(folder.glob(pattern))
        if (path.suffix.lower() in SUFFIXES or _owner(path)) and not _owner(path.parent)
    ]
    if not paths:
        raise InputError(
            f"{folder}: no such folder, or no {', '.join(SUFFIXES)} file in it"
        )
    return paths
