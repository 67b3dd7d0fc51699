"""Proper scores are those of scoringrules."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.evaluation.test_metrics import scene, score


@pytest.mark.parametrize("weighted", [False, True])
def test_proper_scores_are_those_of_scoringrules(weighted):
    """Its fair estimators of independent draws, and its plain ones of weighted samples."""
    rules = pytest.importorskip("scoringrules", reason="scoringrules is not installed")
    forecast, truth = scene(k=7)
    options: dict[str, Any] = {"estimator": "fair", "backend": "numpy"}
    given = {}
    probability = np.arange(1, 8) / 28
    if weighted:
        options |= {"estimator": "nrg", "ens_w": probability}
        given = {"probability": probability}
    values = score(forecast, truth, metrics=["energy_score", "crps"], **given)
    flat = forecast.reshape(7, -1)
    expected = rules.es_ensemble(truth.ravel(), flat, **options) / np.sqrt(4 * 6)
    assert_allclose(values["energy_score"].mean, expected, rtol=1e-5)
    if weighted:
        options["ens_w"] = np.tile(probability, (flat.shape[1], 1))
    expected = rules.crps_ensemble(truth.ravel(), flat.T, **options).mean()
    assert_allclose(values["crps"].mean, expected, rtol=1e-5)
