"""Configurations in JSON: dataclasses to plain dictionaries and back.

A field that we do not know or a format that we cannot read is refused, so that a typo never trains
or evaluates a different model. What values a field can have is the dataclass's business (see
`checks`). A class can have `FORMER`, fields that earlier versions wrote, each with the value that
means what is done without it.
"""

import dataclasses
import json
import typing
from collections.abc import Sequence
from typing import Any, TypeVar, cast

from neurosym_jax.errors import InputError

__all__ = ["FORMAT", "changed", "from_json", "to_json"]

FORMAT = 1

Config = TypeVar("Config")


def to_json(config: Any) -> dict[str, Any]:
    """The plain dictionary form of a configuration, with its format version."""
    return {"format": FORMAT, **dataclasses.asdict(config)}


def from_json(cls: type[Config], data: dict[str, Any] | str, source: str = "config") -> Config:
    """Build `cls` from its JSON form (a dictionary or text).

    Raises:
        InputError: naming `source` and the field, for an unknown format, an unknown field, or a
            value that does not fit.
    """
    try:
        fields: Any = json.loads(data) if isinstance(data, str) else data
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not JSON ({error})") from None
    if not isinstance(fields, dict):
        raise InputError(f"{source}: not a JSON object")
    fields = dict(fields)
    version = fields.pop("format", None)
    if version != FORMAT:
        raise InputError(f"{source}: format {version!r} is not the format {FORMAT} of this version")
    for name, value in getattr(cls, "FORMER", {}).items():
        if fields.get(name) == value:
            del fields[name]
    known = {field.name for field in dataclasses.fields(cast(Any, cls))}
    hints = typing.get_type_hints(cls)
    for name, value in fields.items():
        if name not in known:
            raise InputError(f"{source}: unknown field {name!r} for {cls.__name__}")
        inner = [kind for kind in (hints[name], *typing.get_args(hints[name])) if _is_config(kind)]
        if inner and isinstance(value, dict):
            fields[name] = from_json(inner[0], {"format": FORMAT, **value}, f"{source}: {name}")
        elif isinstance(value, list):
            fields[name] = tuple(value)
    try:
        return cls(**fields)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def changed(config: Config, changes: Sequence[str], option: str, source: str) -> Config:
    """`config` with each NAME=VALUE of `changes`, a value as JSON or as text.

    Raises:
        InputError: naming `option` for what is not NAME=VALUE of a field, `source` for a value that
            does not fit.
    """
    fields = to_json(config)
    for change in changes:
        field, equals, value = change.partition("=")
        if not equals or field not in fields or field == "format":
            known = ", ".join(field for field in fields if field != "format")
            raise InputError(f"{option} {change}: must be NAME=VALUE, where NAME is one of {known}")
        try:
            fields[field] = json.loads(value)
        except json.JSONDecodeError:
            fields[field] = value
    return from_json(type(config), fields, source)


def _is_config(hint: Any) -> bool:
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)
