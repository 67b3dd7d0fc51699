"""Configurations: frozen dataclasses whose values are checked, and their forms in JSON and text.

A configuration inherits from `Checked`; its annotations say what its values can be,
with ranges (`Count`, `Positive`, ...). A field annotated `Annotated[Base, TABLE]`,
where TABLE is a `Registry` of classes, holds a component, an instance of one of them:
in JSON `{"kind": NAME, **options}`, in text `NAME[,OPTION=VALUE...]`.
"""

import collections
import dataclasses
import functools
import json
import math
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar

from neurosym_jax.errors import InputError, brief
from neurosym_jax.plugins import Registry

__all__ = [
    "AtLeastOne",
    "BelowOne",
    "Checked",
    "Count",
    "Interval",
    "NotNegative",
    "Positive",
]
__all__ += [
    "Rule",
    "Seed",
    "Share",
    "Size",
    "Whole",
    "changed",
    "component",
    "differences",
]
__all__ += ["from_json", "parse_json", "refuse", "to_json"]

Config = TypeVar("Config")


class Rule(typing.NamedTuple):
    """A condition on the values of an annotated type; in words, such as `be positive`."""

    words: str
    holds: Callable[[Any], bool]


Count = Annotated[int, Rule("be at least 1", lambda value: value >= 1)]
Seed = Annotated[int, Rule("lie in [0, 2**32)", lambda value: 0 <= value < 2**32)]
Size = Annotated[int, Rule("lie in [1, 65536]", lambda value: 1 <= value <= 65536)]
"""Of an array's axis: what a file asks for is not made before it is known to be so small."""
Whole = Annotated[int, Rule("be at least 0", lambda value: value >= 0)]
AtLeastOne = Annotated[float, Rule("be at least 1", lambda value: value >= 1)]
NotNegative = Annotated[float, Rule("be at least 0", lambda value: value >= 0)]
Positive = Annotated[float, Rule("be positive", lambda value: value > 0)]
Share = Annotated[float, Rule("lie in [0, 1]", lambda value: 0 <= value <= 1)]
BelowOne = Annotated[float, Rule("lie in [0, 1)", lambda value: 0 <= value < 1)]
Interval = Annotated[
    tuple[float, float], Rule("be low, high", lambda value: value[0] <= value[1])
]

_WORDS: dict[Any, str] = {
    bool: "be true or false",
    int: "be a whole number",
    float: "be a finite number",
    str: "be text",
    dict: "be an object",
    type(None): "be null",
}


@dataclasses.dataclass(frozen=True)
class Checked:
    """A dataclass whose values must fit its annotations.

    Values may be as in JSON (lists, dictionaries), and components their text.
    """

    def __post_init__(self):
        """Check every field; a subclass with further conditions calls this first.

        Raises:
            InputError: naming the first field that does not fit.
        """
        for name, hint in _hints(type(self)).items():
            value = _built(getattr(self, name), hint, name)
            object.__setattr__(self, name, value)
            demand = _misfit(value, hint)
            if demand:
                raise InputError(f"{name} must {demand}, not {brief(value)}")


def refuse(hint: Any, values: Mapping[str, Any], optional: bool = False) -> None:
    """Refuse values that do not fit an annotation, such as `Count`; if `optional`, None is not one.

    Raises:
        InputError: naming the first, by its key.
    """
    for name, value in values.items():
        plain = _plain(value)
        if optional and plain is None:
            continue
        demand = _misfit(plain, hint)
        if demand:
            raise InputError(f"{name} must {demand}, not {brief(plain)}")


def _plain(value: Any) -> Any:
    """The number of an array of one; anything else as it is, such as a random key."""
    try:
        return value.item()
    # The last is torch's of several numbers, and JAX's of a key.
    except (AttributeError, TypeError, ValueError, RuntimeError):
        return value


def to_json(config: Any, table: Registry[Any] | None = None) -> dict[str, Any]:
    """The plain dictionary form of a configuration, or of a component of `table`."""
    fields: dict[str, Any] = {} if table is None else {"kind": table.name_of(config)}
    for name, hint in _hints(type(config)).items():
        value = getattr(config, name)
        fields[name] = (
            to_json(value, _table(hint)) if dataclasses.is_dataclass(value) else value
        )
    return fields


def from_json(
    cls: type[Config], data: Mapping[str, Any] | str, source: str = "config"
) -> Config:
    """Build `cls` from its JSON form (a dictionary or text).

    Raises:
        InputError: naming `source`, for an unknown field or a value that does not fit.
    """
    fields: Any = parse_json(data, source) if isinstance(data, str) else data
    if not isinstance(fields, Mapping):
        raise InputError(f"{source}: not a JSON object")
    unknown = [name for name in fields if name not in _hints(cls)]
    if unknown:
        known = ", ".join(_hints(cls)) or "none"
        raise InputError(
            f"{source}: unknown field {brief(unknown[0])} for {cls.__name__}: there are {known}"
        )
    entries = dataclasses.fields(cls)  # pyright: ignore[reportArgumentType]
    needed = {entry.name for entry in entries if entry.default is dataclasses.MISSING}
    missing = needed - set(fields)
    if missing:
        raise InputError(f"{source}: the field {min(missing)!r} is missing")
    try:
        return cls(**fields)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def parse_json(text: str | bytes, source: str) -> Any:
    """The value of JSON text.

    Raises:
        InputError: naming `source`, for other text and for an object with the same key
            twice.
    """

    def fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(pairs)
        if len(content) < len(pairs):
            (name, _), *_ = collections.Counter(name for name, _ in pairs).most_common(
                1
            )
            raise InputError(f"{source}: the key {brief(name)} stands twice")
        return content

    try:
        return json.loads(text, object_pairs_hook=fields)
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source}: not JSON ({error})") from None


