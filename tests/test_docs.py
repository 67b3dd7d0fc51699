"""Pages are few, short and linked, and what they point to and name is there."""

import re
import runpy

import pytest

from neurosym_jax.__main__ import commands
from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.errors import InputError
from tests.commands.walk import options_of
from tests.repository import ROOT

COMMANDS = re.compile(
    r"(?m)(?:^ {4}|`)(?:neurosym|python -m neurosym_jax|python (?=(?:evaluate|train)\.py))"
    r" ?((?:[^`\n]*\\\n)*[^`\n]*)"
)
"""Words of a command, in a line of its own or in a sentence."""
PAGES = {
    path.name: path.read_text(encoding="utf-8")
    for path in sorted(ROOT.glob("docs/*.md"))
}
BESIDE_STUDIES = {
    path.name: path.read_text(encoding="utf-8")
    for path in sorted(ROOT.glob("studies/pages/*.md"))
}
EXPANDED = [
    path
    for folder in ("docs/reference", "studies/pages")
    for path in sorted((ROOT / folder).glob("*.md"))
]


def test_the_format_of_the_page_reads_a_file(tmp_path):
    page = (ROOT / "docs/reference/data.md").read_text(encoding="utf-8")
    code = re.search(r"## A format\n[^`]*`[^`]*`[^`]*```python\n(.*?)```", page, re.S)
    assert code
    file = tmp_path / "a.txt"
    file.write_text("pipes\n0|7|1|2\n0.4|7|1.5|2\n")
    exec(code[1], {"__name__": "pipes"})
    (tracks,) = read_any(file, ReadOptions(format="pipes,shift=10"))
    assert read_any(file)[0].position.tolist() == [[1, 2], [1.5, 2]]
    assert tracks.position.tolist() == [[11, 2], [11.5, 2]]
    (scaled,) = read_any(file, ReadOptions(unit="0.5", flip_y=True))
    assert scaled.position.tolist() == [[0.5, -1], [0.75, -1]]
    with pytest.raises(InputError, match="fps is of no use for tracks between pipes"):
        read_any(file, ReadOptions(fps=25))


def test_targets_of_the_readme_exist():
    for name in ("README.md", "CONTRIBUTING.md"):
        targets = re.findall(r"\]\(([^)#]+)", (ROOT / name).read_text())
        missing = [
            path for path in targets if "://" not in path and not (ROOT / path).exists()
        ]
        assert missing == []


def test_every_page_is_in_the_navigation_and_linked_from_another():
    navigation = (ROOT / "mkdocs.yml").read_text()
    files = [*ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/**/*.ipynb")]
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in files}
    assert {page for page in pages if f": {page}\n" not in navigation} == set()
    links = set()
    for name, text in PAGES.items():
        links |= set(re.findall(r"\]\(([\w/]+\.md)", text)) - {name}
    assert PAGES.keys() - links == {"index.md"}
    beside = re.findall(r"\]\(\.\./studies/pages/(\w+\.md)", PAGES["studies.md"])
    assert set(beside) == set(BESIDE_STUDIES)


@pytest.mark.parametrize("path", EXPANDED, ids=lambda path: path.stem)
def test_plain_texts_are_what_the_site_shows(path):
    """If not, `python .ci/exports.py` writes them."""
    written = runpy.run_path(str(ROOT / ".ci" / "exports.py"))["written"]
    text = path.read_text(encoding="utf-8")
    assert written(text) == text
    assert "{{" not in text


def test_every_study_that_a_page_names_is_in_the_tree_or_listed_at_rest():
    command = re.compile(r"python -m studies\.(\w+)")
    listed = set(command.findall(BESIDE_STUDIES["at_rest.md"]))
    for name, text in (PAGES | BESIDE_STUDIES).items():
        for study in command.findall(text):
            path = ROOT / "studies" / study
            in_tree = path.is_dir() or path.with_suffix(".py").is_file()
            assert in_tree or (study in listed and name != "studies.md"), (name, study)


def test_every_option_that_a_page_names_is_one_of_its_command():
    known = {name: {"--plugin", "--help-all", *options_of(name)} for name in commands()}
    count = 0
    readme = {"README.md": (ROOT / "README.md").read_text()}
    beside = {f"studies/pages/{page}": text for page, text in BESIDE_STUDIES.items()}
    for page, text in (PAGES | beside | readme).items():
        for line in COMMANDS.findall(text):
            name, *words = re.sub(r"\s#.*|\s>.*|&&.*|[\[\]\\]", "", line).replace(
                ".py", ""
            ).split() or [""]
            if name not in known:
                continue
            count += 1
            options = {
                word.partition("=")[0] for word in words if re.match(r"--[a-z]", word)
            }
            names = {option.rstrip(",.;:").replace("--no-", "--") for option in options}
            assert {option.replace("_", "-") for option in names} <= known[name], (
                page,
                line,
            )
    assert count > 40
