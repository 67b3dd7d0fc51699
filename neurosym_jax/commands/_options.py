"""The options of a command: their list, the short help, and files of them in YAML.

A file has an option on each line, `pred_len: 12`, lists for several values and, instead
of a list of NAME=VALUE, a table.
"""

import dataclasses
import difflib
import functools
import inspect
import itertools
import json
import re
import shutil
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    get_args,
    get_origin,
    get_type_hints,
)

import docstring_parser
import yaml
from tyro.conf import OmitArgPrefixes, Positional

from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.plugins import installed_version, loaded
from neurosym_jax.runtime.foreign import read_yaml

if TYPE_CHECKING:
    from neurosym_jax.data.recordings import Source

__all__ = [
    "Command",
    "Positional",
    "Reading",
    "current_names",
    "description",
    "every_option",
    "flag_names",
    "flags",
    "given",
    "help_text",
]
__all__ += [
    "open_data",
    "options_text",
    "plugin_flags",
    "refuse_given",
    "refuse_unused",
    "with_file",
]

Command = Callable[..., Any]
"""A dataclass of options, or a function of them."""
PLUGIN = "--plugin FILE.py|MODULE"
PLUGIN_MEANING = (
    "Your own file or module, imported first. It registers metrics, forecasters, "
    "poolings, weightings or formats; the option may be repeated."
)
ADVANCED = "advanced"
"""Title of the options that are in none of a command's groups."""
KEYED = {"--set", "--network", "--columns"}
"""Options with a list of KEY=VALUE."""
Reading = Annotated[ReadOptions, OmitArgPrefixes]
"""How a command reads recordings: each field is an option of the command."""


def help_text(command: Command, prog: str, everything: bool = False) -> str:
    """What a command does and its options in groups: a dataclass of them, or a function.

    About a screen, in which `command.FIRST` are explained, by default all that are not
    in a dataclass of their own, and the others are named. With `everything` all are
    explained. `command.GROUPS` has the names of options by the title of their group.
    """
    width = min(shutil.get_terminal_size().columns, 100)
    options = [*every_option(command), ("", PLUGIN, PLUGIN_MEANING, None)]
    positional = [flag for _, flag, *_ in options if not flag.startswith("--")]
    text = [" ".join(["usage:", prog, *positional, "[OPTIONS]"]), ""]
    for paragraph in description(command).split("\n\n"):
        text += [*textwrap.wrap(paragraph, width), ""]
    for title, members in _sections(command, options).items():
        shown, others = [], []
        for option in members:
            if everything or _is_first(command, option):
                shown += _entry(option, everything, width)
            else:
                others.append(option[1].split(" ")[0])
        if title and shown:
            text.append(f"{title}:")
        text += shown
        if others:
            also = "  also:" if shown else f"{title}:"
            named = f"{also} {', '.join(others)}"
            text += textwrap.wrap(
                named, width, subsequent_indent="    ", break_on_hyphens=False
            )
        text.append("")
    if not everything:
        text.append(f"`{prog} --help-all` explains every option.")
    return "\n".join(text).rstrip()


Member = tuple[str, str, str, Any]
"""An option, as `every_option` yields it."""


def _sections(command: Command, options: Sequence[Member]) -> dict[str, list[Member]]:
    """Options by the title of their group, positional ones of no group first."""
    groups: Mapping[str, str] = getattr(command, "GROUPS", {})
    members_by_name: dict[str, list[Member]] = {}
    for option in sorted(options, key=lambda option: option[1].startswith("--")):
        members_by_name.setdefault(_key(option), []).append(option)
    sections: dict[str, list[Member]] = {}
    for title, names in groups.items():
        sections[title] = []
        for name in names.split():
            sections[title] += members_by_name.pop(name, [])
    for members in members_by_name.values():
        title = ADVANCED if groups else members[0][0]
        sections[title] = sections.get(title, []) + members
    return sections


def _key(option: Member) -> str:
    """The field of an option, or of the dataclass that it is in."""
    group, flag, *_ = option
    name = flag.split(" ")[0].removeprefix("--")
    return group or name.replace("-", "_").lower()


def _is_first(command: Command, option: Member) -> bool:
    """Whether an option is explained on the first screen."""
    first = getattr(command, "FIRST", None)
    if first is None:
        return not option[0]
    return _key(option) in first.split()


