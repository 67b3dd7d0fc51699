"""One file of somebody's own adds one of each kind, and each is seen where its kind is seen."""

import json
import os
import subprocess
import sys
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
PLUGIN = """
import dataclasses

import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from neurosym_jax.data import Format, register_format
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.evaluation import register_metric
from neurosym_jax.forecasting import Forecaster, register_forecaster
from neurosym_jax.models import Pooling, register_pooling
from neurosym_jax.symbolic import register_weighting


@register_metric("reach", "reach")
def reach(forecast, scene):
    return jnp.abs(forecast[..., -1, :]).max(axis=(0, -1))


class Standing(Forecaster):
    title = "standing"

    def forecast(self, params, scene, noise):
        return jnp.repeat(jnp.asarray(scene.observed)[None, :, -1:], self.pred_len, axis=2)


register_forecaster("standing", Standing)


class MeanNetwork(nn.Module):
    width: int

    @nn.compact
    def __call__(self, hidden, valid, alpha):
        weight = alpha[..., -1] * valid
        mean = weight @ hidden / jnp.maximum(weight.sum(axis=1, keepdims=True), 1)
        return nn.Dense(self.width)(mean)


@register_pooling("mean")
@dataclasses.dataclass(frozen=True)
class Mean(Pooling):
    title = "Mean of neighbours"
    inputs = frozenset({"hidden", "alpha"})
    bottleneck_dim: int = 8

    def network(self, h_dim, *, obs_len, embedding_dim):
        return MeanNetwork(self.bottleneck_dim)


@register_weighting("halves")
def halves(positions, valid):
    return jnp.full((len(positions), *positions.shape[:2]), 0.5)


@register_format("barred")
class Barred(Format):
    title = "rows between bars"

    def knows(self, head):
        return head.first[:1] == "|"

    def read(self, path, options, period):
        rows = np.array([line.split("|")[1:] for line in path.read_text().splitlines()], float)
        return [make_tracks(path.stem, rows[:, 0] * period, rows[:, 1].astype(int), rows[:, 2:])]
"""


COMMANDS = """
import json
import sys
from neurosym_jax.__main__ import main
for command in json.loads(sys.argv[1]):
    try:
        main(command)
    except SystemExit as end:
        assert not end.code
    print("\\f")
"""


@pytest.fixture
def call(tmp_path):
    """Runs commands with the plugin, one after the other in one process; what each prints."""
    (tmp_path / "mine.py").write_text(PLUGIN)

    def run(*commands: tuple[object, ...]) -> list[str]:
        lines = [[*map(str, command), "--plugin", "mine.py"] for command in commands]
        done = subprocess.run(
            [sys.executable, "-c", COMMANDS, json.dumps(lines)],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.split("\f")[:-1]

    return run


@pytest.mark.slow
def test_every_seam_from_one_file(call, tmp_path):
    rng = np.random.default_rng(0)
    walks = rng.normal(0, 2, (3, 1, 2)) + np.arange(40)[:, None] * rng.normal(0, 0.4, (3, 1, 2))
    rows = [(n, id, *walks[id, n]) for n in range(40) for id in range(3)]
    data = tmp_path / "walks.txt"
    data.write_text("".join("|" + "|".join(map(str, row)) + "\n" for row in rows))
    (tmp_path / "out").mkdir()

    sweep = ("sweep", "--models", "none", "mean", "--weightings", "halves", "--out", "sweep")
    sweep += ("--datasets", "cross-path", "--seeds", 0, "--steps", 1, "--jobs", 1)
    model = ("sweep/neurosym_mean_halves_cross-path_8_8_seed0/model",)
    evaluate = ("evaluate", "--data", data, "--checkpoint", *model, "--samples", 2)
    _, reported, printed, replayed, shown = call(
        (*sweep, "--set", "batch_scenes=2", "best_k=1", "max_agents=4"),
        ("report", "sweep", "--against", "SGAN, no pooling"),
        (*evaluate, "--no-figures", "--baselines", "standing", "--json", "rows.json"),
        ("replay", data, "--model", *model, "--samples", 2),
        ("symbols", data, "--model", *model, "--out", "out"),
    )
    assert "| plugins | mine.py |" in (tmp_path / model[0] / "README.md").read_text()
    assert "halves" in reported
    for seen in ("reach", "standing", "Mean of neighbours, halves", "walks"):
        assert seen in printed
    standing, ours = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert standing["model"] == "standing"
    assert ours["reach"] > 0
    assert "reach" in replayed
    assert "Mean of neighbours" in replayed
    assert "weighting halves" in shown
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"pairs.png"}


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
