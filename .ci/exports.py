"""Hook of mkdocs: expands `{{ exports PACKAGE }}`, `{{ commands }}` and `{{ table FILE.csv }}`.

`{{ exports PACKAGE }}` becomes the reference of all names in the package's
`__init__.pyi`. Every object stands on one page, that of its subpackage; the page of the
whole package links to it.
"""

import ast
import csv
import html
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def on_page_markdown(markdown: str, page: Any, **_) -> str:
    """Expand the placeholders of a page; a search finds studies after other pages."""
    if any(section.title == "Studies" for section in page.ancestors):
        page.meta["search"] = {"boost": 0.5}
    markdown = re.sub(r"{{ table (\S+) }}", lambda match: _table(match[1]), markdown)
    markdown = re.sub(
        r"{{ exports (\S+) }}", lambda match: _exports(match[1]), markdown
    )
    return markdown.replace("{{ commands }}", _commands())


def _exports(package: str) -> str:
    folder = ROOT.joinpath(*package.split("."))
    elsewhere = {
        name
        for stub in folder.glob("*/__init__.pyi")
        for name in _names(stub, f"{package}.{stub.parent.name}")
    }
    names = _names(folder / "__init__.pyi", package)
    links = [
        f"- [`{name.rpartition('.')[2]}`][{name}]"
        for name in names
        if name in elsewhere
    ]
    entries = [f"::: {name}\n" for name in names if name not in elsewhere]
    return "\n".join([*links, "", *entries])


def _names(stub: Path, package: str) -> list[str]:
    """Full names of the objects that a stub exports."""
    return [
        f"{package}.{node.module}.{alias.name}"
        for node in ast.parse(stub.read_text()).body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    ]


def _table(name: str) -> str:
    """A CSV file of docs/ as a table that assets/site.js filters and sorts."""
    with (ROOT / "docs" / name).open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    lines = [
        "<tr>"
        + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in row)
        + "</tr>"
        for tag, row in [("th", head), *(("td", row) for row in rows)]
    ]
    body = "".join(lines[1:])
    return (
        f'<div class="md-typeset__scrollwrap"><table class="filtered"><thead>{lines[0]}</thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(text: str) -> str:
    """Text within a table in Markdown: html.escape leaves the bar, which would end the cell."""
    return html.escape(text).replace("|", "&#124;")


def _commands() -> str:
    from neurosym_jax.__main__ import commands
    from neurosym_jax.commands._options import every_option

    parts = []
    for name, module in commands().items():
        command = importlib.import_module(module)
        text = inspect.cleandoc(command.__doc__ or "")
        rows = [
            f"| <code>{_cell(flag)}</code> | {_cell(meaning)} |"
            for _, flag, meaning, _ in every_option(
                getattr(command, "Options", command.run)
            )
        ]
        table = "\n".join(["| option | meaning |", "|---|---|", *rows]) if rows else ""
        parts.append(f"## neurosym {name}\n\n{text}\n\n{table}\n")
    return "\n".join(parts)