def _entry(option: Member, everything: bool, width: int) -> list[str]:
    """The lines that explain an option: one sentence, or with `everything` all."""
    _, flag, meaning, default = option
    says = meaning
    if not everything:
        says = re.split(r"(?<=[^.]\.)\s|;\s(?![^(]*\))", meaning)[0]
    says = says.rstrip(".")
    if isinstance(default, tuple):
        default = " ".join(map(str, default))
    is_plain = isinstance(default, (int, float, str, Path)) and "default" not in says
    if default is inspect.Parameter.empty and flag.startswith("--"):
        says += " (required)"
    elif default is True and is_plain:
        says += f" (default; --no-{flag[2:]})"
    elif is_plain and str(default) not in ("", "False"):
        says += f" (default {default})"
    indent = " " * 30
    return textwrap.wrap(f"  {flag:26}  {says}.", width, subsequent_indent=indent)


def description(command: Command) -> str:
    """What a command does, without its options."""
    return (docstring_parser.parse(command.__doc__ or "").description or "").strip()


def every_option(
    command: Command, group: str = "", prefix: str = ""
) -> Iterator[tuple[str, str, str, Any]]:
    """Group, `--name VALUE` (no dashes if positional), meaning and default of each option."""
    hints = get_type_hints(command, include_extras=True)
    sources = reversed(command.__mro__[:-1]) if inspect.isclass(command) else [command]
    meaning = dict(itertools.chain.from_iterable(map(_meanings, sources)))
    for name, parameter in inspect.signature(command).parameters.items():
        hint = hints[name]
        kind = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        marks = getattr(hint, "__metadata__", ())
        if dataclasses.is_dataclass(kind):
            flat = any("prefix" in str(mark).lower() for mark in marks)
            yield from every_option(kind, name, "" if flat else f"{name}.")  # pyright: ignore
            continue
        flag = name.upper()
        if not any("positional" in str(mark).lower() for mark in marks):
            value = next(
                (m.metavar for m in marks if getattr(m, "metavar", None)), _value(kind)
            )
            flag = f"--{(prefix + name).replace('_', '-')} {value}".rstrip()
        yield (
            group,
            flag,
            " ".join((meaning.get(name) or "").split()),
            parameter.default,
        )


@functools.cache
def _meanings(source: Command) -> list[tuple[str, str | None]]:
    """Options of a dataclass or function, without those inherited, and what they mean.

    Kept, because the source is parsed for it, which takes as long as all else.
    """
    params = docstring_parser.parse_from_object(source).params
    return [(param.arg_name, param.description) for param in params]


def _value(kind: Any) -> str:
    """What stands for a value of this type."""
    if get_origin(kind) is Literal:
        return "|".join(map(str, get_args(kind)))
    inner = [
        argument
        for argument in get_args(kind)
        if argument not in (type(None), Ellipsis)
    ]
    if inner:
        return _value(inner[0]) + (" ..." if get_origin(kind) is tuple else "")
    names = {bool: "", int: "N", float: "NUMBER", str: "NAME"}
    return names.get(kind, getattr(kind, "__name__", "").upper())


def given(options: Any) -> dict[str, Any]:
    """The options that differ from their defaults, by name, as plain values for YAML."""
    values: dict[str, Any] = {}
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        if dataclasses.is_dataclass(value):
            values |= given(value)
        elif value != field.default:
            values[field.name] = json.loads(json.dumps(value, default=str))
    return values


def flags(options: Mapping[str, Any]) -> list[str]:
    """The words of a command that give options by name, as `given` returns them."""
    words: list[str] = []
    for name, value in options.items():
        words.append(f"--{name.replace('_', '-')}")
        if value is True:
            continue
        values = value if isinstance(value, list | tuple) else [value]
        for item in values:
            words.append(f"{item:.12g}" if isinstance(item, float) else str(item))
    return words


def plugin_flags() -> list[str]:
    """The words of a command that import the plugins that are loaded."""
    words = list[str]()
    for plugin in loaded():
        words += ["--plugin", plugin]
    return words


def options_text(options: Any) -> str:
    """The YAML file that `with_file` reads as `options` and the plugins loaded."""
    values = given(options) | ({"plugin": loaded()} if loaded() else {})
    version = installed_version()  # Others have other defaults.
    return f"# neurosym-jax {version}\n{yaml.safe_dump(values, sort_keys=False)}"


