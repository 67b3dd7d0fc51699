"""The short help of a command: its main options with a sentence, the others by name."""

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

MAIN = 7
"""Options with a sentence, where a command does not name its own."""


def short_help(options: type, prog: str) -> str:
    """At most a screen of text on `options`, the dataclass of a command.

    Positional fields and those in `options.SHOWN`, by default the first seven, get a sentence.
    Fields that are dataclasses are groups.
    """
    width = min(shutil.get_terminal_size().columns, 100)
    ours = {flag: text for group, flag, text in every_option(options) if not group}
    shown = getattr(options, "SHOWN", None)
    chosen = list(ours)[:MAIN] if shown is None else [_dashed(name) for name in shown]
    lines = {
        flag: re.split(r"(?<=[^.]\.)\s|;\s(?![^(]*\))", text)[0].rstrip(".") + "."
        for flag, text in sorted(ours.items(), key=lambda item: item[0].startswith("--"))
        if flag.split(" ")[0] in {each.split(" ")[0] for each in chosen} or flag[0] != "-"
    }
    given = [flag for flag in lines if not flag.startswith("--")]
    head = [
        " ".join(["usage:", prog, *given, "[OPTIONS]"]),
        "",
        inspect.cleandoc(options.__doc__ or ""),
    ]
    indent = min(30, max(map(len, lines), default=0) + 4)
    text = ["\n".join(head), ""]
    for flag, sentence in lines.items():
        start = f"  {flag}".ljust(indent)
        if len(start) > indent:
            text.append(start)
            start = " " * indent
        text += textwrap.wrap(sentence, width, initial_indent=start, subsequent_indent=" " * indent)
    more: dict[str, list[str]] = {"more": [flag for flag in ours if flag not in lines]}
    more["more"].append("--plugin")
    for group, flag, _ in every_option(options):
        if group:
            more.setdefault(group, []).append(flag)
    for name, flags in more.items():
        names = ", ".join(flag.split(" ")[0] for flag in flags)
        text += ["", *textwrap.wrap(f"{name}: {names}", width, break_on_hyphens=False)]
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
        elif field.name != "plugin":
            flag = field.name.upper()
            if not any("positional" in str(mark).lower() for mark in marks):
                value = next(
                    (m.metavar for m in marks if getattr(m, "metavar", None)), _value(kind)
                )
                flag = f"{_dashed(prefix + field.name)} {value}".rstrip()
            yield group, flag, meaning.get(field.name, "")


def _dashed(name: str) -> str:
    return "--" + name.replace("_", "-")


def _value(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return "|".join(map(str, get_args(kind)))
    inner = [each for each in get_args(kind) if each not in (type(None), Ellipsis)]
    if get_origin(kind) is tuple:
        return f"{_value(inner[0])} ..."
    if inner:
        return _value(inner[0])
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
