"""Errors of an evaluation as a user calls it."""

import numpy as np
import polars as pl
import pytest

import neurosym_jax as nj


def test_means_are_of_people_and_not_of_scenes():
    """Three people go straight on; of two, one stops when the forecast begins."""
    steps = np.clip(np.arange(16), 0, [[7], *[[15]] * 4])
    x, y = 0.4 * steps, 2.0 * np.arange(5)[:, None] + 0 * steps
    frames = [
        pl.DataFrame(
            {"frame": np.tile(10 * np.arange(16), len(who)), "id": np.repeat(who, 16)}
            | {"x": x[who].ravel(), "y": y[who].ravel()}
        )
        for who in ([0, 1], [2, 3, 4])
    ]
    model = nj.load_model("anchors_zara1_8")
    found = nj.evaluate(model, frames, baselines=("constant_velocity",), yes_really=True)
    row = found.row(0, named=True)
    assert (row["model"], row["scenes"], row["agents"]) == ("constant velocity", 2, 5)
    # 0.4 m to 3.2 m behind are 1.8 m in the mean; by scenes it would be 1.8 / 2 / 2.
    assert row["joint_ade"] == pytest.approx(1.8 / 5, abs=1e-5)
    assert row["joint_fde"] == pytest.approx(3.2 / 5, abs=1e-5)
