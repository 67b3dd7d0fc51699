"""Hook of mkdocs: expands what pages have as plain text behind a comment.

| in a page | in the repository | on the site |
|---|---|---|
| `<!-- exports PACKAGE -->` | names that the package's `__init__.pyi` exports | their reference |
| `<!-- commands -->` | names of the commands | their options |
| `<!-- table FILE.csv -->` | a table | one that can be filtered and sorted |

`python .ci/exports.py` writes the plain texts. Every object stands on one page, that of
its subpackage; the page of the whole package links to it. Pages of `studies/pages` are
part of the site, without an entry of its navigation. Notebooks are headed by a link that
downloads them, and one to Colab where mkdocs.yml has a `repo_url` on GitHub.
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
STUDIES = ROOT / "studies" / "pages"
PLAIN = re.compile(r"<!-- (exports|commands|table)(?: (\S+))? -->\n+(?:[-|].*\n)*")
"""A comment and the plain list or table behind it."""


def on_files(files: Any, config: Any) -> Any:
    """Add the pages beside the studies."""
    from mkdocs.structure.files import File, InclusionLevel

    for path in sorted(STUDIES.glob("*.md")):
        place = f"pages/{path.name}"
        page = File.generated(config, place, abs_src_path=str(path))
        page.inclusion = InclusionLevel.NOT_IN_NAV
        files.append(page)
    return files


def on_page_markdown(markdown: str, page: Any, **_) -> str:
    """Expand a page; a search finds what is beside studies after other pages."""
    if page.file.src_uri.startswith("pages/"):
        page.meta["search"] = {"boost": 0.5}
        markdown = markdown.replace("](../../docs/", "](../")
    else:
        markdown = markdown.replace("](../studies/pages/", "](pages/")
    return PLAIN.sub(lambda match: _expanded(match[1], match[2]), markdown)


def on_page_content(html: str, page: Any, config: Any, **_) -> str:
    """Head a notebook by links that download it and, from a public repository, open it."""
    if not page.file.src_uri.endswith(".ipynb"):
        return html
    name = Path(page.file.src_uri).name
    links = [f'<a href="{name}" download>Download this notebook</a>']
    repository = re.match(
        r"https://github\.com/([\w.-]+/[\w.-]+)", config.repo_url or ""
    )
    if repository:
        path = f"{repository[1]}/blob/main/docs/{page.file.src_uri}"
        colab = f"https://colab.research.google.com/github/{path}"
        links.append(f'<a href="{colab}">open it in Colab</a>')
    return f"<p>{', or '.join(links)}.</p>\n{html}"


def _expanded(kind: str, name: str) -> str:
    if kind == "exports":
        return _exports(name)
    if kind == "table":
        return _table(name)
    return _commands()


def written(markdown: str) -> str:
    """A page with the plain texts as they are now."""

    def plain(match: re.Match[str]) -> str:
        kind, name = match[1], match[2]
        comment = match[0].partition("\n")[0]
        if kind == "table":
            head, *rows = _rows(name)
            lines = [_line(head), _line(["---"] * len(head)), *map(_line, rows)]
            return "\n".join([comment, "", *lines, ""])
        names = _command_names() if kind == "commands" else _export_names(name)
        return "\n".join([comment, "", *(f"- `{name}`" for name in names), ""])

    return PLAIN.sub(plain, markdown)


def _line(cells: list[str]) -> str:
    texts = [cell.replace("|", "\\|") for cell in cells]
    return f"| {' | '.join(texts)} |"


def _export_names(package: str) -> list[str]:
    stub = ROOT.joinpath(*package.split("."), "__init__.pyi")
    return [name.rpartition(".")[2] for name in _names(stub, package)]


def _command_names() -> list[str]:
    from neurosym_jax.__main__ import commands

    return [f"neurosym {name}" for name in commands()]


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


def _rows(name: str) -> list[list[str]]:
    """Lines of a CSV file of docs/."""
    with (ROOT / "docs" / name).open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def _table(name: str) -> str:
    """A table that assets/site.js filters and sorts."""
    head, *rows = _rows(name)
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


if __name__ == "__main__":
    for path in [*ROOT.glob("docs/reference/*.md"), *STUDIES.glob("*.md")]:
        path.write_text(written(path.read_text("utf-8")), "utf-8")
