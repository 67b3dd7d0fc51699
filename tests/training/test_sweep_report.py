import itertools
import json

import numpy as np
import polars as pl
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.evaluation.report import write_report as write_rows
from neurosym_jax.training.sweep_report import write_errors, write_report

METRICS = ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde")
BETTER = {"SGAN": 0.0, "NeuroSyM, ones": 0.01, "NeuroSyM, cnd": 0.1}


@pytest.fixture
def folder(tmp_path):
    """A sweep of three models of which one is 9 cm better than the others, on two test sets."""
    draw = np.random.default_rng(0)
    rows, errors = [], []
    about = {"blocks": 4, "obs_len": 8, "pred_len": 8, "samples": 20, "seeds": 1}
    about |= {"latency": 0.001, "forecasts_per_second": 1000.0}
    cases = itertools.product(BETTER, (("eth", 70), ("zara1", 160)), range(3))
    for model, (scene, count), seed in cases:
        each = 0.5 - BETTER[model] + draw.normal(0, 0.02, (count, 4)) + draw.normal(0, 0.004)
        identity = np.stack([np.zeros(count), np.arange(count)], 1).astype(np.uint32)
        counts = np.full((count, 4), 3.0)
        errors.append(ErrorsByScene(METRICS, each * counts, counts, identity, 16))
        means = zip(METRICS, errors[-1].mean.tolist())
        values = {f"{m}{of}": v for m, v in means for of in ("", "_low", "_high", "_std")}
        row = {"model": model, "dataset": scene, "scenes": count, "agents": 3 * count}
        name = {"checkpoint": f"{model}_{scene}_{seed}", "training_seed": seed}
        rows.append({**about, **row, **values, **name})
    constant = {"model": "constant velocity", "checkpoint": None, "training_seed": None}
    rows.insert(0, {**rows[0], **constant})
    errors.insert(0, errors[0])
    write_rows(tmp_path / "sweep.json", rows, {})
    write_errors(tmp_path, errors)
    return tmp_path


def test_what_is_better_is_called_so(folder):
    write_report(folder, ("ones", "SGAN"), out=folder / "ablation.md")
    text = (folder / "ablation.md").read_text()
    assert "18 runs, 3 seeds." in text
    assert "nothing of how much" not in text
    _, to_ones, to_sgan = text.split("Difference to ")
    assert "\n| NeuroSyM, cnd | **−0.09" in to_ones
    assert "\n| SGAN | **+0.0" in to_ones
    assert to_sgan.startswith("SGAN, mean over test sets")
    assert "constant velocity" not in text
    rows = pl.read_csv(folder / "ablation.csv")
    assert len(rows) == 2 * 2 * 3 * 4
    row = rows.row(
        by_predicate=(pl.col("reference") == "NeuroSyM, ones")
        & (pl.col("model") == "NeuroSyM, cnd")
        & (pl.col("test_set") == "mean over test sets")
        & (pl.col("metric") == "joint_ade"),
        named=True,
    )
    assert row["difference"] == pytest.approx(-0.09, abs=0.01)
    assert row["low_95"] < -0.09 < row["high_95"] < -0.05
    assert row["seeds"] == 3


def changed(folder, change):
    """Change the rows of the sweep in `folder`."""
    path = folder / "sweep.json"
    data = json.loads(path.read_text())
    for row in data["rows"]:
        change(row)
    path.write_text(json.dumps(data))


@pytest.mark.parametrize(("seeds", "words"), [(1, "One seed tells"), (2, "Two seeds tell")])
def test_two_models_are_compared_and_few_seeds_find_nothing(folder, seeds, words):
    def left(row):
        if row["training_seed"] in (None, *range(seeds, 3)) or row["model"] == "SGAN":
            row["training_seed"] = None

    changed(folder, left)
    text = write_report(folder)
    assert f"{2 * 2 * seeds} runs, {seeds} seed" in text
    assert f"**{words} nothing of how much trainings differ" in text
    assert "\n| NeuroSyM, cnd | −0.09" in text
    assert "| **−" not in text


def test_refusals(folder, tmp_path_factory):
    against_cnd = write_report(folder, against=("cnd",))
    assert "minus NeuroSyM, cnd" in against_cnd
    assert "minus SGAN" not in against_cnd
    with pytest.raises(InputError, match=r"--against names the model .* there are SGAN; NeuroSyM"):
        write_report(folder)
    with pytest.raises(InputError, match="no 'soft' to compare with: there are SGAN; NeuroSyM"):
        write_report(folder, against=("soft",))
    with pytest.raises(InputError, match=r"must end in \.md"):
        write_report(folder, out=folder / "r.txt")
    with pytest.raises(InputError, match=r"sweep\.json"):
        write_report(tmp_path_factory.mktemp("empty"))
    changed(folder, lambda row: row.update(pred_len=8 + 4 * (row["model"] == "SGAN")))
    with pytest.raises(InputError, match=r"\(8, 8\), \(8, 12\).*--pred-len"):
        write_report(folder)
    with pytest.raises(InputError, match="compares two models or more: there are SGAN"):
        write_report(folder, pred_len=12)
