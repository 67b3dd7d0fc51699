"""How much of the package one evaluation needs."""

import json

import pytest

from tests.repository import ROOT, run_python

MOST = 56
"""Files whose code runs for one evaluation."""
EVALUATION = """
import json
import sys
import threading
from pathlib import Path

import neurosym_jax as nj

root, ran = str(Path(nj.__file__).parent), set()


def called(frame, event, _):
    file = frame.f_code.co_filename
    if event == "call" and file.startswith(root) and file not in ran:
        while frame is not None and frame.f_code.co_name != "<module>":
            frame = frame.f_back
        if frame is None or not frame.f_code.co_filename.startswith(root):
            ran.add(file)


threading.setprofile(called)
sys.setprofile(called)
nj.evaluate(nj.load_model("sgan_zara1_8"), nj.data.read_any(Path("walk.txt")), samples=2)
sys.setprofile(None)
print(json.dumps([sorted(file[len(root) + 1 :] for file in ran), sorted(sys.modules)]))
"""


@pytest.mark.slow
def test_an_evaluation_runs_code_of_few_files(tmp_path):
    """A reader has this many files to follow; code that runs while importing is not counted."""
    rows = [f"{10 * t} {who} {0.4 * t} {who}" for t in range(20) for who in (0, 1)]
    (tmp_path / "walk.txt").write_text("\n".join(rows))
    done = run_python("-c", EVALUATION, cwd=tmp_path, PYTHONPATH=str(ROOT))
    files, modules = json.loads(done.stdout.splitlines()[-1])
    assert len(files) <= MOST, files
    # An installed package's plugin is imported to ask whether it knows the file, and nothing else.
    robot = {name for name in modules if name.startswith("neurosym_robot.")}
    assert robot <= {f"neurosym_robot.{name}" for name in ("plugin", "ros", "ros.definitions")}
    others = ("neurosym_jax.simulation", "rosbags", "rclpy", "rospy")
    assert not [name for name in modules if name.startswith(others)]
