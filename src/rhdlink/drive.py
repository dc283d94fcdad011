"""Motions of a mobile robot without a script: straight lines, turns, arcs, poses, and following lines and walls."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import threading
from collections.abc import Callable
from typing import NamedTuple

from linkcore import clock
from linkcore.arguments import check_choice, check_number
from linkcore.errors import BadValue, Closed, LinkTimeout
from linkcore.handle import Lifecycle, Motion
from linkcore.names import StrictAttributes
from linkcore.threads import CallbackThread, Closing, ReentrantEvent, started

from .host.world import Pose
from .smrcl.controller import MissionController
from .smrcl.execution import Callbacks, MissionExecution, leaving_at_exit
from .smrcl.motion.basic import FollowDirection, Forward, Stop, Wheels
from .smrcl.motion.control import ControlledMotion, MotionControl
from .smrcl.motion.following import FollowLine, FollowWall
from .smrcl.motion.topoint import DriveToPoint
from .smrcl.motion.turning import ArcTurn, Turn
from .smrcl.plan import Run
from .smrcl.planar_pose import PlanarPose
from .smrcl.profile import Profile, find_profile
from .smrcl.robot_conf import RobotConf
from .smrcl.robot_link import AnyRobot, open_link, suitable_conf
from .smrcl.sensors import LineKind

#: Largest accepted number of m or degrees; no mobile robot needs a larger one.
_MOST = 1e6
#: Largest accepted m/s and m/s2. The fastest robots with RHD drive a few m/s.
_FASTEST, _STRONGEST = 10.0, 100.0
#: Number of cycles in which a simulated robot comes to rest after a motion, before it receives the speed 0. In these
#: 5 s the heading error, which falls to 1/e in 1 s, becomes less than 0.01 degrees. A limit is necessary because a
#: heading counter might oscillate by one count forever.
_SETTLING = 500
#: Maximum time that other threads wait for the driving thread, in s.
_CLOSE_TIMEOUT = 5.0


class _Command(NamedTuple):
    """Request for a motion.

    Attributes:
        number: Number of the request, in the order in which motions were requested.
        motion: Motion to execute.
        life: Life of the motion's handle.
        begin: Function that the driving thread calls just before the motion begins.
    """

    number: int
    motion: ControlledMotion
    life: Lifecycle
    begin: Callable[[], object]


class _Motions:
    """Program of a `Drive`, which executes the motion that was requested last."""

    #: A drive has no script, so there is no run.
    run: Run | None = None

    def __init__(self, control: MotionControl) -> None:
        self._control = control
        # No lock is used, because a signal handler might stop the robot while its own thread requests a motion.
        # Any thread adds to this list. Only the driving thread removes items, or every thread after its end.
        self._requested: list[_Command] = []
        self._numbers = itertools.count(1)
        self._newest = 0  # number of the newest motion that has begun, or was preempted
        self._current: _Command | None = None
        self._error: Exception | None = None

    @property
    def is_idle(self) -> bool:
        """Whether no motion is requested or running."""
        return not self._requested and self._current is None

    def number(self) -> int:
        """Return the number for a new request. Call this at the start of the call that requests the motion."""
        return next(self._numbers)

    def put(self, command: _Command) -> None:
        """Begin a motion in the next cycle.

        The motion preempts all motions that were requested earlier, but none that was requested later.
        """
        self._requested.append(command)
        for each in list(self._requested):
            if each.number < command.number:
                each.life.cancel("preempted by another motion")
        if self._error is not None:
            self._refuse(self._error)

    def _refuse(self, error: Exception) -> None:
        while self._requested:
            with contextlib.suppress(IndexError):  # another thread has removed it
                self._requested.pop(0).life.fail(error)

    def _next(self) -> _Command | None:
        """Take the newest request if it is newer than the running motion.

        The other requests are cancelled.
        """
        requested = list(self._requested)
        del self._requested[: len(requested)]  # a request that was added meanwhile stays
        new = max(requested, key=lambda each: each.number, default=None)
        if new is not None and new.number < self._newest:
            new = None
        for each in requested:
            if each is not new:
                each.life.cancel("preempted by another motion")
        if new is not None:
            self._newest = new.number
        return new

    def step(self) -> bool:
        """Perform one cycle. Return False (not ended), because another motion can always follow."""
        new, current = self._next(), self._current
        if new is not None:
            self._current = None
            if current is not None:
                self._give_up()
                current.life.cancel("preempted by another motion")
            if not new.life.is_over:
                self._current = new
                new.begin()
                self._control.start(new.motion)
                new.life.begin()
        elif current is not None and current.life.is_over:  # cancelled
            self._current = None
            self._give_up()
            self._control.start(Stop())
        elif current is not None and current.motion.is_done(self._control):
            self._current = None
            current.life.finish()
        return False

    def _give_up(self) -> None:
        """Let the next motion begin at the current pose instead of the end of the current motion."""
        self._control.target = self._control.pose.copy()

    def end(self, error: Exception) -> None:
        """End the running motion, and refuse motions that are requested later."""
        self._error = self._error or error
        self._refuse(self._error)
        current, self._current = self._current, None
        if current is not None:
            current.life.fail(error)


class Drive(StrictAttributes, Closing):
    """Driver that moves a robot with single motions. Use it as a context manager::

        with rhdlink.Drive(robot) as drive:
            drive.forward(0.5).wait()
            drive.turn(90).wait()
            drive.to(0.0, 0.0, 180.0).wait()

    Each motion is a handle: you can wait for it, await it or cancel it. A motion that begins while another one is
    running preempts it, and starts at the current speed of the robot. Distances are in m and angles in degrees;
    positive angles are to the left. Poses are those of the robot's odometry, which begins at 0, 0, 0.

    A thread exchanges values with the robot at each tick. The time of a simulated robot such as `Turtle()` advances
    only with these exchanges. Such a robot moves while there is a motion and until it is at rest, and then its time
    stops.

    Args:
        robot: Robot that is connected with write access, an address, or a plugin such as `Turtle()`.
        speed: Default speed of motions, in m/s, above 0 and at most 10. The sign of the distance or the angle gives the
            direction.
        acceleration: Acceleration in m/s2, above 0 and at most 100.
        conf: Description of the robot; see `Mission`.
        compat: "sound", or "mrc" for motions that end in the same way as in MRC.

    Raises:
        BadValue: If an argument is not valid.
        BadConfiguration: If `conf` cannot be read, or contains an invalid setting.
        AccessDenied, WrongVariables: If the robot cannot be driven. Connecting can raise other errors; see
            `rhdlink.connect`.
    """

    def __init__(
        self,
        robot: AnyRobot,
        *,
        speed: float = 0.3,
        acceleration: float = 0.3,
        conf: RobotConf | str | os.PathLike[str] | None = None,
        compat: Profile | str = "sound",
    ) -> None:
        self._speed = _positive("speed", speed, _FASTEST, "m/s")
        self._acceleration = _positive("acceleration", acceleration, _STRONGEST, "m/s²")
        chosen = find_profile(compat)
        self._wake = ReentrantEvent()
        self._closing = ReentrantEvent()
        self._error: Exception | None = None
        self._link = link = open_link(robot)
        self._owned = None if link is robot else link
        try:
            controller = MissionController(suitable_conf(conf, link), link.read, link.write, profile=chosen, warm_up=0)
            self._controller = controller
            self._vehicle = controller.vehicle
            self._motions = _Motions(self._vehicle.control)
            controller.execute(self._motions)
            self._execution = MissionExecution(link, controller, Callbacks())
            self._callbacks = CallbackThread(f"drive {link.name} callbacks")
            self._thread = threading.Thread(target=self._run_in_thread, name=f"drive {link.name}", daemon=True)
            started(self._thread)
        except BaseException:
            self._close_link()
            raise

    # -- motions -------------------------------------------------------------------------------------

    def forward(self, distance: float, *, speed: float | None = None) -> Motion:
        """Drive straight ahead by `distance` m, or backward if it is negative.

        The robot slows down before obstacles and before the end. The distance is measured from the target of the
        previous motion, so that errors do not add up.

        Raises:
            BadValue: If `distance` is not a number, or `speed` is not above 0 and at most 10 m/s. All motions check
                their numbers in this way, and the robot does not move.
            Closed: If the drive was closed or has failed.
        """
        return self._begin("forward", Forward(_number("distance", distance)), speed)

    def turn(self, angle: float, *, speed: float | None = None) -> Motion:
        """Turn on the spot by `angle` degrees; more than 180 is allowed.

        `speed` is the speed of a wheel.
        """
        return self._begin("turn", Turn(math.radians(_number("angle", angle))), speed)

    def arc(self, radius: float, angle: float, *, speed: float | None = None) -> Motion:
        """Drive an arc of `radius` m until the robot has turned by `angle` degrees.

        The robot stops just after it has turned by the angle.
        """
        return self._begin("arc", ArcTurn(_positive("radius", radius), math.radians(_number("angle", angle))), speed)

    def to(self, x: float, y: float, heading: float, *, radius: float = 0.3, speed: float | None = None) -> Motion:
        """Drive to a pose along the shortest path, forward or backward.

        The path is an arc, a straight line and an arc.

        The motion ends a few centimetres and degrees away from the pose, because nothing corrects it on the path.
        """
        goal = PlanarPose(_number("x", x), _number("y", y), math.radians(_number("heading", heading)))
        return self._begin("to", DriveToPoint(goal, _positive("radius", radius), is_absolute=True), speed)

    def along(self, x: float, y: float, direction: float, *, speed: float | None = None) -> Motion:
        """Drive along the line through (x, y) in `direction`.

        The motion continues until another motion begins or it is cancelled.
        """
        place = _number("x", x), _number("y", y), math.radians(_number("direction", direction))
        control = self._vehicle.control

        def begin() -> None:
            control.distance = 0.0
            control.reference.set(*place)

        return self._begin("along", FollowDirection(), speed, begin)

    def follow_line(self, kind: str = "bm", *, speed: float | None = None) -> Motion:
        """Follow a line on the floor until another motion begins or this one is cancelled.

        `kind` is "bm" for the middle of a black line, "br" or "bl" for its edges, or "wm" for a white line. The robot
        stops after 0.2 m without a line.
        """
        try:
            wanted = LineKind(kind)
        except ValueError:
            raise BadValue(f"kind is {kind!r}; expected one of {', '.join(each.value for each in LineKind)}") from None

        def begin() -> None:
            self._vehicle.line_kind = wanted

        return self._begin("follow_line", FollowLine(), speed, begin)

    def follow_wall(self, side: str, distance: float, *, speed: float | None = None) -> Motion:
        """Follow a wall on the "left" or "right" at `distance` m.

        The motion continues until another motion begins or it is cancelled.
        """
        check_choice(side, "side", ("left", "right"))
        return self._begin("follow_wall", FollowWall(side == "left", _positive("distance", distance)), speed)

    def wheels(self, left: float, right: float) -> Motion:
        """Set the speeds of the wheels, -10 to 10 m/s, until another motion begins.

        The handle is done immediately.
        """
        return self._begin("wheels", Wheels(_wheel("left", left), _wheel("right", right)), None)

    def stop(self) -> Motion:
        """Stop, and hold the heading."""
        return self._begin("stop", Stop(), None)

    def _begin(
        self, name: str, motion: ControlledMotion, speed: float | None, begin: Callable[[], object] = lambda: None
    ) -> Motion:
        number = self._motions.number()
        if self._closing.is_set() or self._error is not None:
            raise Closed(f"{self._link.name}: the drive has ended; create a new Drive") from self._error
        wanted = self._speed if speed is None else _positive("speed", speed, _FASTEST, "m/s")
        control = self._vehicle.control

        def prepare() -> None:
            control.speed, control.acceleration = wanted, self._acceleration
            begin()

        life = Lifecycle(name, self._callbacks)
        life.brake = self._wake.set
        handle = Motion(life, lambda: motion.progress(control) if control.motion is motion else 0.0)
        self._motions.put(_Command(number, motion, life, prepare))
        self._wake.set()
        return handle

    # -- what is known -------------------------------------------------------------------------------

    @property
    def pose(self) -> Pose:
        """Pose of the robot from its odometry: x in m, y in m, heading in rad."""
        pose = self._vehicle.odometry.pose
        return Pose(pose.x, pose.y, pose.th)

    @property
    def velocity(self) -> float:
        """Speed of the robot from its odometry, in m/s."""
        return self._vehicle.odometry.velocity

    @property
    def line_position(self) -> float:
        """Position of the followed line, in cm to the left; nan if no sensor detects a difference."""
        return self._vehicle.line_position()

    @property
    def distances(self) -> tuple[float, ...]:
        """Infrared distances in m, from left to right; zeros without sensors.

        The order is left, front left, front middle, front right, right.
        """
        return tuple(self._vehicle.infrared.distances[:5])

    @property
    def error(self) -> Exception | None:
        """Error that ended the drive; None while it is running, and after `close`."""
        return self._error

    # -- its thread ----------------------------------------------------------------------------------

    def _run_in_thread(self) -> None:
        with leaving_at_exit(self._leave):
            self._run()

    def _leave(self) -> None:
        self._closing.set()
        self._wake.set()
        clock.join(self._thread, _CLOSE_TIMEOUT)

    def _run(self) -> None:
        settling = 0
        try:
            while not self._closing.is_set():
                if not self._motions.is_idle:
                    settling = _SETTLING
                elif self._link.is_lockstep:
                    settling -= 1
                    if settling <= 0 or self._stands:
                        if not self._stands:
                            self._execution.stand()
                        self._rest()
                        continue
                self._execution.cycle()
                self._controller.take_said()
                if self._execution.error is not None:
                    raise self._execution.error
        except Exception as error:
            self._error = error
            self._motions.end(error)
        finally:
            self._execution.stand()
            self._motions.end(Closed(f"{self._link.name}: the drive has ended; create a new Drive"))

    def _rest(self) -> None:
        """In lockstep, stop advancing the robot's time until a motion is requested."""
        while self._motions.is_idle and not self._closing.is_set():
            clock.wait(self._wake.wait)
            self._wake.clear()

    @property
    def _stands(self) -> bool:
        """Whether the commanded speed is zero, and the robot has received this command."""
        return not self._vehicle.outputs.has_speed and self._execution.is_unchanged

    def close(self) -> None:
        """Stop the robot and end the drive. Idempotent.

        Raises:
            LinkTimeout: If the robot does not answer.
        """
        self._leave()
        if self._thread.is_alive():
            raise LinkTimeout(f"{self._link.name} has not answered within {_CLOSE_TIMEOUT:g} s")
        self._close_link()
        self._callbacks.close(_CLOSE_TIMEOUT)

    def _close_link(self) -> None:
        if self._owned is not None:
            self._owned.close()

    def __repr__(self) -> str:
        x, y, theta = self.pose
        state = "closed" if self._closing.is_set() else "failed" if self._error else "idle"
        if not self._motions.is_idle:
            state = "moving"
        return f"<Drive {self._link.name} {state} at x {x:.3f} m, y {y:.3f} m, heading {math.degrees(theta):.1f} deg>"


def _number(name: str, value: float) -> float:
    return check_number(value, name, -_MOST, _MOST)


def _wheel(name: str, value: float) -> float:
    return check_number(value, name, -_FASTEST, _FASTEST, "m/s")


def _positive(name: str, value: float, most: float = _MOST, unit: str = "") -> float:
    number = check_number(value, name, 0.0, most, unit)
    if number == 0.0:
        raise BadValue(f"{name} is {value!r}; expected a number above 0{unit and f' and up to {most:g} {unit}'}")
    return number
