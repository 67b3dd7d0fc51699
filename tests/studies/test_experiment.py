"""The experiment's numbers are those of its recordings, and its report is whole."""

import dataclasses
import json

import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_robot.online.predictor import ModelForecast
from neurosym_robot.ros.bags import read_people
from studies.experiment import __main__ as of
from studies.experiment.results import score
from tests.robot.forecasts import made_forecast

pytest.importorskip("rosbags", reason="rosbags is not installed")


@pytest.mark.exhaustive
def test_the_whole_experiment(tmp_path):
    out = tmp_path / "report"
    of.experiment(out, seconds=16.0, samples=3, models=("sgan_eth_8", "neurosym_eth_8"))
    text = (out / "experiment.md").read_text()
    for part in (
        "`sgan_eth_8` and `neurosym_eth_8`",
        "IDF1 from",
        "16.32",
        "| A 1 | SGAN |",
        "## Scenario B",
    ):
        assert part in text
    images = sorted((out / "figures").glob("*.png"))
    assert len(images) == text.count("](figures/") == 6
    data = json.loads((out / "experiment.json").read_text())
    recordings = {recording["bag"]: recording for recording in data["recordings"]}
    assert recordings.keys() == {bag.name for bag in (out / "recordings").iterdir()}
    for bag, recording in recordings.items():
        assert len(list(read_people(out / "recordings" / bag))) > 150
        raw, mended = recording["idf1"]
        assert raw <= mended
        for name in ("SGAN", "NeuroSyM"):
            score, running = (
                recording["scores"][name],
                recording["analytics"]["models"][name],
            )
            assert 5 < score["sequences"] <= running["forecasts"]
            assert score["best_ade"] <= score["ade"] < 2
            assert score["sum_ade"] == pytest.approx(score["ade"] * 16)
            assert score["sum_fde"] == pytest.approx(score["fde"] * 2)
            if score["sequences"] * 2 == running["people"]:
                assert score["best_ade"] == pytest.approx(running["joint_ade"])
    with pytest.raises(InputError, match="already there"):
        of.experiment(out)


def test_scores_by_hand():
    steps = np.arange(1, 17)[:, None] * np.array([0.4, 0.0])
    walk = np.stack([steps, steps + np.array([0.0, 3.0])])
    future = walk[:, 8:]
    samples = np.stack([future + np.array([0.0, shift]) for shift in (1.0, 2.0)])
    models = {"m": ModelForecast(samples, samples.mean(axis=0), 1)}
    ids, seen = np.array([1, 2]), np.zeros(2, int)
    forecast = made_forecast(
        walk[:, :8], models, index=7, ids=ids, extrapolated=seen, future=future
    )
    lonely = dataclasses.replace(forecast, index=8, future=np.full_like(future, np.nan))
    scores = score([forecast, lonely], "m")
    assert scores.sequences == 1
    errors = (
        scores.ade,
        scores.fde,
        scores.best_ade,
        scores.best_fde,
        scores.sum_ade,
        scores.sum_fde,
    )
    assert errors == pytest.approx((2.0, 2.0, 1.0, 1.0, 32.0, 4.0))
    assert score([forecast], None).fde == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(InputError, match="too short"):
        score([lonely], "m")
