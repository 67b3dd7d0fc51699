"""The table of formats of files, with the built-in ones; a plugin adds to it.

A format says of a file's beginning whether it knows it, and which options of `ReadOptions` it uses.
"""

import dataclasses
import os
import warnings
from pathlib import Path

from neurosym_jax.data.format import Format
from neurosym_jax.data.provenance import Reading
from neurosym_jax.data.readers import columns, eth_ucy, qtm, thor, trajnet
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.suspicions import suspicions
from neurosym_jax.data.text import Head, read_head
from neurosym_jax.data.tracks import PERIOD, Tracks
from neurosym_jax.errors import InputError, InputWarning, printable
from neurosym_jax.plugins import load_entry_points
from neurosym_jax.registry import Registry

__all__ = [
    "FORMATS",
    "SUFFIXES",
    "Format",
    "data_files",
    "is_folder",
    "owner_of",
    "read_any",
    "register_format",
    "sniff",
]

SUFFIXES = (".txt", ".csv", ".tsv", ".json", ".ndjson")
"""Endings of the files that are looked at in a folder."""


FORMATS: Registry[Format] = Registry(
    "format",
    {
        **columns.FORMATS,
        **eth_ucy.FORMATS,
        **qtm.FORMATS,
        **thor.FORMATS,
        **trajnet.FORMATS,
    },
)
"""By name."""


def known_formats() -> Registry[Format]:
    """`FORMATS`, with those of installed packages."""
    load_entry_points()
    return FORMATS


def register_format(name: str, form: Format, *, replace: bool = False) -> None:
    """Add a format, which is asked from then on whether it knows a file.

    Raises:
        InputError: for what is no name, or one that another format has.
    """
    FORMATS.register(name, form, replace=replace)


def sniff(path: Path) -> str:
    """The format of a file, a key of `FORMATS`.

    Raises:
        InputError: if it cannot be read, or several formats know it.
    """
    path = Path(path)
    return owner_of(path) or _known(path, read_head(path))


def owner_of(path: Path) -> str | None:
    """The format that a path is of by its name alone, or None."""
    return next((name for name, form in known_formats().items() if form.owns(path)), None)


def is_folder(path: Path) -> bool:
    """Whether a path is a folder of files, and not one that is a recording itself."""
    return os.path.isdir(path) and owner_of(path) is None  # Also for a name that is too long.


def _known(path: Path, head: Head) -> str:
    for general in (False, True):
        names = [
            name for name, form in FORMATS.items() if form.general == general and form.knows(head)
        ]
        if len(names) > 1 and not general:
            choices = " or ".join(f"--format {name}" for name in names)
            raise InputError(f"{path}: may be of several formats: say {choices}")
        if names:
            return names[-1]  # A general format of a plugin's comes last, and goes before ours.
    raise InputError(f"{path}: of no known format: there are {', '.join(FORMATS)} (--format NAME)")


def read_any(
    path: Path, options: ReadOptions = AS_IT_SAYS, frame_period: float = PERIOD
) -> list[Tracks]:
    """The recordings in a file of any known format, on their own clocks.

    Args:
        path: of the file.
        options: what the file does not say; it is a table if columns are named.
        frame_period: seconds of the most common step between frames, or of the stride given, where
            frames are numbered and the format does not fix their rate.

    Returns:
        Tracks that say in `reading` how they were read.

    Raises:
        InputError: naming file, row and reason; for an option that the format has no use for.

    Warns:
        InputWarning: of what looks wrong; it stands in `reading` as well.
    """
    path = Path(path)
    name = options.format or ("columns" if options.columns else sniff(path))
    form = known_formats()[name]
    options.metres(path)
    for option in options.given():
        if option not in form.uses:
            shown = option.replace("_", "-")
            raise InputError(f"{path}: --{shown} is of no use for {form.text}, which fixes it")
    found = []
    for tracks in form.read(path, options, frame_period):
        how = tracks.reading or Reading(tracks.recording, printable(str(path)), rows=len(tracks.id))
        lines = (*how.warnings, *suspicions(tracks, how.frame_step is not None))
        for line in lines:
            warnings.warn(f"{path}: {line}", InputWarning, stacklevel=2)
        how = dataclasses.replace(how, format=name, warnings=lines)
        found.append(dataclasses.replace(tracks, reading=how))
    return found


def data_files(folder: Path, options: ReadOptions = AS_IT_SAYS) -> list[Path]:
    """The recordings of a folder, by the endings `SUFFIXES`, in order of name; at least one.

    Raises:
        InputError: for a folder that is not there or has none.

    Warns:
        InputWarning: of a table that is left out, because it has no columns of tracks.
    """
    try:
        paths = sorted(
            path
            for path in folder.iterdir()
            if path.suffix.lower() in SUFFIXES or owner_of(path) is not None
        )
    except OSError as error:
        raise InputError(f"{folder}: no such file or folder ({error.strerror})") from None
    if not paths:
        raise InputError(f"{folder}: no {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]} file in it")
    if options.columns or options.format:
        return paths
    others = [path for path in paths if _is_of_something_else(path)]
    for path in others:
        warnings.warn(f"{path}: left out: it has no columns of tracks", InputWarning, stacklevel=2)
    if len(others) == len(paths):
        raise InputError(f"{folder}: its tables have no columns of tracks; name them, or others")
    return [path for path in paths if path not in others]


def _is_of_something_else(path: Path) -> bool:
    if owner_of(path) is not None:
        return False
    head = read_head(path)
    return FORMATS[_known(path, head)].other(head)
