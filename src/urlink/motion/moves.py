"""`robot.motion`: everything that moves the arm begins here."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

from numpy.typing import ArrayLike

from linkcore.errors import BadValue, Closed, LocalError
from linkcore.streaming.stream import Stream

from ..commanding.channel import Outlet
from ..commanding.programs import Scripts
from ..commanding.safety import Safety
from ..identity import Identity
from ..interfaces.realtime.packets import RealtimeState
from ..models import Model
from ..urscript import programs
from ..urscript.text import checked
from ..vectors import JOINTS, FloatArray, six
from .equipment import Equipment
from .follower import Follower
from .following import Tolerances, TrajectoryFeedback
from .handle import Motion
from .servo import Servo
from .setpoints import Servoing
from .trajectory import Trajectory
from .uploaded import UploadedMotion, arriving, lasting
from .waypoints import WaypointFollower

__all__ = ["Motions"]

#: Least value of what has to be positive, and a duration of an hour, beyond which a number is a mistake.
_LEAST, _HOUR = 1e-3, 3600.0
#: rad/s² and m/s² beyond which a number is a mistake.
_HARDEST = 100.0

_Kind = TypeVar("_Kind", bound=Motion)


class Motions:
    """Moves the arm. Nothing here waits for the arm: each method returns the handle of a motion under way.

    A motion that is begun supersedes the one that runs, whose `wait` then raises `MotionCancelled`. All of them raise
    `BadValue` for arguments that make no sense or are beyond the limits of the arm, and `SafetyStop`, `NotEnabled` or
    `NotRunning` where the arm may not be moved now; nothing was sent then.

    Made by `Robot`.
    """

    def __init__(
        self,
        scripts: Scripts,
        outlet: Outlet,
        safety: Safety,
        realtime: Stream[RealtimeState],
        identity: Callable[[], Identity],
        host: str,
        reverse_host: str | None,
        reverse_port: int,
    ) -> None:
        self._equipment = Equipment(scripts, outlet, safety, realtime, identity, host, reverse_host, reverse_port)
        self._lock = threading.Lock()
        self._current: Motion | None = None
        self._is_closed = False

    @property
    def current(self) -> Motion | None:
        """The motion that runs, or None."""
        current = self._current
        return None if current is None or current.done else current

    # -- one command -----------------------------------------------------------------------------------

    def move_joints(
        self, q: ArrayLike, speed: float = 1.05, acceleration: float = 1.4, *, time: float | None = None
    ) -> Motion:
        """Move all joints to a position, in a straight line in joint space.

        Args:
            q: (6,) rad.
            speed: rad/s of the joint that is furthest.
            acceleration: rad/s².
            time: seconds that it is to take; then speed and acceleration do not matter.
        """
        goal = six(q, "q")
        model = self._equipment.model
        if model is not None:
            _within(model, goal)
            checked(speed, "speed", _LEAST, float(model.max_speed.max()))
        body = programs.move_joints(
            goal.tolist(), *_rates(speed, acceleration), None if time is None else checked(time, "time", _LEAST, _HOUR)
        )
        gauge = arriving(goal, lambda state: state.q_actual)
        return self._begin(UploadedMotion("move_joints", self._equipment, body, gauge))

    def move_linear(
        self, pose: ArrayLike, speed: float = 0.25, acceleration: float = 1.2, *, time: float | None = None
    ) -> Motion:
        """Move the tool to a pose in the base frame, in a straight line.

        Args:
            pose: (6,) position in m, and rotation vector in rad.
            speed: m/s.
            acceleration: m/s².
            time: seconds that it is to take; then speed and acceleration do not matter.
        """
        goal = six(pose, "pose")
        body = programs.move_linear(
            goal.tolist(), *_rates(speed, acceleration), None if time is None else checked(time, "time", _LEAST, _HOUR)
        )
        # Of the pose only the position: one rotation has more than one vector.
        gauge = arriving(goal[:3], lambda state: state.tool_vector_actual[:3])
        return self._begin(UploadedMotion("move_linear", self._equipment, body, gauge))

    def speed_joints(self, qd: ArrayLike, acceleration: float = 1.4, *, duration: float = 0.5) -> Motion:
        """Turn the joints at a speed, and brake when time is up.

        To go on, call it again before: the arm goes over from one speed to the next without stopping. Should no more
        calls come, because this program has ended or the link is gone, the robot brakes by itself.

        Args:
            qd: (6,) rad/s.
            acceleration: rad/s², for the change of speed and for the brake.
            duration: seconds until it brakes.
        """
        speeds = six(qd, "qd")
        model = self._equipment.model
        if model is not None:
            for joint, (value, limit) in enumerate(zip(speeds.tolist(), model.max_speed.tolist(), strict=True)):
                checked(value, f"qd[{joint}] ({JOINTS[joint]})", -limit, limit)
        duration = checked(duration, "duration", _LEAST, _HOUR)
        body = programs.speed_joints(self._equipment.firmware, speeds.tolist(), _acceleration(acceleration), duration)
        return self._begin(UploadedMotion("speed_joints", self._equipment, body, lasting(duration)))

    def speed_linear(self, xd: ArrayLike, acceleration: float = 1.2, *, duration: float = 0.5) -> Motion:
        """Move the tool at a speed in the base frame, and brake when time is up; see `speed_joints`.

        Args:
            xd: (6,) m/s, and rad/s about the three axes.
            acceleration: m/s².
            duration: seconds until it brakes.
        """
        speeds = six(xd, "xd")
        duration = checked(duration, "duration", _LEAST, _HOUR)
        body = programs.speed_linear(self._equipment.firmware, speeds.tolist(), _acceleration(acceleration), duration)
        return self._begin(UploadedMotion("speed_linear", self._equipment, body, lasting(duration)))

    def stop(self, acceleration: float = 2.0) -> Motion:
        """Brake all joints with so many rad/s². Done when the arm stands.

        An ordinary stop by the controller's program, no substitute for the emergency stop. It is sent whether or not
        `safety.enable()` was called; where a stop holds it is refused, and the arm stands.
        """
        body = programs.stop(_acceleration(acceleration))
        return self._begin(UploadedMotion("stop", self._equipment, body, brakes=True))

    # -- programs that talk back -------------------------------------------------------------------------

    def follow(
        self,
        trajectory: Trajectory,
        *,
        low_bandwidth: bool = False,
        path_tolerance: float | None = None,
        goal_tolerance: float = 0.01,
        goal_time: float = 1.0,
        start_tolerance: float = 0.05,
        feedback: Callable[[TrajectoryFeedback], object] | None = None,
        watchdog: float = 0.1,
        lookahead_time: float = 0.03,
        gain: float = 300.0,
    ) -> Motion:
        """Follow a trajectory from where the arm stands.

        Args:
            trajectory: what to follow; its first point is near the arm, and it is at rest at both ends.
            low_bandwidth: hand it over point by point, for the robot to interpolate, rather than stream it at the
                controller's rate; needs 3.0 or later.
            path_tolerance: rad that any joint may be off on the way; None for any distance. What the arm lags behind
                at speed by its own nature is part of it.
            goal_tolerance: rad that any joint may be off at the end.
            goal_time: seconds after the end within which the arm has to be there.
            start_tolerance: rad that any joint may be away from the first point.
            feedback: called with where the arm is and should be, from a thread of its own; may be slow, may raise.
            watchdog: seconds without a set-point after which the robot brakes by itself.
            lookahead_time: s, 0.03 to 0.2; how far ``servoj`` looks ahead: more is smoother and lags more. Not on CB2.
            gain: 100 to 2000; how stiffly ``servoj`` follows. Not on CB2.

        Raises:
            LocalError: `low_bandwidth` on a CB2.
            BadAddress: nobody can listen for the robot's connection at this port.
        """
        if not isinstance(trajectory, Trajectory):
            raise BadValue(f"{trajectory!r} is no Trajectory")
        equipment = self._equipment
        if low_bandwidth and equipment.firmware.is_cb2:
            raise LocalError(f"firmware {equipment.firmware} cannot interpolate by itself: without low_bandwidth only")
        tolerances = Tolerances(
            None if path_tolerance is None else checked(path_tolerance, "path_tolerance", 1e-6, 100.0),
            checked(goal_tolerance, "goal_tolerance", 1e-6, 100.0),
            checked(goal_time, "goal_time", 0.0, _HOUR),
            checked(start_tolerance, "start_tolerance", 1e-6, 1.0),
        )
        servoing = _servoing(watchdog, lookahead_time, gain)
        trajectory.check(equipment.model)
        running = self.current
        if running is None:
            # Otherwise it is looked at once the arm stands, after the motion before.
            trajectory.check(near=equipment.state().q_target, within=tolerances.start)
        if low_bandwidth:
            return self._begin(
                WaypointFollower(
                    equipment,
                    trajectory,
                    tolerances,
                    feedback,
                    lookahead_time=servoing.lookahead_time,
                    gain=servoing.gain,
                )
            )
        return self._begin(Follower(equipment, trajectory, tolerances, feedback, servoing))

    def servo(
        self,
        rate: float | None = None,
        *,
        watchdog: float = 0.1,
        lookahead_time: float = 0.03,
        gain: float = 300.0,
    ) -> Servo:
        """A line to the joints for a loop of your own::

            with robot.motion.servo() as servo:
                for state in robot.realtime:
                    servo.send(law(state))

        Args:
            rate: set-points a second that the loop means to send, for the statistics; None for the controller's rate.
            watchdog: seconds without a set-point after which the robot brakes by itself.
            lookahead_time, gain: see `follow`.
        """
        servoing = _servoing(watchdog, lookahead_time, gain)
        pace = float(self._equipment.firmware.rate) if rate is None else checked(rate, "rate", 0.1, 10_000.0)
        return Servo(self._equipment, pace, servoing, self._begin)

    # ----------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Cancel the motion that runs, and begin no more. Idempotent."""
        with self._lock:
            self._is_closed = True
            current = self._current
        if current is not None:
            current.cancel()

    def _begin(self, motion: _Kind) -> _Kind:
        """Start a motion in place of the one that runs."""
        with self._lock:
            if self._is_closed:
                raise Closed("the robot was closed")
            before = self.current
            if before is not None:
                before.make_way()
            try:
                motion.start()
            except BaseException:
                if before is not None:
                    before.go_on()
                raise
            self._current = motion
        if before is not None:
            before.supersede(motion)
        return motion


def _rates(speed: float, acceleration: float) -> tuple[float, float]:
    return checked(speed, "speed", _LEAST, _HARDEST), _acceleration(acceleration)


def _acceleration(value: float) -> float:
    return checked(value, "acceleration", _LEAST, _HARDEST)


def _servoing(watchdog: float, lookahead_time: float, gain: float) -> Servoing:
    return Servoing(
        checked(watchdog, "watchdog", 0.01, 10.0),
        checked(lookahead_time, "lookahead_time", 0.03, 0.2),
        checked(gain, "gain", 100.0, 2000.0),
    )


def _within(model: Model, q: FloatArray) -> None:
    for joint, (value, (low, high)) in enumerate(zip(q.tolist(), model.position_limits.tolist(), strict=True)):
        if not low <= value <= high:
            raise BadValue(
                f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad; a {model.name} reaches {low:.4f} to {high:.4f} rad"
            )
