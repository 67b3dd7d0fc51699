"""What users give, refused in words before anything is computed: types and ranges of settings.

A configuration is a dataclass whose annotations say what its values can be, ranges included
(`Count`, `Positive`, ...), and whose `__post_init__` calls `refuse_misfits`.
"""

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from neurosym_jax.errors import InputError

__all__ = [
    "BelowOne",
    "Count",
    "Interval",
    "NotNegative",
    "Positive",
    "Rule",
    "Seed",
    "Share",
    "Whole",
    "refuse_below",
    "refuse_misfits",
    "refuse_seed",
]


@dataclasses.dataclass(frozen=True)
class Rule:
    """A condition on the values of an annotated type."""

    words: str
    """What a value must do, such as `be positive`."""
    holds: Callable[[Any], bool]


Count = Annotated[int, Rule("be at least 1", lambda value: value >= 1)]
Seed = Annotated[int, Rule("lie in [0, 2**32)", lambda value: 0 <= value < 2**32)]
Whole = Annotated[int, Rule("be at least 0", lambda value: value >= 0)]
NotNegative = Annotated[float, Rule("be at least 0", lambda value: value >= 0)]
Positive = Annotated[float, Rule("be positive", lambda value: value > 0)]
Share = Annotated[float, Rule("lie in [0, 1]", lambda value: 0 <= value <= 1)]
BelowOne = Annotated[float, Rule("lie in [0, 1)", lambda value: 0 <= value < 1)]
Interval = Annotated[tuple[float, float], Rule("be low, high", lambda value: value[0] <= value[1])]

_WORDS: dict[Any, str] = {
    bool: "be true or false",
    int: "be a whole number",
    float: "be a finite number",
    str: "be text",
    type(None): "be null",
}


def refuse_misfits(config: Any) -> None:
    """Refuse a dataclass with a value that its annotation does not allow.

    Raises:
        InputError: naming the first such field, its value and what it must be.
    """
    for name, hint in _hints(type(config)).items():
        value = getattr(config, name)
        if wanted := _misfit(value, hint):
            raise InputError(f"{name} must {wanted}, not {value!r}")


def refuse_below(lowest: float, values: Mapping[str, float | None]) -> None:
    """Refuse what is not a finite number of at least `lowest`; None means not given.

    Raises:
        InputError: naming the first that is out of range.
    """
    for name, value in values.items():
        if value is not None and not lowest <= value < math.inf:
            raise InputError(f"{name} must be at least {lowest:g}, not {value}")


def refuse_seed(seed: int, name: str = "seed") -> None:
    """Refuse a seed that is not in [0, 2**32), which jax would silently wrap.

    Raises:
        InputError: naming it.
    """
    if wanted := _misfit(seed, Seed):
        raise InputError(f"{name} must {wanted}, not {seed}")


@functools.cache
def _hints(config: type) -> dict[str, Any]:
    hints = typing.get_type_hints(config, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(config)}


def _misfit(value: Any, hint: Any) -> str:
    """What `value` would have to do to be a `hint`, in words; empty where it is one."""
    origin, of = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        broken = (rule.words for rule in of[1:] if not rule.holds(value))
        return _misfit(value, of[0]) or next(broken, "")
    if origin is Literal:
        return "" if value in of else f"be one of {', '.join(of)}"
    if origin in (typing.Union, types.UnionType):
        wanted = [_misfit(value, option) for option in of]
        return " or ".join(wanted) if all(wanted) else ""
    if origin is tuple:
        fits = isinstance(value, tuple) and len(value) == len(of)
        wrong = [_misfit(part, kind) for part, kind in zip(value, of)] if fits else [""]
        return "" if fits and not any(wrong) else f"be {len(of)} finite numbers"
    if hint in (int, float):
        number = isinstance(value, int | hint) and not isinstance(value, bool)
        return "" if number and math.isfinite(value) else _WORDS[hint]
    return "" if isinstance(value, hint) else _WORDS.get(hint, f"be a {hint.__name__}")
