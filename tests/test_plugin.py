"""One file of somebody's own adds one of each kind, and each is seen where its kind is seen."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
PLUGIN = """
import dataclasses

import jax.numpy as jnp
import numpy as np
from flax import linen as nn

from neurosym_jax.data.formats import Format, register_format
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.evaluation.metrics import Metric, register_metric
from neurosym_jax.forecasting import Forecaster, register_forecaster
from neurosym_jax.models import register_pooling
from neurosym_jax.symbolic import register_weighting


def reach(forecast, future, valid):
    return (jnp.abs(forecast[..., -1, :]).max(axis=(0, -1)) * valid).sum(), valid.sum()


register_metric(Metric("reach", "reach", "m", reach))


@dataclasses.dataclass(frozen=True)
class Standing(Forecaster):
    def forecast(self, params, scene, noise):
        return jnp.repeat(jnp.asarray(scene.observed)[None, :, -1:], self.pred_len, axis=2)


register_forecaster("standing", lambda config: Standing(config.pred_len))


class Mean(nn.Module):
    config: object
    h_dim: int

    @nn.compact
    def __call__(self, hidden, observed, valid, alpha):
        weight = alpha[..., -1] * valid
        mean = weight @ hidden / jnp.maximum(weight.sum(axis=1, keepdims=True), 1)
        return nn.Dense(self.config.bottleneck_dim)(mean)


register_pooling("mean", Mean, label="Mean of neighbours", symbolic=True)


@register_weighting("halves")
def halves(positions, valid):
    return jnp.full((len(positions), *positions.shape[:2]), 0.5)


def read(path, options, period):
    rows = np.array([line.split("|")[1:] for line in path.read_text().splitlines()], float)
    return [make_tracks(path.stem, rows[:, 0] * period, rows[:, 1].astype(int), rows[:, 2:])]


register_format("barred", Format("rows between bars", lambda head: head.first[:1] == "|", read))
"""


@pytest.fixture
def call(tmp_path):
    """Runs a command with the plugin, in a process of its own."""
    (tmp_path / "mine.py").write_text(PLUGIN)

    def run(*arguments: object) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "neurosym_jax", *map(str, arguments), "--plugin", "mine.py"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    return run


@pytest.mark.slow
def test_every_seam_from_one_file(call, tmp_path):
    rng = np.random.default_rng(0)
    walks = rng.normal(0, 2, (3, 1, 2)) + np.arange(40)[:, None] * rng.normal(0, 0.4, (3, 1, 2))
    rows = [(n, id, *walks[id, n]) for n in range(40) for id in range(3)]
    data = tmp_path / "walks.txt"
    data.write_text("".join("|" + "|".join(map(str, row)) + "\n" for row in rows))

    train = ("train", "--model", "neurosym", "--variant", "mean", "--weighting", "halves")
    call(
        *train, "--steps", 1, "--set", "batch_scenes=2", "best_k=1", "max_agents=4", "--out", "run"
    )
    model = ("run/model",)
    printed = call(
        *("evaluate", "--data", data, "--checkpoint", *model, "--samples", 2, "--no-figures"),
        *("--baselines", "standing", "--json", "rows.json"),
    )
    for seen in ("reach", "standing", "Mean of neighbours, halves", "walks"):
        assert seen in printed
    standing, ours = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert standing["model"] == "standing"
    assert ours["metrics"]["reach"] > 0

    replayed = call("replay", data, "--model", *model, "--samples", 2)
    assert "reach" in replayed
    assert "Mean of neighbours" in replayed
