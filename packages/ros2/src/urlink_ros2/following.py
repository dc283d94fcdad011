"""Action `FollowJointTrajectory`: follows the trajectories of its goals, and reports feedback and results."""

from __future__ import annotations

import logging
import math
import threading
from functools import partial
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from linkcore import clock
from urlink import BadValue, Cancelled, Expiry, LinkError, LinkTimeout, Motion, PendingCall, Robot
from urlink.motion import TrajectoryFeedback
from urlink.packets import RealtimeState

from .goals import has_passed, outcome, read_goal, start_of

__all__ = ["TrajectoryAction"]

_log = logging.getLogger("urlink.ros2")

#: Interval, in s, between two feedback messages.
_FEEDBACK = 0.05

#: Time, in s, for the executor to send the result of a goal. rclpy does not report when the result was sent.
_SENDING = 0.5

#: Number of feedback messages that are kept until they are acknowledged. Fast DDS requests an acknowledgement when this
#: number of messages is waiting.
_DEPTH = 2
#: Time, in s, without an acknowledgement after which a client counts as lost. Existing clients took at most 0.1 s.
_SILENT = 1.5
#: Time, in s, from the start of a goal within which its client's subscription to the feedback is discovered.
_DISCOVERY = 1.0

#: Maximum time, in s, by which the start of a goal may be in the future.
_LONGEST_WAIT = 3600.0


