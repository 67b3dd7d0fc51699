"""A ROS 1 node without ROS."""

import contextlib
from typing import Any

import pytest

from neurosym_robot.online.predictor import Predictor
from neurosym_robot.ros.tcpros.wire import SlaveServer


@pytest.fixture
def forecast_node(model):
    """`forecast_node(**options)` is our node, with a master that knows nobody."""
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    from neurosym_robot.ros.ros1 import ForecastNode

    with contextlib.ExitStack() as stack:

        def make(**options: Any) -> ForecastNode:
            master = SlaveServer("127.0.0.1", {})
            stack.callback(master.close)
            uri = f"http://127.0.0.1:{master.server_address[1]}"
            predictor = Predictor({"SGAN": model()}, samples=2, max_people=4)
            node = ForecastNode(predictor, master=uri, **options)
            stack.callback(node.close)
            return node

        yield make
