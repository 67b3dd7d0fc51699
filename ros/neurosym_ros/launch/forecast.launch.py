"""ROS 2: tracker -> inference -> view.

ros2 launch neurosym_ros forecast.launch.py model:=/path/to/a/model
people:=/my_tracker/people
"""

from pathlib import Path

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

HERE = Path(__file__).resolve().parents[1]
ARGUMENTS = {
    "model": None,
    "people": "/people_tracker/people",
    "message": "People",
    "fixed_frame": "",
    "robot_frame": "",
    "parameters": str(HERE / "config" / "forecast.yaml"),
    "name": "neurosym_jax",
    "rviz": "false",
}
OPTIONS = ("message", "fixed_frame", "robot_frame")


def nodes(context):
    """The node with its parameters, and RViz."""
    asked = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    parameters = yaml.safe_load(Path(asked["parameters"]).read_text())
    own = {name: asked[name] for name in OPTIONS if asked[name]}
    own["model"] = asked["model"].split(",")
    return [
        Node(
            package="neurosym_ros",
            executable="forecast",
            name=asked["name"],
            output="screen",
            parameters=[{**parameters, **own}],
            remappings=[("/people_tracker/people", asked["people"])],
        ),
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", str(HERE / "rviz" / "forecast2.rviz")],
            condition=IfCondition(LaunchConfiguration("rviz")),
        ),
    ]


def generate_launch_description():
    """What `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=value)
        for name, value in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
