"""The other side of `test_ros2.py`, in the Python of ROS 2: a tracker, and who hears forecasts.

    python rclpy_peer.py FRAMES SECONDS TOPIC

publishes the frames of a JSON file `[[stamp, [[x, y], ...], active], ...]`, one every
SECONDS on TOPIC, once our node is there, and prints what it hears as a JSON object. The
node `/mine` is activated and deactivated as the frames say. On a busy machine frames go
out more slowly: at most `AHEAD` of them wait for the node's answer.
"""

import json
import math
import sys
import time

import rclpy
from geometry_msgs.msg import Pose, PoseArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from visualization_msgs.msg import MarkerArray

MARKERS = "/hri/human_poses_prediction/markers"
AHEAD = 8
"""Frames that may be newer than the newest markers: half of what the node keeps unthinned."""
PATIENCE = 60.0
"""Seconds to wait for an answer; without one, the remaining frames wait for none."""


def main() -> None:
    """Publish, listen, print."""
    with open(sys.argv[1]) as file:
        frames = json.load(file)
    rclpy.init()
    node = rclpy.create_node("peer")
    heard: list[dict] = []

    def hear(message: MarkerArray) -> None:
        stamp = message.markers[0].header.stamp
        markers = [as_json(marker) for marker in message.markers]
        heard.append({"stamp": stamp.sec + 1e-9 * stamp.nanosec, "markers": markers})

    node.create_subscription(MarkerArray, MARKERS, hear, 100)
    people = node.create_publisher(PoseArray, sys.argv[3], 100)
    wait(
        node,
        300,
        lambda: people.get_subscription_count() and node.count_publishers(MARKERS),
    )
    # We know of the other side before it knows of us, and best effort sends nothing
    # again.
    wait(node, 1.0, lambda: False)
    change = node.create_client(ChangeState, "/mine/change_state")

    def turn(transition: int) -> None:
        wait(node, 0.5, lambda: False)
        done = change.call_async(
            ChangeState.Request(transition=Transition(id=transition))
        )
        wait(node, 30, done.done)
        assert done.result().success

    turn(Transition.TRANSITION_CONFIGURE)
    active_stamps: list[float] = []
    answers_come = True

    def wait_for_answers(ahead: int) -> None:
        nonlocal answers_come

        def is_answered() -> bool:
            newest = max((row["stamp"] for row in heard), default=-math.inf)
            return sum(stamp > newest + 1e-3 for stamp in active_stamps) <= ahead

        if answers_come:
            wait(node, PATIENCE, is_answered)
            answers_come = is_answered()

    was_active = False
    for stamp, positions, active in frames:
        if active != was_active:
            wait_for_answers(0)
            turn(
                Transition.TRANSITION_ACTIVATE
                if active
                else Transition.TRANSITION_DEACTIVATE
            )
        was_active = active
        people.publish(poses(stamp, positions))
        if active:
            active_stamps.append(stamp)
        wait(node, float(sys.argv[2]), lambda: False)
        wait_for_answers(AHEAD)
    wait_for_answers(0)
    print(json.dumps(heard))
    rclpy.shutdown()


def as_json(marker) -> dict:
    """What is tested of a marker."""
    return {
        "ns": marker.ns,
        "type": marker.type,
        "frame_id": marker.header.frame_id,
        "points": [[point.x, point.y] for point in marker.points],
    }


def poses(stamp: float, positions: list) -> PoseArray:
    """The message of a tracker."""
    message = PoseArray()
    message.header.frame_id = "odom"
    seconds, nanoseconds = divmod(round(stamp * 1e9), 10**9)
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
    for x, y in positions:
        pose = Pose()
        pose.position.x, pose.position.y = x, y
        message.poses.append(pose)
    return message


def wait(node, seconds: float, done) -> None:
    """Spin until `done`, or so long."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and not done():
        rclpy.spin_once(node, timeout_sec=max(0.0, min(0.1, end - time.monotonic())))


if __name__ == "__main__":
    main()
