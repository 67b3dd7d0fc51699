"""People and forecasts as ROS messages: bags, a ROS 1 client of our own, a ROS 2 node."""
