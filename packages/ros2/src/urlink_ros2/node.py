"""ROS 2 node of a robot, and a server for the nodes of several robots."""

from __future__ import annotations

import contextlib
import itertools
import logging
import threading
from collections.abc import Iterator, Mapping
from typing import Any

import rclpy
import rclpy.executors
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64

from linkcore import clock
from urlink import BadValue, Expiry, LinkError, LocalError, Robot, SafetyStop, drop_oldest
from urlink.arm.urdf import JOINTS as JOINT_NAMES
from urlink.packets import RealtimeState

from .services import create_services
from .states import STREAMED, StatePublishers
from .streams import CommandTopics

__all__ = ["JOINT_NAMES", "RobotNode", "serve"]

_log = logging.getLogger("urlink.ros2")

#: Time, in s, for which commands are refused after this process was interrupted. Fast DDS sends lost messages again
#: with its heartbeats, every 3 s.
_SETTLING = 4.0
#: Interval, in s, at which seldom changes are published; time, in s, without a state until a robot counts as lost.
_LOOK, _SILENT = 0.1, 0.5

#: Maximum time, in s, for a cancelled goal to end; it takes two periods of its feedback.
_END = 5.0


class RobotNode:
    """ROS 2 node of one robot, with topics, services and the action.

    Args:
        context: Context of rclpy, which must be initialised.
        robot: Robot to serve. It is not closed with the node.
        name: Name of the node.
        namespace: Namespace of the node, and so of all its names.
        prefix: Prefix of the names of joints and frames, such as ``left_``.
        rate: Maximum number of states to publish per second; None for all states.
        controller: First part of the action's name.
        watchdog: Watchdog of trajectories, in s: without a set-point for this time, the arm brakes on its own.

    Attributes:
        node: Node of rclpy; add it to an executor.

    Raises:
        BadValue: If `rate` is not positive.
    """

    def __init__(
        self,
        context: Any,
        robot: Robot,
        *,
        name: str = "urlink",
        namespace: str = "",
        prefix: str = "",
        rate: float | None = None,
        controller: str = "scaled_joint_trajectory_controller",
        watchdog: float = 0.1,
    ) -> None:
        if rate is not None and not 0.0 < rate <= 1000.0:
            raise BadValue(f"rate={rate}; expected more than 0 and at most 1000 states per second")
        self.node = rclpy.create_node(name, namespace=namespace, context=context)
        self._robot = robot
        self._every = 1 if rate is None else max(round(robot.firmware.rate / rate), 1)
        self._came = itertools.count()
        joints = [f"{prefix}{joint}" for joint in JOINT_NAMES]
        self._publishers = StatePublishers(self.node, joints, f"{prefix}base")
        self._is_commanded = _takes_commands(robot)
        self._action: Any = None
        self._topics: CommandTopics | None = None
        self._expiry = Expiry(_SETTLING)
        self._is_closed = threading.Event()
        if self._is_commanded:
            create_services(self.node, robot, self._halt, self._expiry)
            self.node.create_subscription(Float64, "set_speed_slider", self._set_speed, STREAMED)
            self._topics = CommandTopics(self.node, robot, self._expiry)
            try:
                from .following import TrajectoryAction

                name = f"{controller}/follow_joint_trajectory"
                self._action = TrajectoryAction(self.node, name, robot, joints, watchdog, self._expiry)
            except ImportError as error:
                _log.warning("FollowJointTrajectory is not served: %s", error)
        self._publishers.describe(robot)
        self._subscription = robot.realtime.subscribe(self._publish, policy=drop_oldest(64))
        self.node.create_timer(_LOOK, self._look)
        # In a thread rather than a timer: a busy executor delays timers by seconds although the process runs.
        self._expiry.tick()
        threading.Thread(target=self._tick, name="urlink-ros2 tick", daemon=True).start()

    def end_motion(self) -> None:
        """Accept no more goals and messages, and cancel the motions of clients.

        Do not wait for the end of the motions.
        """
        if self._topics is not None:
            self._topics.end()
        if self._action is not None:
            self._action.end()

    def wait_motion_ended(self) -> None:
        """Wait until motions cancelled by `end_motion` have ended, and clients are notified.

        The executor has to run in the meantime, because it notifies the clients.
        """
        if self._topics is not None:
            self._topics.wait_ended()
        if self._action is not None:
            self._action.wait_ended(_END)

    def close(self) -> None:
        """Cancel the motions of clients, wait until they have ended, and destroy the node."""
        self._is_closed.set()
        self._subscription.close()
        self.end_motion()
        self.wait_motion_ended()
        if self._action is not None:
            self._action.destroy()
        self.node.destroy_node()

    def _publish(self, state: RealtimeState) -> None:
        if next(self._came) % self._every == 0:
            self._publishers.publish(state)

    def _tick(self) -> None:
        while not clock.wait(self._is_closed.wait, _LOOK):
            self._expiry.tick()

    def _look(self) -> None:
        state = self._robot.realtime.latest
        if state is not None and state.received is not None and state.received.age > _SILENT:
            state = None
        refusal = self._robot.safety.refusal if self._is_commanded else None
        self._publishers.publish_changes(state, "" if refusal is None else str(refusal))

    def _halt(self) -> None:
        with contextlib.suppress(SafetyStop):  # the arm is already at rest
            self._robot.motion.stop()  # stops every motion, even a script of a user

    def _set_speed(self, message: Any) -> None:
        try:
            self._expiry.check()
            self._robot.set_speed_slider(message.data)
        except LinkError as error:
            _log.warning("speed slider not set: %s", error)


