"""Rows of several trainings as one."""

import numpy as np
import pytest
from scipy.stats import t

from studies.trainings import of_trainings


def row(checkpoint, ade, half):
    return {
        "checkpoint": checkpoint,
        "model": "SGAN",
        "dataset": "eth",
        "obs_len": 8,
        "pred_len": 12,
        "joint_ade": ade,
        "joint_ade_low": ade - half,
        "joint_ade_high": ade + 2 * half,
        **dict.fromkeys(("collision_rate", "collision_rate_low", "collision_rate_high")),
    }


def test_trainings_are_one_row_whose_interval_is_of_both_scenes_and_trainings():
    alone = row("checkpoints/a_eth_8_12", 0.4, 0.1)
    several = [row(f"runs/a_eth_8_12_seed{n}/model", 0.5 + n / 10, 0.2) for n in range(3)]
    first, second = of_trainings([alone, *several])
    assert (first["trainings"], second["trainings"]) == (1, 3)
    assert first == {**alone, "trainings": 1}
    assert second["checkpoint"] == "runs/a_eth_8_12/model"
    assert second["joint_ade"] == pytest.approx(0.6)
    assert second["collision_rate"] is second["collision_rate_low"] is None
    # Scenes: half of 0.6; trainings: a deviation of 0.1 over the root of 3.
    half = np.hypot(0.3, t.ppf(0.975, 2) * 0.1 / 3**0.5)
    bounds = [second["joint_ade_low"], second["joint_ade_high"]]
    assert bounds == pytest.approx([0.6 - half, 0.6 + half])
