"""The short help of a command: a line for each of its options, groups of options by name."""

import ast
import dataclasses
import inspect
import itertools
import re
import shutil
import textwrap
from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

__all__ = ["every_option", "short_help"]


def short_help(options: type, prog: str) -> str:
    """About a screen of text on `options`, the dataclass of a command.

    Fields that are dataclasses are groups, whose options are only named.
    """
    width = min(shutil.get_terminal_size().columns, 100)
    found = sorted(every_option(options), key=lambda option: option[1].startswith("--"))
    positional = [flag for _, flag, _ in found if not flag.startswith("--")]
    text = [" ".join(["usage:", prog, *positional, "[OPTIONS]"]), ""]
    text += [*inspect.cleandoc(options.__doc__ or "").splitlines(), ""]
    groups: dict[str, list[str]] = {}
    plugin = "--plugin FILE.py|MODULE", "Your own file or module, imported first"
    for group, flag, meaning in [*found, ("", *plugin)]:
        if group:
            groups.setdefault(group, []).append(flag.split(" ")[0])
            continue
        sentence = re.split(r"(?<=[^.]\.)\s|;\s(?![^(]*\))", meaning)[0].rstrip(".")
        text += textwrap.wrap(f"  {flag:26}  {sentence}.", width, subsequent_indent=" " * 30)
    for group, flags in groups.items():
        names = f"{group}: {', '.join(flags)}"
        text += ["", *textwrap.wrap(names, width, break_on_hyphens=False)]
    return "\n".join([*text, "", f"`{prog} --help-all` explains every option."])


def every_option(
    options: type, group: str = "", prefix: str = ""
) -> Iterator[tuple[str, str, str]]:
    """Group, `--name VALUE` (without dashes if positional) and meaning of each option."""
    hints = get_type_hints(options, include_extras=True)
    meaning = dict(_documented(options))
    for field in dataclasses.fields(options):
        hint = hints[field.name]
        kind = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        marks = getattr(hint, "__metadata__", ())
        if dataclasses.is_dataclass(kind):
            flat = any("prefix" in str(mark).lower() for mark in marks)
            yield from every_option(kind, field.name, "" if flat else f"{field.name}.")  # pyright: ignore
            continue
        flag = field.name.upper()
        if not any("positional" in str(mark).lower() for mark in marks):
            value = next((m.metavar for m in marks if getattr(m, "metavar", None)), _value(kind))
            flag = f"--{(prefix + field.name).replace('_', '-')} {value}".rstrip()
        yield group, flag, meaning.get(field.name, "")


def _value(kind: Any) -> str:
    """What stands for a value of this type."""
    if get_origin(kind) is Literal:
        return "|".join(map(str, get_args(kind)))
    inner = [each for each in get_args(kind) if each not in (type(None), Ellipsis)]
    if inner:
        return _value(inner[0]) + (" ..." if get_origin(kind) is tuple else "")
    names = {bool: "", int: "N", float: "NUMBER", str: "VALUE"}
    return names.get(kind, getattr(kind, "__name__", "").upper())


def _documented(options: type) -> Iterator[tuple[str, str]]:
    """Name and docstring of each field, those of base classes first."""
    for each in reversed(options.__mro__):
        if not dataclasses.is_dataclass(each):
            continue
        (definition,) = ast.parse(inspect.cleandoc("\n" + inspect.getsource(each))).body
        for field, text in itertools.pairwise(definition.body):  # pyright: ignore
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                yield field.target.id, " ".join(text.value.value.split())  # pyright: ignore
