"""The other side of `test_ros2.py`, in the Python of ROS 2: a tracker, and who hears forecasts.

    python rclpy_peer.py FRAMES SECONDS TOPIC

publishes the frames of a JSON file `[[stamp, [[x, y], ...]], ...]`, one every SECONDS on
TOPIC, once our node is there, and prints what it hears as a JSON object.
"""

import json
import sys
import time

import rclpy
from geometry_msgs.msg import Pose, PoseArray
from visualization_msgs.msg import MarkerArray

FORECAST, TRUTH = "/hri/human_poses_prediction_neurosym", "/hri/human_poses_gt"


def main() -> None:
    """Publish, listen, print."""
    with open(sys.argv[1]) as file:
        frames = json.load(file)
    rclpy.init()
    node = rclpy.create_node("peer")
    heard: list[dict] = []
    markers: list[dict] = []

    def hear(message: PoseArray) -> None:
        heard.append(
            {
                "stamp": message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec,
                "frame_id": message.header.frame_id,
                "xy": [[pose.position.x, pose.position.y] for pose in message.poses],
                "zw": [[pose.orientation.z, pose.orientation.w] for pose in message.poses],
            }
        )

    def mark(message: MarkerArray) -> None:
        for marker in message.markers:
            points = [[point.x, point.y] for point in marker.points]
            markers.append({"ns": marker.ns, "type": marker.type, "points": points})

    node.create_subscription(PoseArray, FORECAST, hear, 100)
    node.create_subscription(MarkerArray, FORECAST + "/markers", mark, 100)
    truth: list[PoseArray] = []
    node.create_subscription(PoseArray, TRUTH, truth.append, 100)
    people = node.create_publisher(PoseArray, sys.argv[3], 100)
    wait(node, 60, lambda: people.get_subscription_count() and node.count_publishers(FORECAST))
    # We know of the other side before it knows of us, and best effort sends nothing again.
    wait(node, 1.0, lambda: False)
    for stamp, positions in frames:
        message = PoseArray()
        message.header.frame_id = "odom"
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
        for x, y in positions:
            pose = Pose()
            pose.position.x, pose.position.y = x, y
            message.poses.append(pose)
        people.publish(message)
        wait(node, float(sys.argv[2]), lambda: False)
    wait(node, 1.0, lambda: False)
    print(json.dumps({"forecasts": heard, "markers": markers, "truth": len(truth)}))
    rclpy.shutdown()


def wait(node, seconds: float, done) -> None:
    """Spin until `done`, or so long."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and not done():
        rclpy.spin_once(node, timeout_sec=max(0.0, min(0.1, end - time.monotonic())))


if __name__ == "__main__":
    main()
