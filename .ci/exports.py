"""For mkdocs: `{{ exports PACKAGE }}` in a page becomes the reference of what the package exports.

What that is stands in the package's `__init__.pyi`; `{{ commands }}` becomes that of all commands.
"""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def on_page_markdown(markdown: str, **_) -> str:
    """Expand the two marks of a page."""
    markdown = re.sub(r"{{ exports (\S+) }}", lambda match: _exports(match[1]), markdown)
    return markdown.replace("{{ commands }}", _commands())


def _exports(package: str) -> str:
    tree = ast.parse(ROOT.joinpath(*package.split("."), "__init__.pyi").read_text())
    names = [
        f"{package}.{node.module}.{alias.name}"
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    ]
    return "\n".join(f"::: {name}\n" for name in names)


def _commands() -> str:
    parts = []
    files = ROOT.glob("neurosym_*/commands/[a-z]*.py")
    for path in sorted(files, key=lambda path: path.stem):
        text = (ast.get_docstring(ast.parse(path.read_text())) or "").strip()
        parts.append(f"## neurosym {path.stem}\n\n{text}\n")
    return "\n".join(parts)
