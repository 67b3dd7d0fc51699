"""Who may import what in `neurosym_robot`, read from the source as for `neurosym_jax`."""

from importlib.metadata import entry_points

import pytest

from tests.repository import ROOT, run_python
from tests.test_architecture import imports_below

PACKAGE = ROOT / "neurosym_robot"
PACKAGES = {
    "tracking": {"tracking"},
    "input": {"tracking", "input"},
    "online": {"tracking", "input", "online"},
    "dashboard": {"tracking", "online", "dashboard"},
    "ros": {"tracking", "input", "online", "dashboard", "ros"},
}
"""What a package may import of the others, beside `ros.definitions`; `commands` import all."""
LIBRARIES = {
    "rclpy": ("ros/", "commands/ros2.py"),
    "rosbags": ("ros/",),
    "tyro": ("commands/",),
}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_what_it_may(package):
    packages = set()
    for file, name, _ in imports_below(PACKAGE):
        definitions = name.startswith("neurosym_robot.ros.definitions")
        ours = name.startswith("neurosym_robot.") and not definitions
        if ours and file.startswith(f"{package}/"):
            packages.add(name.split(".")[1])
    assert packages & {*PACKAGES, "commands"} <= PACKAGES[package]


def test_libraries_have_their_packages_and_are_imported_on_demand():
    imports = [
        (file, name.split(".")[0], now) for file, name, now in imports_below(PACKAGE)
    ]
    for library, packages in LIBRARIES.items():
        assert {
            file
            for file, name, _ in imports
            if name == library
            if not file.startswith(packages)
        } == set()
    assert {
        file
        for file, name, now in imports
        if now and name in ("rclpy", "rosbags", "rospy")
    } == set()


def test_the_core_joins_it_by_entry_points_alone():
    for entry in entry_points(group="neurosym_jax.plugins").select(name="robot"):
        assert entry.value == "neurosym_robot.plugin"
    commands = {entry.name for entry in entry_points(group="neurosym_jax.commands")}
    files = {path.stem for path in PACKAGE.glob("commands/[a-z]*.py")}
    assert files <= commands, (
        "an entry point is missing, or the package is to be installed anew"
    )


WITHOUT = """
import sys
sys.modules["neurosym_robot"] = None  # As if it were not installed.
from neurosym_jax.__main__ import main
main()
"""


def test_the_core_works_without_this_package(tmp_path):
    (tmp_path / "walk.txt").write_text("0 1 0 0\n10 1 0.5 0\n20 1 1.1 0\n")
    for words, expected in (
        (["--help"], "evaluate"),
        (["inspect", "walk.txt"], "points 3"),
    ):
        done = run_python("-c", WITHOUT, *words, cwd=tmp_path)
        assert expected in done.stdout
        assert "Traceback" not in done.stderr
