"""Columns of a user's table that say which rows belong together, and which are people."""

from collections.abc import Sequence, Set

import numpy as np

from neurosym_jax.data.tables import Table
from neurosym_jax.data.text import recording_name
from neurosym_jax.errors import InputError, printable

__all__ = ["keep_people", "recordings_of"]

RECORDINGS = (
    *("scene", "scene_id", "run", "run_id", "camera", "camera_id", "cam", "recording", "video"),
    *("recording_id", "video_id", "sequence", "seq", "session", "experiment"),
)
KINDS = (
    *("label", "class", "class_name", "type", "agent_type", "object_type", "agent_class", "kind"),
    *("category", "obj_type"),
)
PEOPLE = {
    *("person", "persons", "people", "human", "humans", "ped", "peds", "pedestrian"),
    *("pedestrians", "walker", "adult", "child", "visitor", "worker", "man", "woman"),
}


def recordings_of(table: Table, extras: Set[str]) -> tuple[list[str], np.ndarray]:
    """Names of the recordings in a table, and [R] the index of each row's.

    Columns in `extras` have another use.
    """
    name = recording_name(table.path)
    at = _places(table, RECORDINGS, extras)
    if not at:
        return [name], np.zeros(len(table.fields), int)
    columns = np.stack([table.column(place).fill_null("").to_numpy() for place in at], axis=1)
    keys = ["_".join(row) for row in columns.astype(str)]
    kinds, index = np.unique(keys, return_inverse=True)
    if len(kinds) == 1:
        return [name], index
    return [printable(f"{name}_{kind}"[:200]) for kind in kinds], index


def keep_people(
    table: Table, keep: Sequence[str], extras: Set[str]
) -> tuple[Table, int, tuple[str, ...]]:
    """The rows of people, how many others there are, and a line about these if there are any.

    Raises:
        InputError: where no kind of row is known to be people, or `keep` fits none.
    """
    at = _places(table, KINDS, extras)
    if not at:
        if keep:
            raise InputError(f"{table.path}: --keep: no column is one of {', '.join(KINDS)}")
        return table, 0, ()
    place = at[0]
    name, texts = table.names[place], table.column(place).fill_null("")
    kinds = texts.unique(maintain_order=True).to_list()
    wanted = {each.lower() for each in keep} or PEOPLE
    people = [kind for kind in kinds if kind.lower() in wanted]
    others = [kind for kind in kinds if kind not in people]
    shown = printable(", ".join(kind[:30] or "nothing" for kind in others[:6]))
    if not people:
        raise InputError(
            f"{table.path}: column {name[:30]!r} has {shown}: say which of them are people with "
            "--keep"
        )
    if not others:
        return table, 0, ()
    mask = texts.is_in(people).to_numpy()
    count = int((~mask).sum())
    line = f"{count} rows with {name[:30]} {shown} are left out (--keep says which are people)"
    return table.take(mask), count, (line,)


def _places(table: Table, usual: Sequence[str], extras: Set[str]) -> list[int]:
    """Columns with one of the usual names that serve nothing else."""
    return [
        at
        for at, name in enumerate(table.names)
        if name.strip().lower() in usual and name not in extras and str(at + 1) not in extras
    ]
