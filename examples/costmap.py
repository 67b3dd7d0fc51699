"""People's forecasts as a costmap: the probability that a person will be in a cell.

python examples/costmap.py FORECASTS.bag COSTMAP.bag    of a bag that `neurosym replay --out` wrote
python examples/costmap.py ros1|ros2 [SAMPLES-TOPIC]    on a robot, beside its node

Needs numpy and, on a robot, its own ROS with `ros/neurosym_msgs` built; JAX is not
needed there.
"""

# pyright: reportMissingImports=false
# ROS has its own installer; where the linters run there is none.

import array
import sys
import time

import numpy as np

TOPIC = "/hri/human_poses_prediction_neurosym/samples"
COSTMAP = "/hri/people_costmap"
CELL = 0.1  # metres
RADIUS = 0.4  # metres, of a person and of what a robot should keep from them
FADE = 4.0  # seconds after which a place counts for 1/e: who comes later may still be let by
WIDEST = 40.0  # metres


def occupancy(futures, weights, period):
    """Per cent [rows, columns] that a cell is taken, and the corner [2] of its first, in metres.

    `futures` [K, N, T, 2] are samples of positions, T = 0 now, and `weights` [K] sum to
    one. At a moment a person is in a cell with the share of the samples that have them
    within `RADIUS` of it, and somebody is unless all are not; of all moments the worst
    counts, later ones for less.
    """
    samples, people, steps = futures.shape[:3]
    middle = np.median(futures[:, :, 0], axis=(0, 1))
    near = np.clip(futures, middle - WIDEST / 2, middle + WIDEST / 2)
    corner = np.floor((near.min(axis=(0, 1, 2)) - RADIUS) / CELL) * CELL
    columns, rows = (
        np.ceil((near.max(axis=(0, 1, 2)) + RADIUS - corner) / CELL).astype(int) + 1
    )
    reach = int(RADIUS / CELL)
    disc = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    disc = disc[:, np.hypot(*disc) * CELL <= RADIUS]  # [2, D] rows and columns
    worst = np.zeros(rows * columns)
    share = np.repeat(np.repeat(weights, people), disc.shape[1])
    who = np.repeat(np.tile(np.arange(people), samples), disc.shape[1])
    for step in range(steps):
        x, y = (((futures[:, :, step] - corner) / CELL).reshape(-1, 2).astype(int)).T
        row, column = (y[:, None] + disc[0]).ravel(), (x[:, None] + disc[1]).ravel()
        inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
        cell = (who * rows + row) * columns + column
        size = people * rows * columns
        probability = np.bincount(cell[inside], share[inside], size).reshape(people, -1)
        somebody = 1 - np.prod(1 - np.minimum(probability, 1), axis=0)
        worst = np.maximum(worst, somebody * np.exp(-step * period / FADE))
    return np.rint(100 * worst).astype(np.int8).reshape(rows, columns), corner


def fill(grid, forecast):
    """Write a neurosym_msgs/Forecast into an empty nav_msgs/OccupancyGrid; whether there is any."""
    if not len(forecast.ids):
        return False
    place = np.reshape(forecast.position, (-1, 2))
    shape = (forecast.samples, len(place), forecast.steps, 2)
    ahead = place[:, None] + np.reshape(forecast.futures, shape)
    now = np.broadcast_to(place[:, None], (shape[0], len(place), 1, 2))
    per_cent, corner = occupancy(
        np.concatenate([now, ahead], axis=2),
        np.asarray(forecast.weights, float),
        forecast.period,
    )
    grid.header.stamp, grid.header.frame_id = (
        forecast.header.stamp,
        forecast.header.frame_id,
    )
    grid.info.resolution = CELL
    grid.info.height, grid.info.width = per_cent.shape
    grid.info.origin.position.x, grid.info.origin.position.y = map(float, corner)
    grid.info.origin.orientation.w = 1.0
    grid.data = per_cent.ravel()
    return True


def of_bag(source, target):
    """Every forecast of a bag as a costmap in another; milliseconds that each took."""
    from neurosym_robot.ros.bags import BagWriter, read_messages

    took = []
    with BagWriter(target) as bag:
        for topic, forecast in read_messages(source):
            start, grid = time.perf_counter(), bag.new("nav_msgs/msg/OccupancyGrid")
            if topic == TOPIC and fill(grid, forecast):
                took.append(1e3 * (time.perf_counter() - start))
                stamp = forecast.header.stamp
                bag.write(COSTMAP, stamp.sec + 1e-9 * stamp.nanosec, grid)
    return took


def on_ros1(topic):
    """Until the node is stopped; with the robot's own Python."""
    import rospy
    from nav_msgs.msg import OccupancyGrid
    from neurosym_msgs.msg import Forecast

    def hear(forecast):
        grid = OccupancyGrid()
        if fill(grid, forecast):
            grid.data = grid.data.tolist()
            publisher.publish(grid)

    rospy.init_node("people_costmap")
    publisher = rospy.Publisher(COSTMAP, OccupancyGrid, queue_size=1)
    rospy.Subscriber(topic, Forecast, hear, queue_size=1)
    rospy.spin()


def on_ros2(topic):
    """Until the node is stopped."""
    import rclpy
    from nav_msgs.msg import OccupancyGrid
    from neurosym_msgs.msg import Forecast

    def hear(forecast):
        grid = OccupancyGrid()
        if fill(grid, forecast):
            grid.data = array.array("b", grid.data.tobytes())
            publisher.publish(grid)

    rclpy.init()
    node = rclpy.create_node("people_costmap")
    publisher = node.create_publisher(OccupancyGrid, COSTMAP, 1)
    node.create_subscription(Forecast, topic, hear, 1)
    rclpy.spin(node)


if __name__ == "__main__":
    first, *paths = sys.argv[1:]
    if first in ("ros1", "ros2"):
        {"ros1": on_ros1, "ros2": on_ros2}[first](*paths or [TOPIC])
    else:
        from pathlib import Path

        took = of_bag(Path(first), Path(paths[0]))
        print(
            f"{len(took)} costmaps, {np.median(took):.1f} ms in the median, {max(took):.1f} at most"
        )