class _NumberedServer(ActionServer):  # type: ignore[misc,type-arg,unused-ignore]
    """Action server that numbers goals in the order of arrival.

    The callbacks of several goals can run at the same time, and in a different order.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._count = 0
        self._numbers: dict[bytes, int] = {}
        super().__init__(*arguments, **options)

    def take_data(self) -> Any:
        data = super().take_data()
        if "goal" in data:
            self._count += 1
            self._numbers[bytes(data["goal"][1].goal_id.uuid)] = self._count
            for old in list(self._numbers)[:-1000]:  # these goals were rejected
                self._numbers.pop(old, None)
        return data

    def number_of(self, handle: Any) -> int:
        """Return the number of a goal that was accepted."""
        return self._numbers.pop(bytes(handle.goal_id.uuid), 0)


class TrajectoryAction:
    """Action server of one robot.

    A goal passes the interlock, preempts earlier goals, and starts at its `header.stamp`. It is cancelled when any
    client of the action is lost, because ROS 2 does not report which client sent a goal.

    Args:
        node: Node that serves the action.
        name: Name of the action.
        robot: Robot to move.
        joints: Names of the joints, base to wrist 3.
        watchdog: Watchdog of trajectories, in s: without a set-point for this time, the arm brakes on its own.
        expiry: Check for goals that their client might have abandoned.

    Raises:
        ImportError: If `control_msgs` is not installed.
    """

    def __init__(self, node: Any, name: str, robot: Robot, joints: list[str], watchdog: float, expiry: Expiry) -> None:
        from control_msgs.action import FollowJointTrajectory

        self._type = FollowJointTrajectory
        self._node = node
        self._robot = robot
        self._joints = joints
        self._watchdog = watchdog
        self._expiry = expiry
        topic = f"{name}/_action/feedback"
        self._feedback_topic = node.resolve_topic_name(topic)
        # This replaces the action's own publisher, for which rclpy does not report acknowledgements.
        self._publisher = node.create_publisher(
            FollowJointTrajectory.Impl.FeedbackMessage, topic, QoSProfile(depth=_DEPTH)
        )
        self._motion: Motion | None = None
        self._turn = threading.Lock()
        self._newest = 0
        self._ending = threading.Event()
        self._idle = threading.Condition()
        self._running = 0
        self._last_end = -math.inf
        self._server = _NumberedServer(
            node,
            FollowJointTrajectory,
            name,
            execute_callback=self._execute,
            goal_callback=self._accepted,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def end(self) -> None:
        """Accept no more goals, and cancel the current goal. Do not wait for its end."""
        self._ending.set()
        motion = self._motion
        if motion is not None:
            motion.cancel()

    def wait_ended(self, seconds: float) -> None:
        """Wait until no goal is running, and until its client can have received the result.

        The executor has to run in the meantime, because it sends the results. `seconds` is the maximum wait for the
        goal.
        """
        with self._idle:
            clock.wait(partial(self._idle.wait_for, lambda: self._running == 0), seconds)
            left = self._last_end + _SENDING - clock.now()
        if left > 0.0:
            clock.sleep(left)

    def destroy(self) -> None:
        """Stop serving the action."""
        self._server.destroy()

    def _accepted(self, request: Any) -> GoalResponse:
        """Reject a goal immediately if it cannot or must not be followed now."""
        refusal: object = self._robot.safety.refusal
        if self._ending.is_set():
            refusal = "the server is shutting down"
        elif has_passed(request, self._now()):
            refusal = "according to its header.stamp, it would already have ended"
        else:
            try:
                self._expiry.check()
            except LinkTimeout as error:
                refusal = error
        if refusal is None:
            return GoalResponse.ACCEPT
        _log.warning("%s: goal rejected: %s", self._robot.address, refusal)
        return GoalResponse.REJECT

    def _now(self) -> float:
        """Return the time of the ROS clock, in s."""
        return float(self._node.get_clock().now().nanoseconds * 1e-9)

    def _execute(self, handle: Any) -> Any:
        with self._idle:
            self._running += 1
        # A single call from here on, so that a stop of the robot also ends a goal that has not started.
        try:
            return self._follow(handle, PendingCall())
        finally:
            with self._idle:
                self._running -= 1
                self._last_end = clock.now()
                self._idle.notify_all()

    def _follow(self, handle: Any, call: PendingCall) -> Any:
        number = self._server.number_of(handle)
        watch = _Watch(self._node, self._publisher, self._feedback_topic)
        newest: list[TrajectoryFeedback] = []
        told = threading.Event()

        def note(feedback: TrajectoryFeedback) -> None:
            newest[:] = [feedback]
            told.set()

        duration = 0.0
        try:
            begins = self._take_turn(handle, number)
            while (early := begins - self._now()) > 0.0:
                self._publish(handle, _standing(self._robot.realtime.wait()), watch)
                self._check(handle, watch, number)
                refusal = call.make(lambda: self._robot.safety.refusal)
                if refusal is not None:
                    raise refusal
                clock.sleep(min(early, _FEEDBACK))
            with self._turn:
                self._check(handle, watch, number)
                self._expiry.check()
                here = self._robot.realtime.wait().q_target
                goal = read_goal(handle.request, self._joints, here, -early if start_of(handle.request) else 0.0)
                duration = goal.trajectory.duration
                follow = partial(
                    self._robot.motion.follow,
                    goal.trajectory,
                    path_tolerance=goal.path_tolerance,
                    goal_tolerance=goal.goal_tolerance,
                    goal_time=goal.goal_time,
                    feedback=note,
                    watchdog=self._watchdog,
                )
                motion = self._motion = call.make(follow)
        except LinkError as error:
            return self._ended(handle, error, False, number)
        reason: Cancelled | None = None
        while not motion.done:
            clock.sleep(_FEEDBACK)
            if told.is_set():
                told.clear()
                self._publish(handle, newest[0], watch)
            if reason is not None:
                continue
            try:
                self._check(handle, watch)
            except Cancelled as error:
                _log.warning("%s: the trajectory is cancelled: %s", self._robot.address, error)
                reason = error
                motion.cancel()
        is_at_the_end = bool(newest) and newest[0].trajectory_time >= duration - _FEEDBACK
        ended = motion.error
        if isinstance(ended, Cancelled) and reason is not None:
            ended = reason
        return self._ended(handle, ended, is_at_the_end, number)

    def _take_turn(self, handle: Any, number: int) -> float:
        """Preempt earlier goals, and return the start time of this goal, in s of the ROS clock.

        Raises:
            BadValue: If the goal cannot be followed. It preempts nothing.
            Cancelled: If a newer goal has arrived.
        """
        now = self._now()
        begins = start_of(handle.request) or now
        if begins > now + _LONGEST_WAIT:
            raise BadValue(
                f"header.stamp is {begins - now:.0f} s in the future; expected at most {_LONGEST_WAIT:.0f} s "
                "(is a clock wrong?)"
            )
        read_goal(handle.request, self._joints, self._robot.realtime.wait().q_target)
        with self._turn:
            if number < self._newest:
                raise Cancelled("a newer goal has arrived")
            self._newest = number
            if begins > now and self._motion is not None:
                self._motion.cancel()
        return begins

    def _check(self, handle: Any, watch: _Watch, number: int | None = None) -> None:
        """Raise `Cancelled` if the goal must not continue.

        With the number of the goal, raise it also if a newer goal has arrived.
        """
        if self._ending.is_set():
            raise Cancelled("the server is shutting down")
        if handle.is_cancel_requested:
            raise Cancelled("its client cancelled it")
        if number is not None and number < self._newest:
            raise Cancelled("a newer goal has arrived")
        lost = watch.lost
        if lost is not None:
            raise Cancelled(lost)

    def _ended(self, handle: Any, error: Exception | None, is_at_the_end: bool, number: int) -> Any:
        result = self._type.Result()
        if error is None:
            result.error_code = self._type.Result.SUCCESSFUL
            handle.succeed()
            return result
        is_preempted = number < self._newest or "preempted" in str(error)
        result.error_code, prefix = outcome(error, self._type.Result, is_at_the_end, is_preempted)
        result.error_string = f"{prefix}: {type(error).__name__}: {error}"
        if handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return result

    def _publish(self, handle: Any, told: TrajectoryFeedback, watch: _Watch) -> None:
        watch.look()
        message = self._type.Impl.FeedbackMessage()
        message.goal_id = handle.goal_id
        message.feedback = self._feedback(told)
        self._publisher.publish(message)

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
            point.time_from_start.sec = int(told.trajectory_time)
            point.time_from_start.nanosec = int((told.trajectory_time % 1.0) * 1e9)
        return message


class _Watch:
    """Check whether the clients of the action still exist, as far as DDS reports it.

    Each client subscribes to the feedback. The subscription of a client that ends normally disappears immediately. The
    subscription of a killed client remains for DDS's lease (20 s in Fast DDS), but acknowledges no messages.

    Args:
        node: Node that serves the action.
        publisher: Publisher of the feedback.
        topic: Topic of the feedback.
    """

    def __init__(self, node: Any, publisher: Any, topic: str) -> None:
        self._node = node
        self._publisher = publisher
        self._topic = topic
        self._began = clock.now()
        self._clients: set[bytes] = set()
        self._published = 0
        # None until a feedback of this goal is acknowledged: a client that was killed before must not end this goal.
        self._acknowledged: float | None = None

    def look(self) -> None:
        """Note, before feedback is published, whether all earlier feedback is acknowledged."""
        # Do not wait: rclpy holds the interpreter's lock during that.
        if self._published >= _DEPTH and self._publisher.wait_for_all_acked(Duration(seconds=0)):
            self._acknowledged = clock.now()
        self._published += 1

    @property
    def lost(self) -> str | None:
        """Description of the lost client; None if all clients exist."""
        now = clock.now()
        here = {bytes(each.endpoint_gid) for each in self._node.get_subscriptions_info_by_topic(self._topic)}
        if now < self._began + _DISCOVERY:
            self._clients |= here
        elif not here:
            return "all clients of the action have disconnected"
        if self._clients - here:
            return "a client of the action has disconnected"
        if self._acknowledged is not None and now - self._acknowledged > _SILENT:
            return f"a client of the action has not acknowledged any feedback for {now - self._acknowledged:.1f} s"
        return None


def _standing(state: RealtimeState) -> TrajectoryFeedback:
    """Return the feedback of a goal that has not started."""
    off = state.q_target - state.q_actual
    return TrajectoryFeedback(0.0, 0.0, state.q_target, state.qd_target, state.q_actual, state.qd_actual, off)