@contextlib.contextmanager
def serve(
    robots: Mapping[str, Robot],
    *,
    namespaced: bool | None = None,
    prefixed: bool = False,
    rate: float | None = None,
    controller: str = "scaled_joint_trajectory_controller",
    watchdog: float = 0.1,
) -> Iterator[None]:
    """Serve robots in their own executor until the context ends.

    Args:
        robots: Robots by name.
        namespaced: Whether each robot is in a namespace with its name. None does so only for several robots.
        prefixed: Whether names of joints and frames begin with the name of the robot.
        rate, controller, watchdog: See `RobotNode`.
    """
    if namespaced is None:
        namespaced = len(robots) > 1
    context = rclpy.Context()
    # The surrounding program handles signals.
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    executor = rclpy.executors.MultiThreadedExecutor(2 + 2 * len(robots), context=context)
    nodes: list[RobotNode] = []
    is_over = threading.Event()
    thread = threading.Thread(target=_spin, args=(executor, is_over), name="urlink-ros2", daemon=True)
    try:
        for name, robot in robots.items():
            served = RobotNode(
                context,
                robot,
                namespace=name if namespaced else "",
                prefix=f"{name}_" if prefixed else "",
                rate=rate,
                controller=controller,
                watchdog=watchdog,
            )
            nodes.append(served)
            executor.add_node(served.node)
        thread.start()
        yield
    finally:
        # Do this while the executor runs: it sends the results of goals, and its shutdown waits for goals.
        for served in nodes:
            served.end_motion()
        for served in nodes:
            served.wait_motion_ended()
        is_over.set()
        executor.wake()
        if thread.is_alive():
            thread.join(5.0)
        executor.shutdown(timeout_sec=2.0)
        for served in nodes:
            served.close()
        rclpy.shutdown(context=context)


def _spin(executor: Any, is_over: threading.Event) -> None:
    """Spin until the end is requested.

    `executor.spin` would run for a moment after `shutdown`, when nodes are already destroyed.
    """
    with contextlib.suppress(rclpy.executors.ExternalShutdownException):
        while executor.context.ok() and not is_over.is_set():
            executor.spin_once(timeout_sec=0.1)


def _takes_commands(robot: Robot) -> bool:
    try:
        return robot.motion is not None
    except LocalError:
        return False
