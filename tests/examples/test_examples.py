"""Every example, as a module, with fewer steps."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.symbolic import alpha_table
from neurosym_jax.symbolic.weighting_config import WEIGHTINGS

FOLDER = Path(__file__).resolve().parents[2] / "examples"
TESTED = {"which_pair_matters", "learn_weights", "own_weighting"}


def example(name):
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_no_example_is_forgotten():
    assert {path.stem for path in FOLDER.glob("*.py")} == TESTED


@pytest.mark.slow
def test_the_gradient_finds_the_pair_that_matters(capsys):
    foretold, found = example("which_pair_matters").main()
    most = abs(foretold).argmax()
    assert abs(foretold[most]) > 1e-5
    np.testing.assert_allclose(foretold[most], found[most], rtol=0.2)
    assert capsys.readouterr().out.count("by the gradient") == 12


@pytest.mark.slow
def test_weights_are_learned():
    table = example("learn_weights").main(steps=2)
    change = abs(table - alpha_table())
    assert 0.001 < change.max() < 0.02


@pytest.mark.slow
def test_a_weighting_of_ones_own_is_trained(monkeypatch):
    monkeypatch.setattr(WEIGHTINGS, "_things", dict(WEIGHTINGS))
    assert example("own_weighting").main(steps=5) != 1.0
