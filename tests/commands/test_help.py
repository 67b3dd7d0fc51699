"""The short help fits a screen and names every option."""

import importlib
import re

import pytest
import tyro

from neurosym_jax.__main__ import commands, main
from neurosym_jax.commands._options import short_help

NAMES = re.compile(r"--[a-z][a-z0-9.-]*")


@pytest.mark.parametrize("name", commands())
def test_help_fits_a_screen_and_names_every_option(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "90")
    options = importlib.import_module(commands()[name]).Options
    text = short_help(options, f"neurosym {name}")
    lines = text.splitlines()
    assert len(lines) <= 50
    assert max(map(len, lines)) <= 90
    with pytest.raises(SystemExit):
        tyro.cli(options, args=["--help"])
    every = set(re.findall(r"^│ (--[a-z][a-z0-9.-]*)", capsys.readouterr().out, re.MULTILINE))
    assert every - set(NAMES.findall(text)) == set()
    assert set(NAMES.findall(text)) >= {"--plugin", "--help-all"}


def test_help_says_what_the_main_options_do(capsys):
    with pytest.raises(SystemExit) as done:
        main(["symbols", "--help"])
    assert done.value.code in (0, None)
    text = capsys.readouterr().out
    assert text.startswith("usage: neurosym symbols DATA [OPTIONS]\n")
    assert re.search(r"--window N +Index of the window to show\.", text)
    with pytest.raises(SystemExit):
        main(["symbols", "--help-all"])
    assert "{None}" not in capsys.readouterr().out
