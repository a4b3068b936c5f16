"""Node of ROS 2 that publishes a running flight and accepts commands to the vehicle.

Topics are those of :data:`mufly.logs.ros.ros_messages.ROS_TOPICS`, at their live rates. A topic is left out, with an
event, where its message package is not installed (PyPI has no ``tf2_msgs``). Commands:

- ``/goal_pose`` (geometry_msgs/PoseStamped in ``map``): fly to a position and hold it. Height 0, which RViz sends,
  keeps the present height.
- ``/cmd_vel`` (geometry_msgs/Twist in ``base_link``, level): velocity and rate of turn, streamed at 5 Hz or more; the
  first one starts offboard control, and the vehicle hovers half a second after the last one.
- services ``/arm``, ``/take_off``, ``/start_mission``, ``/land``, ``/stop_motors`` (std_srvs/Trigger), with the reason
  of a refusal.

The node runs in the thread of a :class:`mufly.flight.record.live_view.LiveViewThread`; the flight never waits for it.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.bridges.ros_geometry import range_sensor_geometry
from mufly.errors import InputError
from mufly.flight import Flight, RequestAnswer, SetPoint
from mufly.flight.record.live_view import LiveViewThread
from mufly.logs.mcap import FlightEvent
from mufly.logs.ros.ros_messages import (
    STATE_TOPIC,
    STATE_TYPE,
    RosTopic,
    attitude_to_ros,
    body_frd_to_flu,
    compute_stamp_times_ns,
    extract_row_message,
    find_rows_for_topic,
    ned_to_enu,
    select_ros_topics,
    stamp_message,
)
from mufly.rotations import euler_from_unnormalised_quaternion

_Array = NDArray[np.float64]
_ROW_RATE_HZ = 200.0
_QUEUE_DEPTH = 10
_MAX_CALLBACKS_PER_BATCH = 50  # in one batch


def import_rclpy() -> ModuleType:
    """Import rclpy, ROS 2's client library for Python, and return it.

    Raises
    ------
    InputError
        If ROS 2 is not installed.
    """
    try:
        import rclpy
        import rclpy.executors
    except ImportError as error:
        remedy = "install it (Linux: pip install 'mufly[ros]'), or source the setup of your ROS 2"
        raise InputError("--ros", "", "needs rclpy, which cannot be imported", remedy) from error
    return rclpy


@dataclass(frozen=True)
class RosViewConfig:
    """Settings of the live view for ROS 2.

    Attributes
    ----------
    name : str
        Name of the node.
    """

    name: str = "mufly"

    def open_view(self, flight: Flight) -> LiveViewThread:
        """Start the ROS 2 node; return the thread that publishes the flight through it.

        Raises
        ------
        InputError
            If rclpy is missing.
        """
        node = RosPublisher(flight, self.name)
        view = LiveViewThread(flight, node, rate_Hz=_ROW_RATE_HZ, name="the node of ROS 2")
        node.view = view
        flight.log_event(f"node {self.name} of ROS 2 publishes {len(node.topic_names)} topics")
        for line in node.notes:
            flight.log_event(line, "warning")
        return view


class RosPublisher:
    """Node of ROS 2 that publishes the rows of a running flight's recording and passes commands to the flight.

    Attributes
    ----------
    topic_names : list of str
    notes : list of str
        Topics that are not published, with the reason.
    view : LiveViewThread
        Set when the view starts; it carries the commands to the flight.
    """

    view: LiveViewThread

    def __init__(self, flight: Flight, name: str) -> None:
        self._rclpy = import_rclpy()
        recorder = flight.recorder
        self._columns, self._start_ns = recorder.layout.column_slices, recorder.start_time_ns
        self._limits = range_sensor_geometry(flight.vehicle)
        self._context = self._rclpy.Context()
        self._context.init()
        self._node = self._rclpy.create_node(name, context=self._context)
        self._executor = self._rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._senders: list[tuple[RosTopic, Any, type]] = []
        self._due_s: dict[str, float] = {}
        self.notes: list[str] = []
        sensed = not flight.records_only_truth
        names = [n for n in self._columns if sensed or not n.startswith("estimated_")]
        # On sensors the motion is estimated, without them measured; the other columns stay empty.
        unused = ("measured_position", "measured_velocity", "measured_attitude") if sensed else ()
        for topic in select_ros_topics(dict.fromkeys(n for n in names if n not in unused)):
            self._add_topic(topic)
        self._state = self._node.create_publisher(import_message_class(STATE_TYPE), STATE_TOPIC, _QUEUE_DEPTH)
        self._state_text = ""
        self._create_subscriptions_and_services()

    @property
    def topic_names(self) -> list[str]:
        """Names of the published topics."""
        return [topic.name for topic, _, _ in self._senders] + [STATE_TOPIC]

    def _add_topic(self, topic: RosTopic) -> None:
        try:
            kind = import_message_class(topic.message_type)
        except ImportError:
            package = topic.message_type.partition("/")[0]
            self.notes.append(f"{topic.name} is not published: the package {package} is not installed")
            return
        self._senders.append((topic, self._node.create_publisher(kind, topic.name, _QUEUE_DEPTH), kind))

    def publish_rows_and_events(self, rows: _Array, states: Sequence[str], events: Sequence[FlightEvent]) -> None:
        """Publish new rows of the recording and new events, and handle the commands that have arrived."""
        if len(rows):
            blocks = {name: rows[:, part] for name, part in self._columns.items()}
            for topic, publisher, kind in self._senders:
                self._publish_topic(topic, publisher, kind, blocks, rows[:, 0])
            if states[-1] != self._state_text or rows[-1, 0] >= self._due_s.get(STATE_TOPIC, 0.0):
                self._state_text, self._due_s[STATE_TOPIC] = states[-1], rows[-1, 0] + 1.0
                self._state.publish(fill_message(import_message_class(STATE_TYPE)(), {"data": states[-1]}))
        logger = self._node.get_logger()
        for event in events:
            text = f"{event.time_s:.1f} s, {event.state}: {event.text}"
            if event.level == "error":  # rclpy allows one severity for each line of code
                logger.error(text)
            elif event.level == "warning":
                logger.warning(text)
            else:
                logger.info(text)
        for _ in range(_MAX_CALLBACKS_PER_BATCH):
            self._executor.spin_once(timeout_sec=0.0)

    def _publish_topic(
        self, topic: RosTopic, publisher: Any, kind: type, blocks: Mapping[str, _Array], time_s: _Array
    ) -> None:
        index = []
        for k in find_rows_for_topic(topic, blocks).tolist():
            if time_s[k] >= self._due_s.get(topic.name, -1.0) - 1e-6:
                self._due_s[topic.name] = time_s[k] + 1.0 / topic.live_rate_Hz
                index.append(k)
        if not index:
            return
        mine = {name: block[index] for name, block in blocks.items()}
        columns = topic.encode(mine, self._limits)
        for k, stamp in enumerate(compute_stamp_times_ns(topic, mine, time_s[index], self._start_ns).tolist()):
            content = extract_row_message(columns, k)
            stamp_message(content, stamp)
            publisher.publish(fill_message(kind(), content))

    def close(self) -> None:
        """Destroy the ROS 2 node."""
        self._executor.shutdown(timeout_sec=0.5)
        self._node.destroy_node()
        self._context.try_shutdown()

    # commands

    def _create_subscriptions_and_services(self) -> None:
        pose, twist = (import_message_class(f"geometry_msgs/msg/{name}") for name in ("PoseStamped", "Twist"))
        self._node.create_subscription(pose, "/goal_pose", self._handle_goal_message, _QUEUE_DEPTH)
        self._node.create_subscription(twist, "/cmd_vel", self._handle_velocity_message, _QUEUE_DEPTH)
        try:
            trigger = importlib.import_module("std_srvs.srv").Trigger
        except ImportError:
            self.notes.append("no services: the package std_srvs is not installed")
            return
        actions: dict[str, Callable[[Flight], RequestAnswer]] = {
            "/arm": lambda flight: flight.autopilot.arm(),
            "/take_off": lambda flight: flight.autopilot.take_off(),
            "/start_mission": lambda flight: flight.autopilot.start_mission(),
            "/land": lambda flight: flight.autopilot.land(),
            "/stop_motors": lambda flight: flight.autopilot.emergency_stop(),
        }
        for name, act in actions.items():
            self._node.create_service(trigger, name, self._make_service_callback(act))

    def _make_service_callback(self, act: Callable[[Flight], RequestAnswer]) -> Callable[[Any, Any], Any]:
        def answer_service_call(_: Any, response: Any) -> Any:
            said: RequestAnswer | None = self.view.request_flight_action(act, wait=True)
            response.success = bool(said)
            response.message = "the flight does not answer" if said is None else said.reason
            return response

        return answer_service_call

    def _handle_goal_message(self, message: Any) -> None:
        frame = message.header.frame_id
        p, q = message.pose.position, message.pose.orientation
        place = ned_to_enu(np.array([[p.x, p.y, p.z]]))[0]
        attitude = euler_from_unnormalised_quaternion(np.array([[q.w, q.x, q.y, q.z]]))
        heading = float(attitude_to_ros(attitude)[0, 2])

        def fly_to_goal(flight: Flight) -> RequestAnswer:
            if frame not in ("map", ""):
                flight.log_event(f"/goal_pose refused: frame {frame!r} is not map", "warning")
                return RequestAnswer(False, "frame")
            down = float(flight.estimate.position[2]) if place[2] == 0.0 else float(place[2])
            answer = flight.autopilot.go_to(
                (float(place[0]), float(place[1]), down), None if math.isnan(heading) else heading
            )
            if not answer:
                flight.log_event(f"/goal_pose refused: {answer.reason}", "warning")
            return answer

        self.view.request_flight_action(fly_to_goal)

    def _handle_velocity_message(self, message: Any) -> None:
        v = message.linear
        ahead, right, down = body_frd_to_flu(np.array([[v.x, v.y, v.z]]))[0].tolist()
        turn = -float(message.angular.z)

        def follow_velocity(flight: Flight) -> RequestAnswer:
            yaw = float(flight.estimate.attitude[2])
            north = math.cos(yaw) * ahead - math.sin(yaw) * right
            east = math.sin(yaw) * ahead + math.cos(yaw) * right
            answer = flight.autopilot.send_set_point(SetPoint(None, (north, east, down), None, turn))
            if answer and not flight.autopilot.status.offboard_active:
                answer = flight.autopilot.set_offboard(True)
            return answer

        self.view.request_flight_action(follow_velocity)


def import_message_class(message_type: str) -> Any:
    """Return the class of a message type such as ``nav_msgs/msg/Odometry``; ImportError if its package is missing."""
    package, _, name = message_type.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def fill_message(message: Any, content: Mapping[str, Any]) -> Any:
    """Set the fields of a message of rclpy, and return it."""
    for key, value in content.items():
        if isinstance(value, Mapping):
            fill_message(getattr(message, key), value)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            kind = message.get_fields_and_field_types()[key]  # sequence<geometry_msgs/TransformStamped>
            inner = import_message_class(kind[len("sequence<") : -1].replace("/", "/msg/"))
            setattr(message, key, [fill_message(inner(), one) for one in value])
        elif isinstance(value, np.ndarray):
            setattr(message, key, value.tolist())
        else:
            setattr(message, key, value)
    return message
