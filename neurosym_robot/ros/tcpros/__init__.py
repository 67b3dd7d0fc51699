"""A ROS 1 client in pure Python: the master's and the slaves' XML-RPC, and topics over TCPROS.

It needs neither rospy nor a ROS installation, because the Python of a robot's ROS 1 is older than
the one JAX needs. Services, parameters, actions and UDPROS are not here.
"""

from neurosym_robot.ros.tcpros.names import Topic, node_name
from neurosym_robot.ros.tcpros.node import Node

__all__ = ["Node", "Topic", "node_name"]
