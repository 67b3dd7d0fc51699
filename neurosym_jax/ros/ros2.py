"""A predictor in a ROS 2 graph, with rclpy.

People in, poses, markers and samples out. rclpy is imported when the node is made: this file is the
only one that needs it, and the predictor knows nothing of it.
"""

# pyright: reportMissingImports=false
# ROS 2 has its own installer; where the linters run there is none.

import functools
import importlib
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from neurosym_jax.dashboard import Dashboard
from neurosym_jax.errors import InputError
from neurosym_jax.online.analytics import Analytics
from neurosym_jax.online.likely import AT_LEAST, LikelyEvents
from neurosym_jax.online.predictor import Predictor
from neurosym_jax.online.replay import advance
from neurosym_jax.online.status import Status
from neurosym_jax.ros.bags import TF_TOPICS
from neurosym_jax.ros.definitions import PEOPLE, TRANSFORMS
from neurosym_jax.ros.messages import PEOPLE_TOPICS, TRUTH_TOPIC, WAITING, forecast_topic
from neurosym_jax.ros.outgoing import (
    DIAGNOSTICS,
    ENDINGS,
    central_path,
    diagnostics_message,
    makers,
    put_stamp,
)
from neurosym_jax.ros.people import POSES
from neurosym_jax.ros.source import Source
from neurosym_jax.tracking.live import OnlineStitcher

__all__ = ["ForecastNode", "has", "message_type"]

FORECAST_TOPICS = {POSES: "", **ENDINGS}
"""How the topics end that a forecast goes to, by type; where ROS 2 has the type."""
DIAGNOSE = 1.0
"""Seconds between messages on /diagnostics."""


class ForecastNode:
    """A predictor in a ROS 2 graph; rclpy must have been initialised."""

    def __init__(
        self,
        predictor: Predictor,
        *,
        topic: str = PEOPLE_TOPICS[0],
        kind: str = PEOPLE,
        source: Source | None = None,
        stitcher: OnlineStitcher | None = None,
        name: str = "neurosym_jax",
        status: float = 10.0,
        at_least: float = AT_LEAST,
    ):
        """Join the graph.

        Args:
            predictor: of one or several models, each with topics of its own.
            topic: of the people.
            kind: their type, a key of `people.KINDS`.
            source: which messages belong to the stream, and where they are taken to.
            stitcher: mends ids, if given.
            name: of the node.
            status: seconds between lines on how it goes; 0 for none.
            at_least: probability from which on an event of a pair is told.

        Raises:
            InputError: where ROS 2 has no such message.
        """
        import rclpy
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        people = message_type(kind)
        self.kind, self.source = kind, source or Source()
        self.predictor, self.stitcher = predictor, stitcher
        self.analytics = Analytics.of(predictor)
        LikelyEvents.of(predictor, at_least)  # Compiled before it is asked for.
        self._make = makers(at_least)
        self.dashboard: Dashboard | None = None
        """Shown every frame, where there is one."""
        self.node = rclpy.create_node(name)
        kinds = {kind: end for kind, end in FORECAST_TOPICS.items() if has(kind)}
        self._forecasts = {
            (name, kind): self._publisher(kind, forecast_topic(name) + end)
            for name in predictor.models
            for kind, end in kinds.items()
        }
        self._truth = self._publisher(POSES, TRUTH_TOPIC)
        logger = self.node.get_logger()
        self.status = Status(predictor, self.analytics, logger.info, status, self._counts)
        self.node.create_timer(DIAGNOSE, self._look)
        self._diagnostics = (
            self._publisher(DIAGNOSTICS, "/diagnostics") if has(DIAGNOSTICS) else None
        )
        # Best effort hears publishers of either kind.
        quality = QoSProfile(depth=WAITING, reliability=ReliabilityPolicy.BEST_EFFORT)
        heard = self.node.create_subscription(people, topic, self.hear, quality)
        self.topic = heard.topic_name
        """Of the people, after remapping."""
        if self.source.needs_transforms:
            latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            for name, quality in zip(TF_TOPICS, (QoSProfile(depth=100), latched)):
                hear = functools.partial(self.source.transforms.hear, static=name == TF_TOPICS[1])
                self.node.create_subscription(message_type(TRANSFORMS), name, hear, quality)

    def hear(self, message: Any, info: Mapping[str, Any]) -> None:
        """Take in a message of people, and publish what it leads to."""
        publisher = (info.get("publisher_gid") or {}).get("data", b"")
        frame = self.source.take(self.kind, message, bytes(publisher).hex(), time.monotonic())
        if frame is None:
            return
        self.status.heard()
        robot = self.source.robot(frame.stamp)
        event = advance(frame, self.predictor, self.analytics, self.stitcher, robot)
        period, frame_id = self.predictor.window.period, self.source.frame_id or ""
        for (name, kind), publisher in self._forecasts.items():
            if event.forecast is not None and publisher.get_subscription_count():
                if kind == POSES:
                    path = central_path(event.forecast, name)
                    message = _poses(path, event.forecast.stamp, frame_id)
                else:
                    message = self._make[kind](_new, event.forecast, name, period, frame_id)
                publisher.publish(message)
        for done in event.scored:
            assert done.future is not None
            seen = np.isfinite(done.future).all(axis=(1, 2))
            path = np.concatenate([done.observed[:, -1:], done.future], axis=1)[seen]
            self._truth.publish(_poses(path, done.stamp, frame_id))
        if self.dashboard is not None:
            self.dashboard.show(event.frame, event.forecast, self.analytics.summary(), robot)

    def _publisher(self, kind: str, topic: str) -> Any:
        return self.node.create_publisher(message_type(kind), topic, 10)

    def _look(self) -> None:
        self.status.look()
        if self._diagnostics is not None:
            now, name = time.time(), self.node.get_fully_qualified_name()
            self._diagnostics.publish(diagnostics_message(_new, self.status, name, now))

    def _counts(self) -> dict[str, int]:
        joined = self.stitcher.joined if self.stitcher else 0
        return {**self.source.refused, "tracks_joined": joined}


def _poses(path: np.ndarray, stamp: float, frame_id: str) -> Any:
    """Person by person, every step of [N, 1 + T, 2] after the first, facing the way of walking."""
    array = _new(POSES)
    put_stamp(array.header, stamp, frame_id)
    heading = np.diff(path, axis=1)
    half = 0.5 * np.arctan2(heading[..., 1], heading[..., 0])
    for xy, angle in zip(path[:, 1:].reshape(-1, 2).tolist(), half.ravel().tolist()):
        pose = _new("geometry_msgs/msg/Pose")
        pose.position.x, pose.position.y = xy
        pose.orientation.z, pose.orientation.w = float(np.sin(angle)), float(np.cos(angle))
        array.poses.append(pose)
    return array


def _new(kind: str) -> Any:
    return message_type(kind)()


def has(kind: str) -> bool:
    """Whether this ROS 2 has the package of a message."""
    try:
        return bool(message_type(kind))
    except InputError:
        return False


def message_type(kind: str) -> Any:
    """The class of a message, by its type.

    Raises:
        InputError: where its package is missing.
    """
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise InputError(f"this ROS 2 has no {package}") from None