def with_file(options: Command, arguments: Sequence[str]) -> list[str]:
    """`arguments`, of which the first may name a file of options; those after it override it.

    Those of `KEYED` override the same keys, and add others.

    Raises:
        InputError: for a file that cannot be read, an unknown option, or one that
            stands twice.
    """
    if not arguments or not arguments[0].endswith((".yaml", ".yml")):
        return list(arguments)
    path, *others = arguments
    values = read_yaml(path, "a file of options", loader=_Texts)
    if not isinstance(values, dict):
        raise InputError(f"{path}: must have a line `option: value` for each option")
    listed = [
        flag.split() for _, flag, *_ in every_option(options) if flag.startswith("--")
    ]
    kinds = {flag: kind for flag, *kind in [*listed, PLUGIN.split()]}
    read: list[str] = []
    for name, value in values.items():
        flag = current_name(options, f"--{name.replace('_', '-')}")
        if flag not in kinds:
            near = difflib.get_close_matches(flag, kinds, 1) or [", ".join(kinds)]
            raise InputError(
                f"{path}: unknown option {name!r}: did you mean {near[0]}?"
            )
        if isinstance(value, dict):
            value = [f"{key}={item}" for key, item in value.items()]
        texts = [value] if isinstance(value, str) else value
        if not kinds[flag] and value not in ("true", "false"):
            raise InputError(f"{path}: {name}: must be true or false, not {value}")
        if not kinds[flag]:
            read.append(flag if value == "true" else f"--no-{flag[2:]}")
        elif flag == "--plugin":
            for text in texts:
                read += [flag, text]
        elif flag in KEYED and flag in flag_names(others):
            others = _with_pairs(others, flag_names(others).index(flag), texts)
        else:
            read += [flag, *texts]
    return [*read, *others]


def current_names(options: Command, words: Sequence[str]) -> list[str]:
    """`words` with every option by its name of today, see `current_name`."""
    renamed = []
    for word in words:
        flag, equals, value = word.partition("=")
        renamed.append(current_name(options, flag) + equals + value)
    return renamed


def current_name(options: Command, flag: str) -> str:
    """The option that `flag` names, which may be its name in the last release.

    `options.RENAMED` has today's names by the old ones.

    Warns:
        InputWarning: where the name is an old one.
    """
    names = getattr(options, "RENAMED", {})
    name = flag.removeprefix("--")
    if not flag.startswith("--") or name not in names:
        return flag
    current = f"--{names[name]}"
    line = f"{flag} is called {current} now; the next release knows that name alone"
    warnings.warn(line, InputWarning, stacklevel=2)
    return current


def flag_names(words: Sequence[str]) -> list[str]:
    """The words as `every_option` names options: without `=VALUE`, and with hyphens."""
    return [word.partition("=")[0].replace("_", "-") for word in words]


def _with_pairs(words: Sequence[str], place: int, pairs: Sequence[str]) -> list[str]:
    """`words` with those KEY=VALUE `pairs` added to the option at `place` whose key it has not."""
    flag, equals, value = words[place].partition("=")
    own, rest = [value], words[place + 1 :]
    if not equals:
        own = list(itertools.takewhile(lambda word: not word.startswith("--"), rest))
        rest = rest[len(own) :]
    keys = {pair.partition("=")[0] for pair in own}
    added = [pair for pair in pairs if pair.partition("=")[0] not in keys]
    return [*words[:place], flag, *added, *own, *rest]


class _Texts(yaml.BaseLoader):
    """Values as they stand in the file, such as 1e-3 and 2020-01-01, in lists and dictionaries."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        names = [key.value for key, _ in node.value]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ValueError(f"the option {twice[0]!r} stands twice")
        return super().construct_mapping(node, deep)


def refuse_unused(options: Any, names: Iterable[str], where: str) -> None:
    """Refuse fields of `options` that were given and have no effect `where` they are."""
    refuse_given(where, **{name: name in given(options) for name in names})


def refuse_given(where: str, **options: Any) -> None:
    """Refuse options that were given, that is are true, and have no effect `where` they are.

    Raises:
        InputError: naming the first.
    """
    unused = [name for name, value in options.items() if value]
    if unused:
        raise InputError(f"--{unused[0].replace('_', '-')}: has no effect {where}")


def open_data(
    data: Path | None,
    read: ReadOptions,
    dataset: str | None,
    *files: object,
    **options: Any,
) -> "Source":
    """Open the source that --data and --dataset name, see `open_source`.

    Raises:
        InputError: for a model, and for options of reading where neither the source nor
            any of `files` is read.
    """
    # Only here, so that a robot's commands need no library of tables.
    from neurosym_jax.data.recordings import Synthetic, open_source
    from neurosym_jax.models.disk import find_model

    if data is not None and (find_model(data) / "params.safetensors").is_file():
        raise InputError(
            f"{data}: is a model, not a recording: `neurosym evaluate --model {data}` tests it"
        )
    source = open_source(data, dataset, read=read, **options)
    if isinstance(source, Synthetic) and not any(files):
        refuse_unused(read, vars(read), "on simulations (--data names recordings)")
    return source
