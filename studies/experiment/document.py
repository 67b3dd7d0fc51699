"""A report of text, tables and figures, written as Markdown and as one HTML file to share."""

import base64
import dataclasses
import html
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

__all__ = ["Document"]

STYLE = """
:root { color-scheme: light dark;
  --ink: #1d2733; --soft: #5b6775; --line: #dfe4ea; --back: #ffffff; --tint: #f5f7fa; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaf0; --soft: #a3adb9; --line: #333c47; --back: #14191f; --tint: #1c232b; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--ink);
  font: 17px/1.6 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 60rem; margin: 0 auto; padding: 3rem 1.5rem 5rem; }
h1 { font-size: 2.1rem; line-height: 1.2; margin: 0 0 1rem; letter-spacing: -0.015em; }
h2 { font-size: 1.35rem; margin: 3rem 0 0.75rem; padding-top: 1.25rem;
  border-top: 1px solid var(--line); }
p { max-width: 46rem; margin: 0.75rem 0; }
code { font: 0.88em/1.5 ui-monospace, "SF Mono", Menlo, Consolas, monospace;
  background: var(--tint); padding: 0.1em 0.35em; border-radius: 4px; }
pre { background: var(--tint); padding: 0.9rem 1.1rem; border-radius: 8px; overflow-x: auto; }
pre code { background: none; padding: 0; }
.scroll { overflow-x: auto; margin: 1rem 0 1.5rem; }
table { border-collapse: collapse; font-size: 0.93rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: 0.5rem; white-space: nowrap; }
th, td { padding: 0.4rem 0.9rem; border-bottom: 1px solid var(--line); white-space: nowrap; }
th { color: var(--soft); font-weight: 600; text-align: left; border-bottom-width: 2px; }
td.number, th.number { text-align: right; }
tbody tr:hover { background: var(--tint); }
figure { margin: 1.5rem 0 2rem; }
figure img { width: 100%; border-radius: 8px; border: 1px solid var(--line); background: #fff; }
figcaption { color: var(--soft); font-size: 0.93rem; max-width: 46rem; margin-top: 0.5rem; }
@media print { h2 { break-after: avoid; } figure, table { break-inside: avoid; } }
"""


@dataclasses.dataclass
class Document:
    """Blocks in order; texts may have `code` and **bold**."""

    title: str
    _blocks: list[tuple[str, Any]] = dataclasses.field(default_factory=list)

    def heading(self, text: str) -> None:
        """A section begins."""
        self._blocks.append(("heading", text))

    def text(self, text: str) -> None:
        """A paragraph."""
        self._blocks.append(("text", " ".join(text.split())))

    def code(self, text: str) -> None:
        """Lines as they are typed."""
        self._blocks.append(("code", text))

    def table(self, caption: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table; columns whose cells are numbers or empty are set to the right."""
        self._blocks.append(("table", (caption, list(head), [list(row) for row in rows])))

    def figure(self, path: Path, caption: str) -> None:
        """An image file in, or below, the folder that the report is written to."""
        self._blocks.append(("figure", (path, caption)))

    def markdown(self, folder: Path) -> str:
        """For a file in `folder`."""
        parts = [f"# {self.title}"]
        for kind, block in self._blocks:
            if kind == "heading":
                parts.append(f"## {block}")
            elif kind == "code":
                parts.append("\n".join(f"    {line}" for line in block.splitlines()))
            elif kind == "table":
                parts.extend(_markdown_table(*block))
            elif kind == "figure":
                path, caption = block
                parts.append(f"![{caption}]({path.relative_to(folder).as_posix()})")
                parts.append(caption)
            else:
                parts.append(block)
        return "\n\n".join(parts) + "\n"

    def html(self) -> str:
        """One file with everything in it."""
        parts = []
        for kind, block in self._blocks:
            if kind == "heading":
                parts.append(f"<h2>{_inline(block)}</h2>")
            elif kind == "code":
                parts.append(f"<pre><code>{html.escape(block)}</code></pre>")
            elif kind == "table":
                parts.append(_html_table(*block))
            elif kind == "figure":
                path, caption = block
                data = base64.b64encode(path.read_bytes()).decode()
                parts.append(
                    f'<figure><img alt="{html.escape(caption)}" '
                    f'src="data:image/png;base64,{data}">'
                    f"<figcaption>{_inline(caption)}</figcaption></figure>"
                )
            else:
                parts.append(f"<p>{_inline(block)}</p>")
        title = html.escape(self.title)
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{title}</title>\n<style>{STYLE}</style></head>\n"
            f"<body><main>\n<h1>{title}</h1>\n" + "\n".join(parts) + "\n</main></body></html>\n"
        )


def _inline(text: str) -> str:
    text = re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", text)


def _to_the_right(rows: list[list[str]], column: int) -> bool:
    return all(re.fullmatch(r"[-–\d.,/ %]*", row[column]) for row in rows)


def _markdown_table(caption: str, head: list[str], rows: list[list[str]]) -> list[str]:
    rule = ["---:" if _to_the_right(rows, n) else "---" for n in range(len(head))]
    lines = [f"| {' | '.join(row)} |" for row in [head, rule, *rows]]
    return [f"**{caption}**", "\n".join(lines)]


def _html_table(caption: str, head: list[str], rows: list[list[str]]) -> str:
    look = [' class="number"' if _to_the_right(rows, n) else "" for n in range(len(head))]

    def line(tag: str, cells: list[str]) -> str:
        filled = (f"<{tag}{c}>{_inline(cell)}</{tag}>" for c, cell in zip(look, cells))
        return f"<tr>{''.join(filled)}</tr>"

    body = "\n".join(line("td", row) for row in rows)
    return (
        f'<div class="scroll"><table><caption>{_inline(caption)}</caption>'
        f"<thead>{line('th', head)}</thead>\n<tbody>{body}</tbody></table></div>"
    )