def changed(config: Config, changes: Sequence[str], option: str, source: str) -> Config:
    """`config` with each NAME=VALUE of `changes`, a value as JSON or as text.

    `pooling=social,grid_size=16` replaces a component, `pooling.grid_size=16` changes
    an option of it. Changes are made in order, and checked together.

    Raises:
        InputError: naming `option` for an unknown NAME, `source` for a value that does
            not fit.
    """
    fields = to_json(config)
    changed_before = set[str]()
    for change in changes:
        path, equals, text = change.partition("=")
        if path in changed_before:
            raise InputError(f"{option} {change}: {path} is given twice")
        changed_before.add(path)
        outer, dot, key = path.rpartition(".")
        node: Any = fields.get(outer) if dot else fields
        kind = key == "kind" and _table(_hints(type(config)).get(outer)) is not None
        if not equals or not isinstance(node, dict) or key not in node or kind:
            names = [*fields]
            if outer and isinstance(node, dict):
                names += [f"{outer}.{name}" for name in node]
            raise InputError(
                f"{option} {change}: must be NAME=VALUE, where NAME is one of "
                f"{', '.join(names)}"
            )
        value = _value(text)
        table = None if outer else _table(_hints(type(config))[key])
        if table is not None and isinstance(value, str):
            value = to_json(component(value, table, source), table)
        node[key] = value
    return from_json(type(config), fields, source)


def component(form: str | Mapping[str, Any], table: Registry[Any], source: str) -> Any:
    """The component of a text `NAME[,FIELD=VALUE...]`, or of its form in JSON.

    Raises:
        InputError: naming `source`, for an unknown name or field, or a value that does
            not fit.
    """
    if isinstance(form, str):
        kind, *changes = form.split(",")
        pairs = (change.partition("=") for change in changes)
        fields = {name: _value(text) for name, _, text in pairs}
    else:
        kind = form.get("kind")
        fields = {name: form[name] for name in form if name != "kind"}
    try:
        cls = table[str(kind)]
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
    return from_json(cls, fields, source)


def differences(config: Any) -> list[str]:
    """NAME=VALUE of each field that differs from its default; the inverse of `changed`."""
    changes = []
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        table = _table(_hints(type(config))[field.name])
        if value == field.default:
            continue
        if table is not None and value is not None:
            value = ",".join([table.name_of(value), *differences(value)])
        text = value if isinstance(value, str) else json.dumps(value)
        changes.append(f"{field.name}={text}")
    return changes


def _built(value: Any, hint: Any, source: str) -> Any:
    """A field's value from its form in JSON, or from a component's text."""
    if isinstance(value, list):
        return tuple(value)
    table = _table(hint)
    if table is not None and isinstance(value, str | dict):
        return component(value, table, source)
    if isinstance(hint, type) and issubclass(hint, Checked) and isinstance(value, dict):
        return from_json(hint, value, source)
    return value


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _table(hint: Any) -> Registry[Any] | None:
    notes = getattr(hint, "__metadata__", ())
    return next((note for note in notes if isinstance(note, Registry)), None)


@functools.cache
def _hints(config: type) -> dict[str, Any]:
    hints = typing.get_type_hints(config, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(config)}


def _misfit(value: Any, hint: Any) -> str:
    """What `value` would have to do to fit `hint`, in words; empty if it fits."""
    origin = typing.get_origin(hint)
    inner = typing.get_args(hint)
    if origin is Annotated:
        kind, *rules = inner
        demand = _misfit(value, kind)
        for rule in rules:
            if not demand and isinstance(rule, Rule) and not rule.holds(value):
                demand = rule.words
        return demand
    if origin is Literal:
        if value in inner:
            return ""
        return f"be one of {', '.join(map(str, inner))}"
    if origin in (typing.Union, types.UnionType):
        demands = [_misfit(value, kind) for kind in inner]
        return " or ".join(demands) if all(demands) else ""
    if origin is tuple and inner[-1] is Ellipsis:
        if not isinstance(value, tuple):
            return "be a list"
        demands = [_misfit(part, inner[0]) for part in value]
        return next(filter(None, demands), "")
    if origin is tuple:
        fits = isinstance(value, tuple) and len(value) == len(inner)
        fits = fits and not any(map(_misfit, value, inner))
        return "" if fits else f"be {len(inner)} finite numbers"
    if origin is dict:
        fits = isinstance(value, dict)
        fits = fits and not any(_misfit(part, inner[1]) for part in value.values())
        if fits:
            return ""
        return f"be an object, each value of which must {_WORDS[inner[1]]}"
    if hint in (int, float):
        number = isinstance(value, int | hint) and not isinstance(value, bool)
        # An integer of more bits has no float, and is no index.
        small = isinstance(value, float) or (number and value.bit_length() < 64)
        if number and small and math.isfinite(value):
            return ""
        return _WORDS[hint]
    if isinstance(value, hint):
        return ""
    return _WORDS.get(hint, f"be a {hint.__name__}")
