"""A ROS 1 client in pure Python: the master's and the slaves' XML-RPC, and topics over TCPROS.

It needs neither rospy nor a ROS installation, because the Python of a robot's ROS 1 is
older than the one JAX needs. Services, parameters, actions and UDPROS are not here.
"""

from neurosym_robot.ros.tcpros.node import Node, master_uri, node_name
from neurosym_robot.ros.tcpros.wire import CallError, Refused, Topic, call

__all__ = ["CallError", "Node", "Refused", "Topic", "call", "master_uri", "node_name"]
