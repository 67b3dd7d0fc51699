"""The table of file formats, and reading with whichever format fits.

A format is recognised by how a file begins. A plugin adds a format with `register_format`.
"""

import dataclasses
import os
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeVar

from neurosym_jax.configuration import component_from_text
from neurosym_jax.data import built_in_formats as built_in
from neurosym_jax.data.evidence import judge
from neurosym_jax.data.reading import AS_IT_SAYS, Format, Reading, ReadOptions
from neurosym_jax.data.text import Head, read_head
from neurosym_jax.data.tracks import PERIOD, Tracks
from neurosym_jax.errors import InputError, InputWarning, printable
from neurosym_jax.plugins import load_entry_points
from neurosym_jax.registry import Registry

__all__ = [
    "FORMATS",
    "SUFFIXES",
    "data_files",
    "files_below",
    "format_of",
    "is_folder",
    "owner_of",
    "read_any",
    "recordings_in",
    "register_format",
    "sniff",
]

F = TypeVar("F", bound=Format)

SUFFIXES = (".txt", ".csv", ".tsv", ".json", ".ndjson", ".gz", ".parquet", ".arrow", ".feather")
"""Endings of the files that are taken from a folder."""


FORMATS: Registry[type[Format]] = Registry(
    "format",
    {
        "text": built_in.Text,
        "obsmat": built_in.Obsmat,
        "qtm": built_in.Qtm,
        "tracklets": built_in.Tracklets,
        "cliff": built_in.Cliff,
        "trajnet": built_in.Trajnet,
        "columns": built_in.Columns,
    },
)


def register_format(name: str, *, replace: bool = False) -> Callable[[type[F]], type[F]]:
    """Decorate a class of `Format`, which `read_any` then asks too.

    Raises:
        InputError: for an invalid name, or one that another format has.
    """
    return FORMATS.register(name, replace=replace)


def format_of(path: Path, options: ReadOptions = AS_IT_SAYS) -> Format:
    """The format of a file, as `options` or the file itself say.

    Raises:
        InputError: if the file cannot be read, or for an unknown format or option of it.
    """
    load_entry_points()
    if options.format is not None:
        return component_from_text(options.format, FORMATS, str(path))
    return FORMATS["columns" if options.columns else sniff(path)]()


def sniff(path: Path) -> str:
    """Name of the format of a file.

    Raises:
        InputError: if the file cannot be read, or several formats know it.
    """
    path = Path(path)
    return owner_of(path) or _known(path, read_head(path))


def owner_of(path: Path) -> str | None:
    """Name of the format that a path has by its name alone, or None."""
    load_entry_points()
    return next((name for name, form in FORMATS.items() if form().owns(path)), None)


def is_folder(path: Path) -> bool:
    """Whether a path is a folder of files, and not one that is a recording itself."""
    return os.path.isdir(path) and owner_of(path) is None  # Also for a name that is too long.


def _known(path: Path, head: Head) -> str:
    for general in (False, True):
        names = [
            name for name, form in FORMATS.items() if form.general == general and form().knows(head)
        ]
        if len(names) > 1 and not general:
            choices = " or ".join(f"--format {name}" for name in names)
            raise InputError(f"{path}: may be of several formats: say {choices}")
        if names:
            return names[-1]  # A plugin's general format comes last and goes first.
    raise InputError(f"{path}: of no known format: there are {', '.join(FORMATS)} (--format NAME)")


def read_any(
    path: Path, options: ReadOptions = AS_IT_SAYS, frame_period: float = PERIOD
) -> list[Tracks]:
    """The recordings in a file of any known format, on their own clocks.

    Args:
        path: of the file.
        options: what the file does not say; naming columns makes it a table.
        frame_period: seconds between frames, where they are numbered and neither the format nor
            `options` fix their rate: the most common step between frame numbers.

    Returns:
        Tracks with `reading`.

    Raises:
        InputError: naming file, row and reason; for an option that the format does not use, and
            for people who move as none do (see `evidence`), unless `options.yes_really`.

    Warns:
        InputWarning: of what looks wrong, which is in `reading` too.
    """
    path = Path(path)
    form = format_of(path, options)
    options.metres(path)
    for option in options.given():
        if option not in form.uses:
            shown = option.replace("_", "-")
            raise InputError(f"{path}: --{shown} is of no use for {form.title}, which fixes it")
    found = []
    for tracks in form.read(path, options, frame_period):
        how = tracks.reading or Reading(tracks.recording, printable(str(path)), rows=len(tracks.id))
        refused, doubted = judge(tracks, options)
        if refused and not options.yes_really:
            raise InputError(
                f"{path}: {refused[0]} (where it is true all the same, --yes-really accepts it)"
            )
        lines = (*how.warnings, *refused, *doubted)
        for line in lines:
            warnings.warn(f"{path}: {line}", InputWarning, stacklevel=2)
        how = dataclasses.replace(how, format=FORMATS.name_of(type(form)), warnings=lines)
        found.append(dataclasses.replace(tracks, reading=how))
    return found


def recordings_in(place: Path, options: ReadOptions = AS_IT_SAYS) -> list[Tracks]:
    """The recordings in a file of any known format or in a folder, on their own clocks.

    Raises:
        InputError: for files that cannot be read.
    """
    paths = data_files(place, options) if is_folder(place) else [place]
    return [tracks for path in paths for tracks in read_any(path, options)]


def data_files(folder: Path, options: ReadOptions = AS_IT_SAYS) -> list[Path]:
    """The recordings of a folder, by the endings `SUFFIXES`, in order of name; at least one.

    Raises:
        InputError: for a folder that is missing or has none.

    Warns:
        InputWarning: of a table that is left out because it has no columns of tracks.
    """
    try:
        paths = _recordings(folder, folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: no such file or folder ({error.strerror})") from None
    if options.columns or options.format:
        return paths
    others = [path for path in paths if owner_of(path) is None and _lacks_tracks(path)]
    for path in others:
        warnings.warn(f"{path}: left out: it has no columns of tracks", InputWarning, stacklevel=2)
    if len(others) == len(paths):
        raise InputError(f"{folder}: its tables have no columns of tracks; name them, or others")
    return [path for path in paths if path not in others]


def files_below(folder: Path) -> list[Path]:
    """Every file below `folder` that may be a recording, by its ending; at least one.

    Raises:
        InputError: if there is none.
    """
    return _recordings(folder, (path for path in folder.rglob("*") if not owner_of(path.parent)))


def _recordings(folder: Path, paths: Iterable[Path]) -> list[Path]:
    found = sorted(path for path in paths if path.suffix.lower() in SUFFIXES or owner_of(path))
    if not found:
        raise InputError(f"{folder}: no {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]} file in it")
    return found


def _lacks_tracks(path: Path) -> bool:
    head = read_head(path)
    return FORMATS[_known(path, head)]().lacks_tracks(head)
