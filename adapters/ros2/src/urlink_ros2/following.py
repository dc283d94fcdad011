"""The action `FollowJointTrajectory`."""

from __future__ import annotations

import logging
import math
import threading
import time
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup

from urlink import LinkError, Motion, Robot, TrajectoryFeedback

from .goals import error_code, read_goal

__all__ = ["TrajectoryAction"]

_log = logging.getLogger("urlink.ros2")

#: Seconds between two feedback messages.
_FEEDBACK = 0.05

#: Seconds in which the executor sends the result of a goal, once there is one; rclpy does not tell when it has left.
_SENDING = 0.5


class TrajectoryAction:
    """Serves the action for one robot.

    A goal passes the interlock, preempts the one before, and is cancelled where no client of the action is left.

    Args:
        node: that serves it.
        name: of the action.
        robot: what is moved.
        joints: their names, base to wrist 3.

    Raises:
        ImportError: `control_msgs` is not installed.
    """

    def __init__(self, node: Any, name: str, robot: Robot, joints: list[str]) -> None:
        from control_msgs.action import FollowJointTrajectory

        self._type = FollowJointTrajectory
        self._node = node
        self._robot = robot
        self._joints = joints
        self._client_service = f"{node.resolve_service_name(name)}/_action/send_goal"
        self._motion: Motion | None = None
        self._ending = threading.Event()
        self._idle = threading.Condition()
        self._running = 0
        self._last_end = -math.inf
        self._server = ActionServer(
            node,
            FollowJointTrajectory,
            name,
            execute_callback=self._execute,
            goal_callback=self._accepted,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def end(self) -> None:
        """Take no more goals, and cancel the one that runs; returns before it has ended."""
        self._ending.set()
        motion = self._motion
        if motion is not None:
            motion.cancel()

    def wait_ended(self, seconds: float) -> None:
        """Wait, at most so long, until no goal runs, and then until its client can have been told.

        The executor has to go on meanwhile, since it sends the results.
        """
        with self._idle:
            self._idle.wait_for(lambda: self._running == 0, seconds)
            left = self._last_end + _SENDING - time.monotonic()
        if left > 0.0:
            time.sleep(left)

    def destroy(self) -> None:
        """Serve it no more."""
        self._server.destroy()

    def _accepted(self, request: Any) -> GoalResponse:
        """Refuse at once what cannot be followed, or must not be now."""
        if self._ending.is_set():
            return GoalResponse.REJECT
        refusal = self._robot.safety.refusal
        if refusal is not None:
            _log.warning("%s: goal rejected: %s", self._robot.address, refusal)
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _execute(self, handle: Any) -> Any:
        with self._idle:
            self._running += 1
        try:
            return self._follow(handle)
        finally:
            with self._idle:
                self._running -= 1
                self._last_end = time.monotonic()
                self._idle.notify_all()

    def _follow(self, handle: Any) -> Any:
        result = self._type.Result()
        newest: list[TrajectoryFeedback] = []
        told = threading.Event()

        def note(feedback: TrajectoryFeedback) -> None:
            newest[:] = [feedback]
            told.set()

        duration = 0.0
        try:
            goal = read_goal(handle.request, self._joints, self._robot.realtime.wait().q_target)
            duration = goal.trajectory.duration
            motion = self._robot.motion.follow(
                goal.trajectory,
                path_tolerance=goal.path_tolerance,
                goal_tolerance=goal.goal_tolerance,
                goal_time=goal.goal_time,
                feedback=note,
            )
        except LinkError as error:
            return self._failed(handle, result, error, False)
        self._motion = motion
        if self._ending.is_set():
            motion.cancel()
        is_asked = False
        while not motion.done:
            time.sleep(_FEEDBACK)
            if told.is_set():
                told.clear()
                handle.publish_feedback(self._feedback(newest[0]))
            if not is_asked and handle.is_cancel_requested:
                is_asked = True
                motion.cancel()
            elif not is_asked and self._node.count_clients(self._client_service) == 0:
                is_asked = True
                _log.warning("%s: no client is left; the trajectory is cancelled", self._robot.address)
                motion.cancel()
        if motion.error is None:
            result.error_code = self._type.Result.SUCCESSFUL
            handle.succeed()
            return result
        if handle.is_cancel_requested:
            result.error_string = str(motion.error)
            handle.canceled()
            return result
        is_at_the_end = bool(newest) and newest[0].time >= duration - _FEEDBACK
        return self._failed(handle, result, motion.error, is_at_the_end)

    def _failed(self, handle: Any, result: Any, error: Exception, is_at_the_end: bool) -> Any:
        result.error_code = error_code(error, self._type.Result, is_at_the_end)
        result.error_string = f"{type(error).__name__}: {error}"
        handle.abort()
        return result

    def _feedback(self, told: TrajectoryFeedback) -> Any:
        message = self._type.Feedback()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.joint_names = self._joints
        message.desired.positions = told.q_desired.tolist()
        message.desired.velocities = told.qd_desired.tolist()
        message.actual.positions = told.q_actual.tolist()
        message.actual.velocities = told.qd_actual.tolist()
        message.error.positions = told.error.tolist()
        for point in (message.desired, message.actual, message.error):
            point.time_from_start.sec = int(told.time)
            point.time_from_start.nanosec = int((told.time % 1.0) * 1e9)
        return message
