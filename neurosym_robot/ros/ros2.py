"""A predictor in a ROS 2 graph, with rclpy, and the parameters that a launch file gives it."""

# pyright: reportMissingImports=false
# ROS 2 has its own installer and is absent where the linters run.

import functools
import importlib
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.ros.definitions import PEOPLE, PEOPLE_TOPICS, TF_TOPICS, typestore
from neurosym_robot.ros.forecasting_node import (
    UNHEARD,
    WAITING,
    ForecastingNode,
    Outlet,
)

OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides")


def import_rclpy() -> Any:
    """The module rclpy; InputError if ROS 2 is not set up."""
    try:
        importlib.import_module("rclpy.logging")  # Some versions of rclpy do not.
        return importlib.import_module("rclpy")
    except ImportError:
        raise InputError(
            "this needs rclpy in the same Python: set up a ROS 2 (Jazzy or later) first"
        ) from None


def message_type(kind: str) -> Any:
    """The class of a message, by its type; InputError if its package is missing."""
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise InputError(f"this ROS 2 has no {package}") from None


def node_parameters(arguments: Sequence[str], name: str) -> dict[str, Any]:
    """Parameters by name, from files and `-p` in the `arguments` after `--ros-args`.

    `name` is the node's, unless the arguments name it. InputError for arguments that
    ROS 2 refuses.
    """
    rclpy = import_rclpy()
    context = rclpy.context.Context()
    try:
        rclpy.init(args=["--ros-args", *arguments], context=context)
        node = rclpy.create_node(
            name, context=context, automatically_declare_parameters_from_overrides=True
        )
        values = {
            key: value.value for key, value in node.get_parameters_by_prefix("").items()
        }
        node.destroy_node()
    except (
        Exception
    ) as error:  # rclpy passes on several kinds of errors of its C library.
        raise InputError(f"--ros-args: {' '.join(str(error).split())}") from None
    finally:
        rclpy.try_shutdown(context=context)
    return {
        key: value
        for key, value in values.items()
        if key.split(".")[0] not in OF_EVERY_NODE
    }


class ForecastNode(ForecastingNode):
    """A predictor in a ROS 2 graph; rclpy must have been initialised. `run` it.

    A lifecycle node: its models are loaded when it is made, and it hears people while
    it is active.
    """

    def __init__(
        self,
        predictor: Predictor,
        *,
        topic: str = PEOPLE_TOPICS[0],
        kind: str = PEOPLE,
        name: str = "neurosym_jax",
        autostart: bool = True,
        **options: Any,
    ):
        """Join the graph; further arguments as of `ForecastingNode`.

        People come on `topic` in messages of the type `kind`, of `kinds.KINDS`, or as the source says;
        InputError if ROS 2 has no such message. Without `autostart`, a lifecycle
        manager activates the node.
        """
        people = message_type(kind)
        from rclpy.lifecycle import LifecycleNode, ManagedEntity
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        self.kind, self.node, self._active = (
            kind,
            LifecycleNode(name),
            threading.Event(),
        )
        report, name = self.node.get_logger().info, self.node.get_fully_qualified_name()
        super().__init__(predictor, typestore(2), report, name=name, **options)
        self._publishers: dict[bytes, str] = {}
        # A best-effort subscription receives from reliable publishers, too.
        quality = QoSProfile(depth=WAITING, reliability=ReliabilityPolicy.BEST_EFFORT)
        listening = self.node.create_subscription(people, topic, self.hear, quality)
        managed = ManagedEntity()
        managed.on_activate = functools.partial(self._turn, self._active.set)
        managed.on_deactivate = functools.partial(self._turn, self._active.clear)
        managed.on_shutdown = functools.partial(self._turn, self.stopped.set)
        self.node.add_managed_entity(managed)
        if autostart:
            self.node.trigger_configure()
            self.node.trigger_activate()
        self.topic = listening.topic_name
        report(f"listening to {self.topic}")

    def run(self) -> None:
        """Forecast until ROS 2 is shut down: it hears in a thread, and this one works."""
        rclpy = import_rclpy()

        def spin() -> None:
            try:
                rclpy.spin(self.node)
            except Exception:  # Of several kinds, where ROS 2 is shut down meanwhile.
                if rclpy.ok():
                    raise
            finally:
                self.stopped.set()

        listening = threading.Thread(target=spin)
        listening.start()
        try:
            super().run()
        finally:
            rclpy.try_shutdown()
            listening.join()

    def close(self) -> None:
        """Leave the graph."""
        self.node.destroy_node()
        import_rclpy().try_shutdown()

    def hear(self, message: Any, info: Mapping[str, Any]) -> None:
        """Let people wait, while the node is active."""
        self._silent_until = None
        if self._active.is_set():
            number = bytes((info.get("publisher_gid") or {}).get("data", b""))
            self.put(self.kind, message, self._publisher(number))

    def _publisher(self, number: bytes) -> str:
        """What reports call a publisher: its node and its number, of which each has its own."""
        if number not in self._publishers:
            for end in self.node.get_publishers_info_by_topic(self.topic):
                name = f"{end.node_namespace}/{end.node_name}".replace("//", "/")
                gid = bytes(end.endpoint_gid)
                self._publishers[gid] = f"{name} ({gid.hex()})"
        return self._publishers.setdefault(number, number.hex())

    def _turn(self, turn: Callable[[], None], before: Any) -> Any:
        from rclpy.lifecycle import TransitionCallbackReturn

        turn()
        return TransitionCallbackReturn.SUCCESS

    def _now(self) -> float:
        return 1e-9 * self.node.get_clock().now().nanoseconds

    def _is_simulated(self) -> bool:
        return self.node.get_clock().ros_time_is_active

    def _published(self) -> dict[str, str]:
        kinds = {}
        for name, _ in self.node.get_topic_names_and_types():
            for publisher in self.node.get_publishers_info_by_topic(name):
                kinds[name] = publisher.topic_type
        return kinds

    def _listen(self, topic: str, kind: str, hear: Callable[[Any], None]) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        try:
            form = message_type(kind)
        except InputError as missing:
            return self.report(
                f"{missing}: {topic} is not heard, and no frame is checked by it"
            )
        latched = topic == TF_TOPICS[1]
        durable = (
            DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        )
        quality = QoSProfile(depth=100, durability=durable)
        self.node.create_subscription(form, topic, hear, quality)

    def _advertise(self, topic: str, kind: str) -> Outlet:
        try:
            publisher = self.node.create_publisher(message_type(kind), topic, 10)
            self._compare(kind, publisher.topic_name)
        except InputError as missing:
            self.report(f"{missing}: nothing is published on {topic}")
            return UNHEARD

        def send(message: Any) -> None:
            # Its bytes: rclpy makes a message of many objects ten times slower.
            publisher.publish(
                bytes(self._store.serialize_cdr(message, message.__msgtype__))
            )

        return Outlet(send, lambda: publisher.get_subscription_count() > 0)

    def _compare(self, kind: str, topic: str) -> None:
        """InputError if a topic that we publish is of another definition of `kind` than ours."""
        ends = self.node.get_publishers_info_by_topic(topic)
        own = [end for end in ends if end.node_name == self.node.get_name()]
        # Not every middleware knows them.
        hashes = {str(end.topic_type_hash) for end in own} - {"INVALID"}
        if hashes and self._store.hash_rihs01(kind) not in hashes:
            raise InputError(f"this ROS 2 defines {kind} in another way")
