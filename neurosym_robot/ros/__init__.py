"""People and forecasts as ROS messages: bags, a ROS 1 client of our own, a ROS 2 node."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
