"""The same-loss study continues where it ended, and its table says who is ahead."""

import importlib
import itertools
from unittest import mock

import jax
import numpy as np
import polars as pl
import pytest

from neurosym_jax.models.sgan.config import POOLINGS


@pytest.fixture(scope="module")
def study():
    """The study's module; its pooling is registered for these tests alone."""
    with mock.patch.dict(POOLINGS):
        yield importlib.import_module("studies.same_loss")


def test_a_command_does_the_runs_that_its_table_lacks_seed_by_seed(study, tmp_path, monkeypatch):
    done = []

    def train_and_test(run, splits):
        done.append((run.recipe.seed, run.recipe.best_k, type(run.config.pooling).__name__))
        assert set(splits) == {"val", "test"}
        if len(done) == 20:
            raise KeyboardInterrupt
        yield 1000, "test", "joint_ade", 0.5
        yield 2000, "test", "joint_ade", 0.25

    monkeypatch.setattr(study, "SEEDS", range(2))
    monkeypatch.setattr(study, "train_and_test", train_and_test)
    for name in ("cut_windows", "make_batches"):
        monkeypatch.setattr(study, name, mock.Mock())
    table = tmp_path / "runs.csv"
    with pytest.raises(KeyboardInterrupt):
        study.run_all(mock.Mock(), table)
    assert len(pl.read_csv(table)) == 2 * 19
    study.run_all(mock.Mock(), table)
    study.run_all(mock.Mock(), table)

    runs = pl.read_csv(table)
    columns = ["place", "loss", "network", "seed"]
    assert len(runs) == 64
    assert runs[columns].unique().height == 32
    assert [seed for seed, *_ in done] == [0] * 16 + [1] * 17
    assert done[19] == done[20]
    poolings = dict.fromkeys(pooling for *_, pooling in done)
    assert list(poolings) == ["PoolNet", "Zeros", "NeurosymRos", "AsDescribed"]
    assert [k for _, k, _ in done[:4]] == [20, 1, 20, 1]


def test_the_table_says_who_is_ahead_of_sgan(study):
    draw, lines = np.random.default_rng(0), []
    for network, factor in {"sgan": 1.0, "ijcnn": 1.2, "ros": 0.9, "described": 1.0}.items():
        for seed, step in itertools.product(range(6), study.TESTED):
            error = factor * (0.4 + 0.02 * seed) * (1 + draw.normal(0, 0.01))
            last = step == study.TESTED[-1]
            lines.append(("hotel", "variety", network, seed, step, "test", error if last else 9.0))
            lines.append(("hotel", "variety", network, seed, step, "val", 9.0))
    # A seed that not all arms have yet does not count.
    lines.append(("hotel", "variety", "sgan", 6, study.TESTED[-1], "test", 99.0))
    columns = ("place", "loss", "network", "seed", "step", "split", "value")
    rows = pl.DataFrame(lines, schema=columns, orient="row").with_columns(
        metric=pl.lit("joint_ade")
    )
    table = [line.split(" | ") for line in study.report(rows).splitlines()[2:]]
    answers = {network: cells[-1].strip(" |") for _, network, *cells in table}
    assert answers == {"sgan": "", "ijcnn": "**behind**", "ros": "**ahead**", "described": "open"}
    means = {network: float(cells[1]) for _, network, *cells in table}
    assert means["sgan"] == pytest.approx(0.45, abs=0.005)
    assert means["ros"] == pytest.approx(0.9 * 0.45, abs=0.005)
    percent = {network: cells[2] for _, network, *cells in table}
    assert percent["ijcnn"].startswith("+")
    assert percent["ros"].startswith("−")


def test_the_first_release_pools_states_only(study):
    """What it gives everyone is the maximum over all of a perceptron of their states."""
    hidden = np.random.default_rng(0).normal(size=(5, 8)).astype(np.float32)
    valid = np.array([True, True, True, False, True])
    network = study.Zeros(bottleneck_dim=4, hidden_dim=16).network(8, obs_len=3, embedding_dim=4)
    variables = network.init(jax.random.key(0), hidden, valid)
    pooled = network.apply(variables, hidden, valid)
    first, second = (variables["params"]["mlp"][f"layer_{layer}"] for layer in (0, 1))
    inner = np.maximum(hidden @ first["kernel"][12:] + first["bias"], 0)
    outer = np.maximum(inner @ second["kernel"] + second["bias"], 0)
    np.testing.assert_allclose(pooled, np.tile(outer[valid].max(axis=0), (5, 1)), rtol=1e-5)
