"""The node of a robot, and nodes of several."""

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

#: Seconds for which commands are refused after this process was held up: Fast DDS sends again what was lost with its
#: heartbeats, every 3 s.
_SETTLING = 4.0
#: Seconds between two looks at what changes seldom, and without a state after which a robot counts as lost.
_LOOK, _SILENT = 0.1, 0.5

#: Seconds that a goal may take to end once it is cancelled; it takes two periods of its feedback.
_END = 5.0


class RobotNode:
    """A node of ROS 2 for one robot: topics, services, and the action; made within a context of rclpy.

    Args:
        context: of rclpy.
        robot: what is served; it is not closed with the node.
        name: of the node.
        namespace: of the node, and so of all names.
        prefix: of the names of joints and frames, such as ``left_``.
        rate: states a second that are published, at most; None for all.
        controller: what the action's name begins with.
        watchdog: seconds without a set-point after which an arm that follows a trajectory brakes by itself.

    Attributes:
        node: of rclpy; add it to an executor.

    Raises:
        BadValue: a rate that is not positive.
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
            raise BadValue(f"rate={rate}; expected more than 0 and at most 1000 states a second")
        self.node = rclpy.create_node(name, namespace=namespace, context=context)
        self._robot = robot
        self._every = 1 if rate is None else max(round(robot.firmware.rate / rate), 1)
        self._came = itertools.count()
        joints = [f"{prefix}{joint}" for joint in JOINT_NAMES]
        self._publishers = StatePublishers(self.node, joints, f"{prefix}base", f"{prefix}tool0")
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
        # Not by the timer: a busy executor is late by seconds, while the process runs.
        self._expiry.tick()
        threading.Thread(target=self._tick, name="urlink-ros2 tick", daemon=True).start()

    def end_motion(self) -> None:
        """Take no more goals and messages, and cancel what a client moves; returns before it has ended."""
        if self._topics is not None:
            self._topics.end()
        if self._action is not None:
            self._action.end()

    def wait_motion_ended(self) -> None:
        """Wait until what `end_motion` cancelled has ended and, by the executor, its client has been told."""
        if self._topics is not None:
            self._topics.wait_ended()
        if self._action is not None:
            self._action.wait_ended(_END)

    def close(self) -> None:
        """Cancel what a client moves, wait until it has ended, and end the node."""
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
        with contextlib.suppress(SafetyStop):  # the arm stands already
            self._robot.motion.stop()  # whatever moves it: also a script of a user

    def _set_speed(self, message: Any) -> None:
        try:
            self._expiry.check()
            self._robot.set_speed_slider(message.data)
        except LinkError as error:
            _log.warning("the speed slider is not set: %s", error)


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
    """Serve robots, by name, as long as the context lasts, with an executor of its own.

    Args:
        robots: name -> robot.
        namespaced: each in a namespace of its name; None where there are several.
        prefixed: names of joints and frames begin with the name of the robot.
        rate, controller, watchdog: see `RobotNode`.
    """
    if namespaced is None:
        namespaced = len(robots) > 1
    context = rclpy.Context()
    # Signals stay with the program around us.
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
        # While the executor runs: its shutdown waits for goals, and their results are sent by it.
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
    """Spin until it is over. `executor.spin` goes on for a moment after `shutdown`, when nodes are destroyed."""
    with contextlib.suppress(rclpy.executors.ExternalShutdownException):
        while executor.context.ok() and not is_over.is_set():
            executor.spin_once(timeout_sec=0.1)


def _takes_commands(robot: Robot) -> bool:
    try:
        return robot.motion is not None
    except LocalError:
        return False
