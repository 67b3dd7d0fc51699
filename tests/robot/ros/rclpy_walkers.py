"""The other side of `test_pages.py`, in the Python of ROS 2: two people walk, and topics are heard.

    python rclpy_walkers.py TOPIC HEARD=TYPE ...

publishes a PoseArray on TOPIC ten times a second, and prints `heard TOPIC` once for each
topic on which a message came.
"""

import functools
import importlib
import sys
import time

import rclpy
from geometry_msgs.msg import Pose, PoseArray


def main() -> None:
    """Publish and listen until all topics were heard."""
    topic, *texts = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node("walkers")
    waiting = set()

    def hear(name: str, message) -> None:
        if name in waiting:
            waiting.remove(name)
            print("heard", name, flush=True)

    for text in texts:
        name, _, kind = text.partition("=")
        package, _, word = kind.split("/")
        form = getattr(importlib.import_module(f"{package}.msg"), word)
        waiting.add(name)
        node.create_subscription(form, name, functools.partial(hear, name), 10)
    publisher = node.create_publisher(PoseArray, topic, 10)
    start = time.time()
    while waiting:
        now = time.time()
        message = PoseArray()
        message.header.frame_id = "odom"
        message.header.stamp = node.get_clock().now().to_msg()
        for y in (1.0, 2.0):
            pose = Pose()
            pose.position.x, pose.position.y = now - start, y
            message.poses.append(pose)
        publisher.publish(message)
        end = now + 0.1
        while time.time() < end:
            rclpy.spin_once(node, timeout_sec=max(0.0, end - time.time()))


main()
