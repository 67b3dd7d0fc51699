"""Benchmarks run as documented, and no count grows; timings, which are noise, are not tested."""

import functools
import json
from typing import Any

import jax
import numpy as np
import pytest
from flax.traverse_util import flatten_dict

from benchmarks import scaling
from benchmarks.age import ABSENT
from benchmarks.page import document
from neurosym_jax.data.recordings import open_source
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.models import tracking_errors
from neurosym_jax.models.anchors.forecaster import AnchorsForecaster, apply_anchors
from neurosym_jax.models.anchors.network import AnchorConfig
from neurosym_jax.models.anchors.training import (
    AnchorRecipe,
    AnchorStream,
    anchor_loss,
    company,
)
from tests.repository import ROOT, run_python
from tests.robot.ros.ros1_graph import start_graph


@pytest.mark.slow
def test_a_benchmark_and_its_page(tmp_path):
    """The symbols of three implementations agree, or it fails."""
    path, page = tmp_path / "numbers.json", tmp_path / "page.md"
    files = ("--json", path, "--page", page)
    run_python("-m", "benchmarks", "symbols", "--repeats", 1, *files)
    (result,) = json.loads(path.read_text())["benchmarks"].values()
    assert {row["who"] for row in result["rows"]} >= {"neurosym_jax", "plain loop"}
    assert all(0 < row["low"] <= row["median"] <= row["high"] for row in result["rows"])
    text = page.read_text()
    assert text.startswith("# Benchmarks")
    assert "QTC and alpha" in text


AGE = """
import sys
from benchmarks.age import Case, live, ros1

def deaf(stack, hear):
    ros1(stack, hear)
    return lambda frame: None

command = [sys.executable, "-m", "neurosym_jax", "ros1", "--model", "recommended"]
case = Case(2, 10.0, 0.0, "two", 3.0)
live(JOIN, [*command, "--max-people", "8"], "ROS 1", [case])
"""


@pytest.mark.slow
def test_forecasts_are_heard_in_a_graph_or_it_fails(tmp_path, browser):
    """It once listened to topics that had another name, and wrote no row in silence."""
    start_graph(tmp_path).close()  # skips without ROS 1
    rows = run_python("-c", AGE.replace("JOIN", "ros1")).stdout
    alone, with_page = map(json.loads, rows.splitlines())
    for row in (alone, with_page):
        assert row["answered"] > 0.9
        assert 0 < row["median"] < 1
    assert with_page["drawn"] > 5

    failed = run_python("-c", AGE.replace("JOIN", "deaf"), check=False)
    assert failed.returncode not in (0, ABSENT)
    assert "no forecast was heard" in failed.stderr


def test_the_page_is_what_its_numbers_give_and_names_their_commits():
    numbers = json.loads((ROOT / "docs/benchmarks.json").read_text())["benchmarks"]
    text = document(numbers)
    assert text == (ROOT / "studies/pages/benchmarks.md").read_text()
    for name, benchmark in numbers.items():
        assert benchmark["machine"]["commit"][:8] in text, name


def test_the_page_of_a_series_has_its_exponent_and_the_most_memory():
    found = [
        (10, {"values": [0.1], "peak_mb": 2400}),
        (1000, {"values": [10.0], "peak_mb": 800}),
    ]
    machine = {"cores": 2, "cpu": "x", "python": "3", "jax": "0", "platform": "cpu"}
    rows = scaling._rows("people", found)
    text = document({"scaling": {"rows": rows, "machine": machine}})
    assert "| people | 10: 100 ms, 1,000: 10 s | 1.0 | 2.4 GB |" in text
    assert "commit of the code that was timed is not recorded" in text


@pytest.mark.exhaustive
def test_no_count_of_programs_flops_or_bytes_has_grown():
    printed = run_python("-m", "benchmarks.counts").stdout
    report = json.loads(printed[printed.rindex("{") :])
    baseline = json.loads((ROOT / "benchmarks/baseline.json").read_text())
    assert report.keys() == baseline.keys()
    # A hundredth, because versions of jax write the same arithmetic a little
    # differently.
    grown = {
        name: report[name] for name in report if report[name] > 1.01 * baseline[name]
    }
    assert not grown, (
        f"was {baseline}; if it must be: python -m benchmarks.counts --write"
    )


@pytest.mark.exhaustive  # A minute, for a peer that hardly changes.
def test_torch_has_the_numbers_of_anchors(monkeypatch):
    """The opponent computes what it is timed for: loss and gradient are ours, in crowds of ten."""
    # Torch's have neither a limit of displacements nor a guard against tracking errors.
    monkeypatch.setattr(tracking_errors, "TOP_SPEED", 1e3)
    for name in ("FAST", "TOP_CHANGE", "FAST_CHANGE"):
        monkeypatch.setattr(tracking_errors, name, 1e3)
    torch = pytest.importorskip("torch", reason="torch is not installed")
    from benchmarks.torch_anchors import TorchAnchors

    windows = cut_windows(open_source(None).recordings("cross-path", "train"), 8, 8)
    network, recipe = AnchorConfig(), AnchorRecipe()
    params = AnchorsForecaster(network).init(jax.random.key(0))
    scenes, crowd = batch = AnchorStream(windows, recipe).batch(2)
    crowded = company(scenes.valid, crowd)

    def loss(params):
        apply = functools.partial(apply_anchors, network, params)
        forecast = jax.vmap(apply)(scenes.replace(future=None), crowded)
        return anchor_loss(forecast, scenes.future, scenes.valid, crowd, recipe)

    value, gradient = jax.value_and_grad(loss)(params)
    peer = TorchAnchors(network, recipe, params, batch)
    total = peer.loss()
    total.backward()
    np.testing.assert_allclose(total.item(), value, rtol=1e-6)
    gradients: Any = flatten_dict(gradient["params"], sep="")
    assert set(gradients) == set(peer.weight)
    for name, array in gradients.items():
        found = torch.atleast_1d(peer.weight[name].grad).numpy()
        found = found.T if name.endswith("kernel") else found
        np.testing.assert_allclose(found, array, atol=1e-4 * np.abs(array).max())
