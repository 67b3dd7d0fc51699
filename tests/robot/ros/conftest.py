"""A real ROS 2, where there is one."""

import os
import subprocess
import sys
import sysconfig

import pytest

from tests.repository import ROOT

IMPORTS = "import sys, rclpy, nav_msgs.msg, visualization_msgs.msg; print(sys.version_info[:2])"


@pytest.fixture(scope="session")
def ros2() -> tuple[str, dict[str, str]]:
    """Python with ROS 2, and an environment in which it finds us and what we need."""
    python = os.environ.get("NEUROSYM_ROS2", sys.executable)
    outcome = subprocess.run([python, "-c", IMPORTS], capture_output=True, text=True)
    if outcome.returncode:
        pytest.skip(
            f"no ROS 2 in {python} (set NEUROSYM_ROS2): {outcome.stderr.splitlines()[-1]}"
        )
    if outcome.stdout.strip() != str(sys.version_info[:2]):
        pytest.skip(
            f"{python} is another Python than that of these tests: {outcome.stdout.strip()}"
        )
    folders = [
        str(ROOT),
        sysconfig.get_paths()["purelib"],
        os.environ.get("PYTHONPATH", ""),
    ]
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join(filter(None, folders)))
    environment |= {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        # Nobody else's graph.
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
    }
    return python, environment
