"""What words in the names of columns mean: roles and units, by `vocabulary.tsv`."""

import functools
import re
from collections.abc import Iterable, Sequence
from importlib.resources import files

__all__ = [
    "BOX",
    "CLOCKS",
    "DEGREES",
    "FLAGS",
    "POINT",
    "ROLES",
    "has_position",
    "names_in_comments",
    "names_tracks",
    "plain_name",
    "role_of",
    "vocabulary",
]

CLOCKS = ("time", "frame")
POINT = ("x", "y")
BOX = ("left", "top", "right", "bottom", "width", "height")
FLAGS = ("lost", "valid", "state", "confidence")  # rows that are no positions
ROLES = (*CLOCKS, "id", *POINT, *BOX, *FLAGS, "label", "vx", "vy")
DEGREES = "deg"  # unit of longitudes and latitudes
_UNIT = re.compile(r"^(.*?\w)\s*(?:[\[(](.+?)[\])]|[\s_/.-]([^\W_]+))$")


@functools.cache
def vocabulary() -> dict[str, frozenset[str]]:
    """The words of each role, and of units, `recording`, `people` and others."""
    path = files("neurosym_jax.data").joinpath("vocabulary.tsv")
    words = {}
    for line in path.read_text(encoding="utf-8").splitlines()[1:]:
        role, texts = line.split("\t")
        words[role] = frozenset(texts.split())
    return words


@functools.cache
def _meanings(kind: str) -> dict[str, str]:
    """The role of each word of a column's name, or where `kind` is "unit " its unit."""
    meanings = {}
    for role, words in vocabulary().items():
        is_role = role in (*ROLES, "z", "recording")
        if role.startswith(kind) and is_role == (not kind):
            meanings = dict.fromkeys(words, role.removeprefix(kind)) | meanings
    return meanings


def plain_name(name: str) -> tuple[str, str]:
    """A column's name in lower-case letters and digits, and its unit, else nothing."""
    name = name.strip().lower()[:60]
    unit = ""
    match = _UNIT.match(name)
    if match:
        unit = _meanings("unit ").get((match[2] or match[3]).strip(), "")
        name = match[1] if unit else name
    word = re.sub(r"[\W_]", "", name)
    return word, DEGREES if word in vocabulary()["globe"] else unit


def role_of(name: str) -> str:
    """The role that a column's name says, else nothing."""
    name = name.removeprefix("field.")  # Of `rostopic echo -p`.
    end = ".".join(name.split(".")[-2:])  # As `pose.position.x`.
    roles = _meanings("")
    return roles.get(plain_name(name)[0]) or roles.get(plain_name(end)[0], "")


def names_tracks(names: Sequence[str]) -> bool:
    """Whether a header names a clock, an id and positions."""
    roles = set(map(role_of, names))
    return "id" in roles and not roles.isdisjoint(CLOCKS) and has_position(roles)


def has_position(roles: Iterable[str]) -> bool:
    """Whether roles are those of points, or of boxes."""
    roles = set(roles)
    has_width = not roles.isdisjoint({"right", "width"})
    has_height = not roles.isdisjoint({"bottom", "height"})
    is_box = {"left", "top"} <= roles and has_width and has_height
    return roles.issuperset(POINT) or is_box


def names_in_comments(comments: Sequence[str], width: int) -> list[str]:
    """The names of `width` columns in the last comment that has them; none if none has."""
    for comment in reversed(comments):
        for mark in (None, ",", ";", "\t"):
            names = comment.split(mark)
            if len(names) == width and {"id", *POINT} <= set(map(role_of, names)):
                return [name.strip() for name in names]
    return []
