"""Comparing weightings: what is said before the first training."""

import numpy as np
import polars as pl
import pytest

from neurosym_jax.commands.compare_weightings import (
    SPREAD,
    Options,
    expected_power,
    run,
)
from tests.repository import ROOT


def test_the_power_of_seeds_is_that_of_our_study(tmp_path, capsys):
    """Half of an interval of as many of its 24 seeds."""
    study = pl.read_csv(ROOT / "docs/weighting.csv")
    for place, spread in SPREAD.items():
        rows = study.filter(set=place, metric="all joint_ade").sort("seed")
        weighted = rows.filter(arm="papers, quantised")["value"].to_numpy()
        ones = rows.filter(arm="papers")["value"].to_numpy()
        differences = 100 * (weighted - ones) / ones.mean()
        assert len(differences) == 24
        assert np.std(differences, ddof=1) == pytest.approx(spread, abs=0.05)
    options = Options(dataset=("cross-path",), out=tmp_path, steps=3, dry_run=True)
    assert run(options) == 0
    line = capsys.readouterr().err
    assert line.startswith("8 seeds told differences in joint ADE of 0.8 % (zara2)")
    assert "and 3.1 % (corridors)" in line
    assert expected_power(2).startswith("Fewer than 3 seeds tell nothing")
