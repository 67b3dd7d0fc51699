"""Who may import what in `neurosym_robot`, read from the source as for `neurosym_jax`."""

import os
import shutil
import subprocess
import sys
from importlib.metadata import entry_points

import pytest

from tests.test_architecture import ROOT, imports

PACKAGE = ROOT / "neurosym_robot"
FILES = {path.relative_to(PACKAGE).as_posix(): imports(path) for path in PACKAGE.rglob("*.py")}
ROOMS = {
    "tracking": {"tracking"},
    "online": {"tracking", "online"},
    "dashboard": {"tracking", "online", "dashboard"},
    "ros": {"tracking", "online", "dashboard", "ros"},
}
"""What a room may import of the others; `commands` import all."""
LIBRARIES = {"rclpy": ("ros/", "commands/ros2.py"), "rosbags": ("ros/",), "tyro": ("commands/",)}


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_its_own(room):
    names = {name for file in FILES if file.startswith(f"{room}/") for name, _ in FILES[file]}
    rooms = {name.split(".")[1] for name in names if name.startswith("neurosym_robot.")}
    assert rooms & {*ROOMS, "commands"} <= ROOMS[room]


def test_libraries_have_their_rooms_and_are_imported_on_demand():
    found = [(file, name.split(".")[0], now) for file in FILES for name, now in FILES[file]]
    for library, rooms in LIBRARIES.items():
        assert {
            file for file, name, _ in found if name == library if not file.startswith(rooms)
        } == set()
    assert {
        file for file, name, now in found if now and name in ("rclpy", "rosbags", "rospy")
    } == set()


def test_the_core_joins_it_by_entry_points_alone():
    for entry in entry_points(group="neurosym_jax.plugins").select(name="robot"):
        assert entry.value == "neurosym_robot.plugin"
    commands = {entry.name for entry in entry_points(group="neurosym_jax.commands")}
    files = {path.stem for path in PACKAGE.glob("commands/[a-z]*.py")}
    assert files <= commands, "an entry point is missing, or the package is to be installed anew"


WITHOUT = """
import sys
sys.modules["neurosym_robot"] = None  # As if it were not installed.
import pytest
fast = ("-n0", "-p", "no:cacheprovider", "-m", "not slow and not exhaustive")
sys.exit(pytest.main([*fast, *sys.argv[1:]]))
"""
PLUGGED = ("commands/test_main.py", "data/test_formats.py")
"""Tests of what looks for plugins."""


@pytest.mark.slow
def test_the_core_works_without_this_package(tmp_path):
    ignored = shutil.ignore_patterns("__pycache__", "robot")
    for name in ("neurosym_jax", "tests", "studies"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignored)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, *(f"tests/{name}" for name in PLUGGED)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout
