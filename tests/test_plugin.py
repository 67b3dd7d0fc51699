"""One file of somebody's own adds one of each kind, and each is seen where its kind is seen."""

from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from neurosym_jax.__main__ import main
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.forecasting.parameters import nested_parameters
from neurosym_jax.symbolic.weightings import WEIGHTINGS, register_weighting
from neurosym_jax.training.network import named_network

ROOT = Path(__file__).parents[1]
MISSING = "unknown weighting 'nearness'"


def test_without_its_plugin_a_model_says_what_it_needs(tmp_path, capsys, monkeypatch):
    """In every command that is told of it; nothing that a model's folder names is imported."""
    model = tmp_path / "model"
    with mock.patch.dict(WEIGHTINGS):
        register_weighting("nearness", log_reach=0.0)(lambda positions, valid, log_reach: 0)
        network = named_network("neurosym", weighting="nearness")
        shapes = Model(network, {}).forecaster.shapes()
        assert shapes is not None
        params = {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}
        save_model(model, Model(network, nested_parameters(params), plugins=("near.py",)))
        assert load_model(model).plugins == ("near.py",)
    (tmp_path / "near.py").write_text("raise SystemExit('imported')")
    monkeypatch.chdir(tmp_path)

    def refusal(*command: str) -> str:
        with pytest.raises(SystemExit) as caught:
            main(list(command))
        (line,) = capsys.readouterr().err.splitlines()
        assert caught.value.code == 2
        assert MISSING in line
        return line

    needs = "; it was trained with --plugin near.py"
    assert refusal("evaluate", "--checkpoint", "model").endswith(needs)
    assert refusal("symbols", "--model", "model").endswith(needs)
    asked = ("--weighting", "nearness")
    for line in (
        refusal("train", "--model", "neurosym", *asked),
        refusal("sweep", "--models", "neurosym", "--weightings", "nearness"),
        refusal("symbols", *asked),
    ):
        assert "(--plugin FILE adds one)" in line
