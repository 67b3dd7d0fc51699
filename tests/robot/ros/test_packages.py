"""The packages in ros/ are what catkin, colcon, roslaunch and RViz read, and say what we say."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from neurosym_robot.commands.ros1 import Options
from neurosym_robot.ros.definitions import definitions

ROS = Path(__file__).resolve().parents[3] / "ros"
PACKAGES = sorted(path.parent for path in ROS.glob("*/package.xml"))


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: path.name)
def test_a_package_is_for_both_ros(package):
    root = ElementTree.parse(package / "package.xml").getroot()
    assert root.findtext("name") == package.name
    assert {each.text for each in root.iter("build_type")} == {"catkin", "ament_cmake"}
    cmake = (package / "CMakeLists.txt").read_text()
    assert re.search(rf"project\({package.name}\b", cmake)
    wanted = {each.text for each in root.iter("depend")}
    assert wanted == {*re.findall(r"^  find_package\((\w+_msgs) REQUIRED\)", cmake, re.MULTILINE)}


def test_the_wheel_and_the_packages_have_the_same_definitions():
    for path in ROS.glob("*/msg/*.msg"):
        assert definitions()[f"{path.parts[-3]}/msg/{path.stem}"] == path.read_text()


def test_parameters_are_options_and_the_views_are_of_our_topics():
    parameters = yaml.safe_load((ROS / "neurosym_ros/config/forecast.yaml").read_text())
    flat = {name for name, value in parameters.items() if not isinstance(value, dict)}
    assert flat <= Options.__dataclass_fields__.keys()
    assert parameters["links"].keys() <= vars(Options(model=()).links).keys()
    for path in (ROS / "neurosym_ros/rviz").iterdir():
        displays = yaml.safe_load(path.read_text())["Visualization Manager"]["Displays"]
        assert sum("/markers" in str(display) for display in displays) == 2
    compile((ROS / "neurosym_ros/launch/forecast.launch.py").read_text(), "launch", "exec")
