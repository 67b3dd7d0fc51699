"""How many files of the package run for an evaluation, and for a pair's weight in pooling."""

import itertools
import json

import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.models import Generator
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.weighting import make_weighting
from tests.following import followed
from tests.repository import ROOT, run_python

EVALUATION_FILES, POOLING_FILES = 30, 6
"""What docs/architecture.md draws."""
EVALUATION = """
import json
import sys
from pathlib import Path

import neurosym_jax as nj
from tests.following import followed

with followed() as files:
    nj.evaluate(nj.load_model("sgan_zara1_8"), nj.data.read_any(Path("walk.txt")), samples=2)
print(json.dumps([sorted(files), sorted(sys.modules)]))
"""


@pytest.mark.slow
def test_an_evaluation_runs_code_of_few_files(tmp_path):
    rows = [
        f"{10 * t} {who} {0.4 * t} {who}"
        for t, who in itertools.product(range(20), (0, 1))
    ]
    (tmp_path / "walk.txt").write_text("\n".join(rows))
    done = run_python("-c", EVALUATION, cwd=tmp_path, PYTHONPATH=str(ROOT))
    files, modules = json.loads(done.stdout.splitlines()[-1])
    assert len(files) <= EVALUATION_FILES, files
    # An installed package's plugin is imported to ask whether it knows the file, and
    # nothing else.
    robot = {name for name in modules if name.startswith("neurosym_robot.")}
    assert robot <= {
        f"neurosym_robot.{name}" for name in ("plugin", "ros", "ros.definitions")
    }
    others = ("neurosym_jax.simulation", "rosbags", "rclpy", "rospy")
    assert not [name for name in modules if name.startswith(others)]


def test_a_pair_is_weighted_and_pooled_by_few_files():
    model = nj.load_model("neurosym_simulations_8")
    observed = np.arange(48.0).reshape(3, 8, 2) / 9
    hidden = np.zeros((3, model.config.encoder_h_dim), np.float32)
    with followed() as files:
        scene = make_scene(observed)
        alpha = make_weighting(model.config.weighting)(scene.observed)
        Generator(model.config).apply(model.params, hidden, scene, alpha, method="pool")
    assert "symbolic/qtc.py" in files
    assert len(files) <= POOLING_FILES, files
