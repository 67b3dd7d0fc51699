"""The same-loss study continues where it ended, and its table says who is ahead."""

import importlib
import itertools
from unittest import mock

import jax
import numpy as np
import polars as pl
import pytest

from neurosym_jax.models.sgan.network import POOLINGS


@pytest.fixture(scope="module")
def study():
    """The study's module; its pooling is registered for these tests alone."""
    with mock.patch.dict(POOLINGS):
        yield importlib.import_module("studies.same_loss")


def test_a_command_does_the_runs_that_its_table_lacks_seed_by_seed(
    study, tmp_path, monkeypatch
):
    done = []

    def train_and_test(run, splits):
        done.append(
            (run.recipe.seed, run.recipe.best_k, type(run.config.pooling).__name__)
        )
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
    for network, factor in {
        "sgan": 1.0,
        "ijcnn": 1.2,
        "ros": 0.9,
        "described": 1.0,
    }.items():
        for seed, step in itertools.product(range(6), study.TESTED):
            error = factor * (0.4 + 0.02 * seed) * (1 + draw.normal(0, 0.01))
            last, slope = step == study.TESTED[-1], 0.97 if network == "ros" else 0.99
            start = ("hotel", "variety", network, seed, step)
            lines.append((*start, "test", "joint_ade", error if last else 9.0))
            lines.append((*start, "val", "joint_ade", slope ** (step / 1000)))
            shut = 2 * np.log(2) if seed < 2 else 1.3
            lines.append((*start, "train", "d_loss", shut))
            near = 0.0 if seed == 2 and network == "sgan" else 0.96
            lines.append((*start, "test", "neighbour_near", near))
    # A seed that not all arms have yet does not count.
    lines.append(
        ("hotel", "variety", "sgan", 6, study.TESTED[-1], "test", "joint_ade", 99.0)
    )
    rows = pl.DataFrame(lines, schema=list(study.HEAD), orient="row")
    table, _, notes = study.report(rows).partition("\n\n")
    cells = dict(line.strip("| ").split(" | ") for line in table.splitlines()[2:])
    means = {name: float(cell.split()[0]) for name, cell in cells.items()}
    assert means["sgan"] == pytest.approx(0.45, abs=0.005)
    assert means["ros"] == pytest.approx(0.9 * 0.45, abs=0.005)
    assert [cells[name].split("(")[1][0] for name in ("ijcnn", "ros")] == ["+", "−"]
    assert [
        cells[name].partition(") ")[2] for name in ("ijcnn", "ros", "described")
    ] == [*("**behind**", "**ahead**", "")]
    assert notes == (
        "Seeds: 6. Curves that are flat: 3 of 4.\n"
        "Networks that ignore neighbours: variety 1 of 24.\n"
        "Discriminators that are shut after 1,000 steps: variety 8."
    )


def test_the_first_release_pools_states_only(study):
    """What it gives everyone is the maximum over all of a perceptron of their states."""
    hidden = np.random.default_rng(0).normal(size=(5, 8)).astype(np.float32)
    valid = np.array([True, True, True, False, True])
    network = study.Zeros(bottleneck_dim=4, hidden_dim=16).network(
        8, obs_len=3, embedding_dim=4
    )
    variables = network.init(jax.random.key(0), hidden, valid)
    pooled = network.apply(variables, hidden, valid)
    first, second = (variables["params"]["mlp"][f"layer_{layer}"] for layer in (0, 1))
    inner = np.maximum(hidden @ first["kernel"][12:] + first["bias"], 0)
    outer = np.maximum(inner @ second["kernel"] + second["bias"], 0)
    np.testing.assert_allclose(
        pooled, np.tile(outer[valid].max(axis=0), (5, 1)), rtol=1e-5
    )
