"""The site builds without a warning, and what pages point to and name is there."""

import re
from unittest import mock

import pytest

from neurosym_jax.__main__ import commands
from neurosym_jax.data.formats import FORMATS, read_any
from neurosym_jax.data.reading import ReadOptions
from studies.check_docs import commands as named_commands
from tests.commands.walk import options_of
from tests.repository import ROOT, run_python


@pytest.mark.slow
def test_the_site_builds_strictly(tmp_path):
    pytest.importorskip("mkdocs", reason="the site needs the extra docs")
    pytest.importorskip("material", reason="the site needs the extra docs")
    pytest.importorskip("mkdocs_jupyter", reason="the site needs the extra docs")
    build = ("-m", "mkdocs", "build", "--strict", "-q", "-d", tmp_path / "site")
    run_python(*build, NO_MKDOCS_2_WARNING="1")
    page = (tmp_path / "site/reference/symbolic/index.html").read_text()
    assert "neurosym_jax.symbolic.qtc.observe" in page
    assert "[..., T-1, m] int8" in page
    assert "neurosym replay" in (tmp_path / "site/reference/commands/index.html").read_text()


def test_the_format_of_the_page_reads_a_file(tmp_path):
    code = re.search(
        r"## A format\n\n```python\n(.*?)```", (ROOT / "docs/extend.md").read_text(), re.S
    )
    assert code
    file = tmp_path / "a.txt"
    file.write_text("pipes\n0|7|1|2\n0.4|7|1.5|2\n")
    with mock.patch.dict(FORMATS):
        exec(code[1], {"__name__": "pipes"})
        (tracks,) = read_any(file, ReadOptions(format="pipes,shift=10"))
        assert read_any(file)[0].position.tolist() == [[1, 2], [1.5, 2]]
    assert tracks.position.tolist() == [[11, 2], [11.5, 2]]


@pytest.mark.slow
def test_the_network_of_the_page_learns(capsys):
    page = (ROOT / "docs/own_network.md").read_text()
    code = re.search(r"```python\n(.*?)```", page, re.S)
    assert code
    exec(code[1], names := {"__name__": "page"})
    error, straight = (
        float(names["loss"](names[name], names["test"])) for name in ("params", "straight")
    )
    assert error < 0.6 * straight
    speed = float(names["speed"])
    assert abs(speed - 0.125) > 0.005
    # The numbers below the code are those that it prints, up to what rounding makes of training.
    assert f"constant velocity {straight:.3f} m" in page
    assert f"constant velocity {straight:.3f} m" in capsys.readouterr().out


def test_targets_of_the_readme_exist():
    for name in ("README.md", "CONTRIBUTING.md"):
        targets = re.findall(r"\]\(([^)#]+)", (ROOT / name).read_text())
        missing = [path for path in targets if "://" not in path and not (ROOT / path).exists()]
        assert missing == []


def test_every_page_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text()
    files = [file for kind in ("md", "ipynb") for file in ROOT.glob(f"docs/**/*.{kind}")]
    pages = {page.relative_to(ROOT / "docs").as_posix() for page in files}
    assert {page for page in pages if f": {page}\n" not in navigation} == set()


def test_every_option_that_a_page_names_is_one_of_its_command():
    named = set(named_commands())
    assert len(named) > 40
    known = {name: {"--plugin", "--help-all", *options_of(name)} for name in commands()}
    for page, command in named:
        name, *words = command.split()[1:]
        if not name.startswith("-") and name.islower():
            options = {word.partition("=")[0] for word in words if re.match(r"--[a-z]", word)}
            used = {option.rstrip(",.;:").replace("--no-", "--") for option in options}
            assert {each.replace("_", "-") for each in used} <= known[name], (page, command)
