"""`robot.motion`: the methods that start a motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from linkcore.arguments import Default, check_choice, check_number, check_overridden, check_wait
from linkcore.errors import BadValue, LocalError
from linkcore.handle import Motion, waited
from linkcore.names import StrictAttributes
from linkcore.pending_call import starts_motion

from ..arm.bounds import JOINT_ACCELERATION, JOINT_SPEED, TOOL_ACCELERATION, TOOL_SPEED, check_pose, check_speeds
from ..arm.models import Model
from ..arm.vectors import FloatArray, Numbers, numbers, six
from ..command.program_time import ProgramTimer, ScalingName, end_where_moved
from ..protocol.firmware import Firmware
from ..protocol.realtime.packets import RealtimeState
from ..script import commands, force_control
from ..script.wrapping import HAS_REGISTERS
from .context import MotionContext
from .limited import RAMP, LimitedArm, evenly_timed
from .links.register_link import RegisterPort
from .moves.path import Circular, Linear, PathMotion, Rates, Waypoint, check_tool_way, plan, shown_tcp, way_to
from .moves.speed_limit import check_joint_speeds, largest_speeds
from .moves.trajectory import Trajectory
from .points.point import KeepName, Point, goal_joints, goal_pose
from .servo.follower import Follower
from .servo.following import Following, Tolerances, TrajectoryFeedback, stands
from .servo.force_control import ContactMotion, ForceMode, Freedrive, Torque, axes_of, frame_of
from .servo.impedance import Impedance
from .servo.impedance_parameters import ImpedanceParameters
from .servo.jerk_limited import joint_limits
from .servo.jog import UNLED, FrameName, HeldSpeed, Jog
from .servo.linked_program import Link, LinkedProgram
from .servo.servo import Servo
from .servo.setpoints import Servoing
from .servo.waypoints import WaypointServer
from .slider import SliderEffect, slider
from .stream.point_stream import PointStream

if TYPE_CHECKING:
    from ..arm.kinematics import Arm

#: Smallest accepted value of numbers that must be positive. Longest accepted duration, one hour in s: a longer duration
#: is probably a mistake.
_LEAST, _HOUR = 1e-3, 3600.0
#: Largest rate of targets for a filter, in Hz.
_MOST_TARGETS = 10_000.0
#: First firmware with a time argument for speedl, first firmware that detects contacts, and force in N that counts as a
#: contact on older firmware.
_TIMED_SPEED, _TOOL_CONTACT, _CONTACT_FORCE = Firmware(3, 3), Firmware(5, 4), 20.0
#: Part of an error message: state of a motion after the connection was lost.
_MAY_GO_ON = "the arm might still move until the motion ends"

#: Names of filters that convert targets to set-points of a servo.
TargetFilterName = Literal["jerk_limited"]
#: Names of links over which set-points are sent to the robot.
LinkName = Literal["reverse", "rtde"]


# Motions that consist of one short program have no class, so their slider effects are declared here.
@slider(move_joints=SliderEffect.SCALED)
class Motions(StrictAttributes):
    """Methods that move the arm. Each method returns the handle of a motion.

    By default, the methods do not wait for the arm. With ``wait=True``, a method returns when the motion has finished,
    or raises the error that ended the motion. The method waits up to 60 s, or up to the number of seconds that you pass
    as `wait`. After this time, the method raises `LinkTimeout`, and the motion continues. Ctrl-C during the wait
    cancels the motion, as in `Handle.wait`.

    Starting a motion preempts the current motion. The `wait` of the preempted motion then raises `Cancelled`. All
    methods raise `BadValue` for arguments that are invalid or exceed the limits of the arm. If the session has limits
    (`connect(limits=)`), they raise `LimitExceeded` for motions that would exceed them. They raise `SafetyStop`,
    `NotEnabled` or `NotRunning` if the arm may not be moved now. In all these cases, nothing is sent.
    """

    def __init__(self, context: MotionContext) -> None:
        self._context = context

    @property
    def current(self) -> Motion | None:
        """Motion that is running now; None if no motion is running."""
        life = self._context.programs.current
        handle = None if life is None else life.handle
        return handle if isinstance(handle, Motion) else None

    # -- one command -----------------------------------------------------------------------------------

    @starts_motion
    def move_joints(
        self,
        q: Numbers | Point,
        speed: float = Default(1.05),
        acceleration: float = Default(1.4),
        *,
        time: float | None = None,
        keep: KeepName | None = None,
        wait: bool | float = False,
    ) -> Motion:
        """Move all joints to a position, in a straight line in joint space (URScript: `movej`).

        Args:
            q: Joint positions, shape (6,), in rad; or a point of `Robot.points`.
            speed: Speed of the joint that moves furthest, in rad/s.
            acceleration: Acceleration of the joint that moves furthest, in rad/s².
            time: Duration in seconds. It cannot be combined with `speed` or `acceleration`.
            keep: What to keep if the TCP has changed since the point was taught. With "pose", the current TCP moves to
                the taught pose, in the taught configuration of the arm. With "joints", the arm moves to the taught
                joint positions. If None, the motion is refused. Only for a point.
            wait: See `Motions`.

        Raises:
            BadValue: If a point belongs to another arm model, or if the TCP has changed and `keep` is None.
            Unreachable: If the current TCP does not reach the pose of a point in the taught configuration.
        """
        seconds = check_wait(wait)
        duration = _time(time, speed, acceleration)
        goal = six(self._of_point(goal_joints, q, keep), "q")
        model = self._context.who.identity.arm
        if model is not None:
            model.check_joints(goal)
        rates = _joint_rates(model, speed, acceleration)
        limited = self._limited("move_joints")
        if limited is not None:
            rates, duration = _timed(rates, duration, float(np.abs(goal - limited.q).max())), None
            limited.check_joint_way(goal, *rates)
        body = commands.move_joints(goal.tolist(), *rates, duration)
        return waited(
            self._upload("move_joints", body, _arriving(goal, lambda state: state.q_actual), has_goal=True), seconds
        )

    @starts_motion
    def move_linear(
        self,
        pose: Numbers | Point,
        speed: float = Default(0.25),
        acceleration: float = Default(1.2),
        *,
        time: float | None = None,
        keep: KeepName | None = None,
        wait: bool | float = False,
    ) -> Motion:
        """Move the tool to a pose in the base frame, in a straight line (URScript: `movel`).

        Args:
            pose: Position in m and rotation vector in rad, shape (6,); or a point of `Robot.points`.
            speed: Speed of the tool, in m/s.
            acceleration: Acceleration of the tool, in m/s².
            time: Duration in seconds. It cannot be combined with `speed` or `acceleration`.
            keep: See `move_joints`. With "joints", the tool moves to the pose of the current TCP at the taught joint
                positions.
            wait: See `Motions`.

        Raises:
            BadValue, Unreachable: See `move_joints`.
        """
        seconds = check_wait(wait)
        duration = _time(time, speed, acceleration)
        goal = check_pose(self._of_point(goal_pose, pose, keep), "pose")
        rates = _tool_rates(speed, acceleration)
        self._check_reach(goal)
        limited = self._limited("move_linear")
        if limited is not None:
            rates, duration = _timed(rates, duration, way_to(limited, goal)), None
            check_tool_way(Linear(goal), Rates(*rates), limited)
        body = commands.move_linear(goal.tolist(), *rates, duration)
        # Compare only the position of the pose, because one rotation has more than one rotation vector.
        gauge = _arriving(goal[:3], lambda state: state.tool_vector_actual[:3])
        motion = self._upload("move_linear", body, gauge, has_goal=True)
        return waited(motion, seconds)

    @starts_motion
    def move_circular(
        self, via: Numbers, to: Numbers, speed: float = 0.25, acceleration: float = 1.2, *, wait: bool | float = False
    ) -> Motion:
        """Move the tool to a pose in the base frame, on a circular arc through another pose (`movec`).

        Args:
            via: Pose on the arc, shape (6,): position in m, and rotation vector in rad. Only the position of this pose
                is used.
            to: Pose at the end, shape (6,).
            speed: Speed of the tool, in m/s.
            acceleration: Acceleration of the tool, in m/s².
            wait: See `Motions`.
        """
        from ..arm.curves import Arc

        seconds = check_wait(wait)
        between, goal = check_pose(via, "via"), check_pose(to, "to")
        body = commands.move_circular(between.tolist(), goal.tolist(), *_tool_rates(speed, acceleration))
        self._check_reach(goal)
        limited = self._limited("move_circular")
        if limited is not None:
            check_tool_way(Circular(between, goal), Rates(*_tool_rates(speed, acceleration)), limited)
        # The arc starts at the current position. If the arm is still moving, it comes to rest close to this position.
        arc = Arc(self._context.state().tool_vector_actual.tolist(), between.tolist(), goal.tolist())
        motion = self._upload(
            "move_circular", body, lambda state: arc.part(state.tool_vector_actual.tolist()), has_goal=True
        )
        return waited(motion, seconds)

    @starts_motion
    def path(
        self,
        waypoints: Sequence[Waypoint],
        speed: float = 0.25,
        acceleration: float = 1.2,
        *,
        joint_speed: float = 1.05,
        joint_acceleration: float = 1.4,
        wait: bool | float = False,
    ) -> PathMotion:
        """Move through several waypoints in one motion.

        At a waypoint with a blend, the arm rounds the corner without a stop. Before urlink sends the path, it checks
        the path, starting at the current position of the arm. Every point of a line or an arc must be reachable in the
        current configuration of the arm, within the limits of the joints. No joint may get too fast, and blends must
        not overlap. Corners are checked as if they had no blends. Collisions are not checked.

        The check needs the model of the arm, which firmware 1.8 or later reports. If the model is unknown, only the
        ranges of the numbers are checked.

        Args:
            waypoints: `Joint`, `Linear` and `Circular` waypoints, each with a blend and optionally with a speed and an
                acceleration.
            speed, acceleration: Speed and acceleration of the tool on lines and arcs, in m/s and m/s².
            joint_speed, joint_acceleration: Speed and acceleration of the joint that moves furthest, for motions to a
                `Joint` waypoint, in rad/s and rad/s².
            wait: See `Motions`.

        Raises:
            BadValue: If a waypoint cannot be used. The message names the waypoint and the reason.
            LinkTimeout: If no state arrives, so that the position of the arm is unknown.
        """
        seconds = check_wait(wait)
        context = self._context
        identity = context.who.identity
        arm = None if identity.arm is None else identity.kinematics
        joint_rates = Rates(*_joint_rates(identity.arm, joint_speed, joint_acceleration, "joint_"))
        tool_rates = Rates(*_tool_rates(speed, acceleration))
        planned = plan(list(waypoints), joint_rates, tool_rates, arm, context.state(), self._limited("path"))
        life = context.programs.life("path")
        motion = PathMotion(life, planned.sections, lambda: context.realtime.latest)
        wrapped = context.programs.own(planned.body)
        end_where_moved(life, context.realtime)
        context.programs.start(wrapped, life, left_alone=_MAY_GO_ON, on_text=motion._on_text)
        return waited(motion, seconds)

    @starts_motion
    def speed_joints(
        self,
        qd: Numbers,
        acceleration: float = 1.4,
        *,
        duration: float = 0.5,
        link: LinkName = "reverse",
        wait: bool | float = False,
    ) -> Motion:
        """Move the joints at a speed, and brake after `duration` (URScript: `speedj`).

        To continue, call this method again before the motion ends. The arm then changes from one speed to the next
        without stopping. If no further call comes, for example because your program has ended or the connection is
        lost, the robot brakes on its own, after 0.5 s at most:

        - For a `duration` up to 0.5 s, one program is sent. If another speed precedes this one, the program does not
          wait for a start permission. If the controller hangs, the robot **might still execute this program** later,
          for the time `duration`.
        - A longer motion is controlled over a `link` with a watchdog of 0.5 s. If the next call has a `duration` of
          0.5 s or more and the same `acceleration`, it changes the speed and the duration, and returns the same handle.
        - In a session with limits, every motion is controlled over a `link`, with a watchdog of 0.2 s. If the arm comes
          too close to a limit, it brakes, and the motion ends with `LimitExceeded`.

        Args:
            qd: Speeds of the joints, shape (6,), in rad/s.
            acceleration: Acceleration in rad/s², for changes of speed and for braking.
            duration: Time until the arm brakes, in seconds.
            link: See `follow`. Without limits of the session, it has no effect for a `duration` up to 0.5 s.
            wait: See `Motions`.
        """
        seconds = check_wait(wait)
        arm = self._context.who.identity.arm
        speeds, hardest = check_joint_speeds(qd, "qd", arm), _joint_acceleration(arm, acceleration)
        motion = self._speed("speed_joints", speeds, hardest, duration, link)
        return waited(motion, seconds)

    @starts_motion
    def speed_linear(
        self,
        xd: Numbers,
        acceleration: float = 1.2,
        *,
        duration: float = 0.5,
        link: LinkName = "reverse",
        wait: bool | float = False,
    ) -> Motion:
        """Move the tool at a speed in the base frame, and brake after `duration` (`speedl`).

        For the details, see `speed_joints`.

        Args:
            xd: Speed of the tool in m/s, and rotation about the three axes in rad/s, shape (6,).
            acceleration: Acceleration in m/s².
            duration: Time until the arm brakes, in seconds.
            link: See `follow`. Without limits of the session, it has no effect for a `duration` up to 0.5 s.
            wait: See `Motions`.
        """
        seconds = check_wait(wait)
        speeds, hardest = check_speeds(xd, "xd"), TOOL_ACCELERATION.check(acceleration, "acceleration")
        motion = self._speed("speed_linear", speeds, hardest, duration, link)
        return waited(motion, seconds)

    @starts_motion
    def stop(self, acceleration: float = 2.0, *, wait: bool | float = False) -> Motion:
        """Brake all joints with `acceleration`, in rad/s² (`stopj`).

        The motion finishes when the arm is at rest. This is an ordinary stop by a program on the controller. It does
        not replace the emergency stop. The stop is sent even if `safety.enable()` was not called. During a safety stop,
        this method is refused, because the arm is then at rest anyway.
        """
        seconds = check_wait(wait)
        body = commands.stop(_joint_acceleration(self._context.who.identity.arm, acceleration))
        self._context.channel.overtake("the robot was stopped")
        return waited(self._upload("stop", body, is_stop=True), seconds)

    # -- motions with a link to a program on the robot ---------------------------------------------------

    @starts_motion
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
        delay: float | None = None,
        watchdog: float = 0.1,
        lookahead_time: float = 0.03,
        gain: float = 300.0,
        scaling: ScalingName = "follow",
        link: LinkName = "reverse",
        wait: bool | float = False,
    ) -> Motion:
        """Follow a trajectory, starting at the current position of the arm.

        The time of the trajectory advances with the time of the program on the robot. The speed slider, the
        controller's own limits and a pause slow down or stop this time. The arm stays on the path.

        Args:
            trajectory: Trajectory to follow. The speeds must be zero at both ends, and the first point must be close to
                the position of the arm.
            low_bandwidth: Whether urlink sends only the points of the trajectory, and the robot interpolates between
                them. If False, urlink sends a set-point in each cycle of the controller. True needs firmware 3.0 or
                later.
            path_tolerance: Largest deviation of any joint before the end, in rad. This deviation includes the lag of
                the moving arm behind its set-points. If None, there is no limit.
            goal_tolerance: Largest deviation of any joint at the end, in rad.
            goal_time: Time after the end within which the arm must reach the goal, in seconds of the trajectory's time.
            start_tolerance: Largest distance of any joint from the first point, in rad. If the distance is larger, the
                trajectory is rejected. The same limit applies after a pause, to the distance of any joint from the
                position where the arm came to rest in the pause. If this distance is larger, the motion ends with
                `ToleranceExceeded`.
            feedback: Function that receives the actual and the desired position of the arm. urlink calls this function
                in a dedicated thread. The function may be slow, and may raise exceptions.
            delay: Lag of the arm behind its set-points in s, as measured by `Servo.measure_delay`. Tolerances and
                feedback then do not include this lag. The value has no effect on the times at which set-points are
                sent. If None, the value is two cycles, the time that a set-point takes to arrive.
            watchdog: Longest time without a set-point, in seconds. After this time, the robot brakes on its own.
            lookahead_time: Look-ahead time of ``servoj``, 0.03 to 0.2 s. A larger value makes the motion smoother and
                increases the lag. It has no effect on CB2.
            gain: Stiffness of ``servoj``, 100 to 2000. It has no effect on CB2.
            scaling: "follow" for a trajectory that advances with the time of the program on the robot. "ignore" for a
                trajectory that follows the controller's clock at any speed scaling. If the scaling is then below 100 %,
                the arm lags behind and cuts the curves of the path. To catch up, it may move at the full speed of its
                joints. Set `path_tolerance` if you use "ignore".
            link: Link for the set-points. "reverse" is a connection that the robot makes to this computer.
                "rtde" uses input registers of the robot, so the robot does not have to connect to this computer. It
                requires firmware 3.9 or later on CB3, or 5.3 or later on e-Series.
            wait: See `Motions`.

        Raises:
            LocalError: If `low_bandwidth` is used on a CB2 or over "rtde", or if the firmware does not have the
                registers for "rtde".
            BadAddress: If the port for the robot's connection cannot be opened.
            InputInUse: If another RTDE client or a fieldbus has reserved a register.
        """
        seconds = check_wait(wait)
        if not isinstance(trajectory, Trajectory):
            raise BadValue(f"{trajectory!r} is not a Trajectory")
        context, firmware = self._context, self._context.who.identity.firmware
        if low_bandwidth and firmware.is_cb2:
            raise LocalError(f"firmware {firmware} cannot interpolate on its own; omit low_bandwidth")
        open_link = self._opener(link)
        if low_bandwidth and link == "rtde":
            raise LocalError("low_bandwidth needs link='reverse': the program requests its points over the connection")
        if low_bandwidth and scaling == "ignore":
            raise LocalError("low_bandwidth does not support scaling='ignore': the robot interpolates in its own time")
        if low_bandwidth and delay is not None:
            raise LocalError("low_bandwidth does not support delay: the robot follows its own clock")
        tolerances = Tolerances.checked(path_tolerance, goal_tolerance, goal_time, start_tolerance)
        servoing = self._servoing(watchdog, lookahead_time, gain)
        check_choice(scaling, "scaling", get_args(ScalingName))
        model = context.who.identity.arm
        trajectory.check(model)
        limited = self._limited("follow")
        if limited is not None:
            limited.check_trajectory(trajectory, begins_slowly=True)
        state = context.state()
        if self.current is None and stands(state.qd_target):
            # Otherwise the start is checked later, when the arm is at rest after the previous motion. Even if the
            # previous motion has already ended, the newest state may be from shortly before its end.
            trajectory.check(near=state.q_target, within=tolerances.start)
        if low_bandwidth:
            following: Following = WaypointServer(trajectory, tolerances, firmware, lookahead_time, gain)
        else:
            timer = ProgramTimer(1.0 / firmware.rate, scaling)
            if limited is not None:
                # The start of the program stretches its time. An arm that falls behind exceeds its speed to catch up.
                timer.restart()
            following = Follower(trajectory, tolerances, servoing, _delay(delay), timer)
        life = context.programs.life("follow")
        motion = Motion(life, lambda: following.progress)
        if feedback is not None:
            # The subscription has its own queue and thread, because the function may be slow and may raise exceptions.
            subscription = context.realtime.subscribe(_reporter(following, feedback))
            life.on_end(lambda: subscription.close(0))
        LinkedProgram(life, context, following, open_link, tolerance=tolerances.start).begin()
        return waited(motion, seconds)

    def servo(
        self,
        rate: float | None = None,
        *,
        target_filter: TargetFilterName | None = None,
        speed: ArrayLike = Default(1.05),
        acceleration: ArrayLike = Default(3.0),
        jerk: ArrayLike = Default(30.0),
        delay: float | None = None,
        watchdog: float = 0.1,
        lookahead_time: float = 0.03,
        gain: float = 300.0,
        link: LinkName = "reverse",
    ) -> Servo:
        """Return a `Servo`, which sends set-points from your own loop (URScript: `servoj`).

        Use it as a ``with`` block::

            with robot.motion.servo() as servo:
                for state in robot.realtime:
                    servo.send(law(state))

        With ``target_filter="jerk_limited"``, the loop sends targets instead. The loop may send any target at any time,
        even if the target is far away. The arm moves to the newest target, and never exceeds the limits of speed,
        acceleration and jerk (`urlink.motion.servo.jerk_limited`).

        Args:
            rate: Number of set-points or targets that your loop intends to send per second. It is used for the
                statistics, and for the check of set-points. If None, the controller's rate. The rate of set-points
                cannot be higher than the controller's rate, but the rate of targets can.
            target_filter: "jerk_limited", or None for a loop that sends set-points.
            speed, acceleration, jerk: Limits of the target filter, in rad/s, rad/s² and rad/s³: one number for all
                joints, or shape (6,). Without a filter, these arguments are rejected, because set-points would not be
                limited.
            delay: Lag of the arm behind its set-points in s, as measured by `Servo.measure_delay`. With `schedule`,
                set-points are sent earlier by this time, so that the arm is at each waypoint in time. If None, the
                value is two cycles, the time that a set-point takes to arrive. This argument cannot be combined with a
                filter.
            watchdog: Longest time without a set-point, in seconds. After this time, the robot brakes on its own.
            lookahead_time, gain, link: See `follow`.
        """
        firmware = self._context.who.identity.firmware
        fastest = float(firmware.rate) if target_filter is None else _MOST_TARGETS
        whose = f"firmware {firmware}" if target_filter is None else ""
        pace = float(firmware.rate) if rate is None else check_number(rate, "rate", 0.1, fastest, "Hz", whose)
        # With a filter, a set-point is computed in each cycle, independent of the rate of targets.
        servoing = self._servoing(watchdog, lookahead_time, gain, 1.0 / pace if target_filter is None else 0.0)
        limits = None
        if target_filter is None:
            no_filter = "only a target filter has limits (target_filter='jerk_limited')"
            check_overridden(no_filter, speed=speed, acceleration=acceleration, jerk=jerk)
        else:
            check_choice(target_filter, "target_filter", get_args(TargetFilterName))
            check_overridden("schedule() is not available with a target filter", delay=delay)
            limits = joint_limits(self._context.who.identity.arm, speed, acceleration, jerk)
            if self._context.limits is not None:
                self._context.limits.check_joint_speeds(np.array([[limit.speed for limit in limits]]))
        return Servo(self._context, pace, servoing, self._opener(link), limits, _delay(delay))

    def stream(
        self,
        buffer: float = 0.5,
        *,
        acceleration: ArrayLike = 10.0,
        jerk: ArrayLike = 100.0,
        watchdog: float = 1.0,
        lookahead_time: float = 0.03,
        gain: float = 300.0,
        link: LinkName = "reverse",
    ) -> PointStream:
        """Return a `PointStream`, to which timed points are appended while the arm moves.

        This needs firmware 3.4 or later. Use it as a ``with`` block::

            with robot.motion.stream() as stream:
                for q, qd in planner:
                    stream.append(TrajectoryPoint(q, stream.end + 0.1, qd))
                stream.wait_until_dry()

        A program on the robot buffers the next points, and interpolates between them with the positions, speeds and
        accelerations of the points. The speed slider slows this program down. If this computer is delayed, the arm
        keeps moving for the duration of the buffered points. If no point is left, the arm brakes. The next points then
        continue the motion.

        Args:
            buffer: Duration of the points that the program on the robot buffers, in s. It buffers at most 256 points.
                If your program hangs, the arm keeps moving for this time, unless the watchdog ends the motion earlier.
            acceleration, jerk: Limits in rad/s² and rad/s³, one number for all joints, or shape (6,). The limits apply
                to braking if no point is left, and to paths onto points that arrive late or replace others.
            watchdog: Longest time without a message from this computer, in seconds. After this time, the program brakes
                and ends. This computer answers each state with a message.
            lookahead_time, gain: See `follow`.
            link: See `follow`. With "rtde", a stream uses different registers than other motions:
                `input_int_register_30` to `43` and `input_double_register_24` to `35`. The program writes its reports
                to `output_int_register_30` to `36`.

        Raises:
            LocalError: If the firmware is older than 3.4. With "rtde", if it is older than 3.9 on CB3, or older than
                5.3 on e-Series.
        """
        arm = self._context.who.identity.arm
        servoing = self._servoing(check_number(watchdog, "watchdog", 0.1, 2.0), lookahead_time, gain)
        limits = joint_limits(arm, self._largest_speeds(), acceleration, jerk)
        seconds = check_number(buffer, "buffer", 0.05, 10.0, "s")
        opener = self._opener(link, self._context.point_registers)
        return PointStream(self._context, seconds, limits, servoing, opener)

    def jog(
        self,
        frame: FrameName = "joints",
        *,
        acceleration: float = 1.2,
        timeout: float = 0.3,
        watchdog: float = 0.2,
        link: LinkName = "reverse",
    ) -> Jog:
        """Return a `Jog`, which moves the arm at speeds that a person sets with a joystick or keys.

        Use it as a ``with`` block::

            with robot.motion.jog("base") as jog:
                while held():
                    jog.move([0, 0, 0.05, 0, 0, 0])

        A speed expires `timeout` seconds after the last call of `move`. Then the arm brakes. If this program or the
        connection fails, the robot brakes on its own after `watchdog` seconds.

        Args:
            frame: "joints" for speeds of the joints. "base" or "tool" for speeds of the tool, along and about the axes
                of this frame.
            acceleration: Acceleration for every change of speed and for braking: for joints, in rad/s², of the joint
                with the largest change of speed; for the tool, in m/s² and rad/s².
            timeout: Time until a speed expires, in seconds.
            watchdog: Longest time without a message from this computer, in seconds. After this time, the robot brakes.
            link: See `follow`.
        """
        check_choice(frame, "frame", get_args(FrameName))
        arm = self._context.who.identity.arm
        return Jog(
            self._context,
            frame,
            _joint_acceleration(arm, acceleration)
            if frame == "joints"
            else TOOL_ACCELERATION.check(acceleration, "acceleration"),
            check_number(timeout, "timeout", 0.01, 60.0),
            check_number(watchdog, "watchdog", 0.01, 10.0),
            self._opener(link),
        )

    # -- contact, force mode, torques, freedrive -----------------------------------------------------------

    @starts_motion
    def until_contact(
        self,
        direction: Numbers,
        speed: float = 0.02,
        *,
        acceleration: float = 0.5,
        distance: float = 0.3,
        force: float | None = None,
        retract: bool = True,
        wait: bool | float = False,
    ) -> ContactMotion:
        """Move the tool straight until it touches something.

        After the contact, `ContactMotion.contact` is the position where the contact began. On firmware 5.4 or later,
        the controller detects the contact and the position where it began. On older firmware, and if `force` is given,
        a contact is detected when the force against the direction of motion has increased by `force`.

        Args:
            direction: Direction in the base frame, shape (3,), of any length.
            speed: Speed of the tool, in m/s.
            acceleration: Acceleration of the tool, in m/s².
            distance: Longest distance, in m. If the tool touches nothing within this distance, the motion ends with
                `NoContact`.
            force: Force that counts as a contact, in N. If None, the controller's own detection is used, or 20 N if the
                controller has none. The force must be larger than the oscillations of the measured force while the arm
                accelerates. If the tool first presses on an object and then moves away from it, `force` must also be
                larger than the pressing force. The reason: the end of the pressing is measured as a force against the
                direction of motion.
            retract: Whether to move back to the position where the contact began. This releases the force.
            wait: See `Motions`.

        Raises:
            LocalError: If the firmware is older than 3.3. Such firmware cannot move the tool cycle by cycle.
        """
        seconds = check_wait(wait)
        context, identity = self._context, self._context.who.identity
        if identity.firmware < _TIMED_SPEED:
            raise LocalError(
                f"firmware {identity.firmware} cannot move until contact; {_TIMED_SPEED} or later is required"
            )
        way = numbers(direction, "direction")
        length = math.hypot(*way.tolist()) if way.shape == (3,) else 0.0
        if not 0.0 < length < math.inf:
            raise BadValue(f"direction is {way.tolist()}; expected three finite numbers, not all of them zero")
        if force is None and identity.firmware < _TOOL_CONTACT:
            force = _CONTACT_FORCE
        longest = check_number(distance, "distance", _LEAST, 10.0, "m")
        rates = TOOL_SPEED.check(speed, "speed", 1.0), TOOL_ACCELERATION.check(acceleration, "acceleration")
        limited = self._limited("until_contact")
        if limited is not None:
            limited.check_contact(way / length, *rates, longest)
        body = force_control.until_contact(
            identity.firmware,
            (way / length).tolist(),
            *rates,
            longest,
            force=None if force is None else check_number(force, "force", 1.0, 500.0, "N"),
            retracts=bool(retract),
        )
        life = context.programs.life("until_contact")
        motion = ContactMotion(life, longest, self._tool_pose)
        wrapped = context.programs.own(body)
        end_where_moved(life, context.realtime)
        context.programs.start(wrapped, life, left_alone=_MAY_GO_ON, on_text=motion._on_text)
        return waited(motion, seconds)

    def force_mode(
        self,
        frame: Numbers | str,
        selection: Sequence[object],
        wrench: Numbers,
        limits: Numbers,
        *,
        kind: int = 2,
        damping: float | None = None,
        gain: float | None = None,
        watchdog: float = 0.5,
        link: LinkName = "reverse",
    ) -> ForceMode:
        """Return a `ForceMode`, in which the tool yields along some axes so that it exerts a given wrench.

        Use it as a ``with`` block::

            with robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], [0.1] * 6) as pressing:
                ...
                pressing.set_wrench([0, 0, -20, 0, 0, 0])

        Force mode ends with the block, even if the block ends because of an exception, `close` or a stop. If no more
        messages from this computer arrive, the program on the robot ends force mode on its own.

        Args:
            frame: "base", "tool" (the current pose of the tool), or a pose in the base frame, shape (6,). Only the
                directions of the axes of the frame have an effect.
            selection: Six values of 0 or 1, for x, y, z, rx, ry, rz. The arm yields along the axes with the value 1.
            wrench: Forces and torques that the tool exerts on the object, shape (6,), in N and Nm.
            limits: Largest speeds along axes that yield, in m/s and rad/s, and largest deviations along the other axes,
                in m and rad; shape (6,). The controller enforces these limits. If the session limits the speed of the
                tool, urlink lowers the speeds to it.
            kind: Rotation of the frame, 1 to 3. With 1, the y axis of the frame points from the tool to the origin of
                the frame. With 2, the frame is not turned. With 3, the x axis of the frame is the direction of the
                motion in the x-y plane.
            damping: Damping, 0 to 1; the controller's default is 0.005. Needs firmware 3.5 or later.
            gain: Gain, 0 to 2. A smaller gain is steadier on hard objects. Needs firmware 5.0 or later.
            watchdog: Longest time without a message from this computer, in seconds. After this time, the robot ends
                force mode.
            link: See `follow`.

        Raises:
            LocalError: If this firmware does not support force mode, or if it does not support the given damping or
                gain.
        """
        pressing = force_control.Pressing(
            frame_of(self._context, frame),
            axes_of(selection, "selection"),
            tuple(six(limits, "limits").tolist()),
            kind,
            damping,
            gain,
        )
        return ForceMode(self._context, pressing, wrench, watchdog, self._opener(link))

    def torque(
        self,
        *,
        limits: ArrayLike | None = None,
        friction_compensation: bool = True,
        watchdog: float = 0.05,
        link: LinkName = "reverse",
    ) -> Torque:
        """Return a `Torque`, which sends the joint torques of your loop (URScript: `direct_torque`).

        This needs firmware 5.23 or later (PolyScope X: 10.11 or later). Use it as a ``with`` block::

            with robot.motion.torque() as torque:
                for state in robot.realtime:
                    torque.send(law(state))

        The controller compensates gravity, and adds the torques that you send. urlink does not limit the speed of the
        arm. Only your loop and the controller's own limits do this.

        Args:
            limits: Largest torques that `send` accepts, shape (6,), in Nm. If None, the limits are the maximum torques
                of the joints.
            friction_compensation: Whether the controller compensates the friction of the joints.
            watchdog: Time in seconds in which the last torques decrease gradually if no new torques follow. Then the
                arm brakes.
            link: See `follow`.

        Raises:
            LocalError: If this firmware does not support direct torque.
        """
        return Torque(self._context, limits, friction_compensation, watchdog, self._opener(link))

    def impedance(
        self,
        frame: FrameName = "joints",
        *,
        stiffness: ArrayLike | None = None,
        damping: ArrayLike = 1.0,
        torque: ArrayLike | None = None,
        speed: ArrayLike | None = None,
        error: ArrayLike | None = None,
        force: ArrayLike | None = None,
        posture_stiffness: ArrayLike | None = None,
        friction_compensation: bool = True,
        watchdog: float = 0.5,
        link: LinkName = "reverse",
    ) -> Impedance:
        """Return an `Impedance`: springs and dampers between the arm and a target.

        Use it as a ``with`` block::

            with robot.motion.impedance(stiffness=[800, 800, 400, 80, 80, 80]) as soft:
                for q in policy:
                    soft.send(q)

            with robot.motion.impedance("base", stiffness=[600, 600, 100, 30, 30, 30]) as soft:
                for pose in policy:
                    soft.send(pose)

        The program on the robot computes the springs in each cycle. It moves the arm evenly from one target to the
        next, at any rate of targets. Until the first target is sent, the springs hold the arm at its position. The
        springs never drive a joint faster than `speed`, or beyond the end of its range. Only an external push that is
        stronger than the braking torque can do this. When the block ends, the springs are released within 0.2 s, and
        the arm comes to rest.

        On firmware 5.23 or later (PolyScope X: 10.11 or later), direct torque produces the forces of the springs. An
        e-Series arm with older firmware, but at least 5.10, supports only springs of the tool: it moves according to
        the force that the sensor in the wrist measures. Zero the force sensor before you use these springs.

        Args:
            frame: "joints" for springs of the joints. "base" or "tool" for springs of the tool, along and about the
                axes of the base frame or of the target. Then six numbers are in the order x, y, z, rx, ry, rz.
            stiffness: Stiffness in Nm/rad, one number for all joints, or shape (6,). A joint with stiffness 0 is only
                damped. If None, the stiffness in the vendor's example of impedance control, which exists for UR3e, UR5e
                and UR10e. For springs of the tool, the stiffness is in N/m and Nm/rad; if None, 500 and 30.
            damping: Damping ratio, one number or shape (6,). With 1 (critical damping), a joint or an axis of the tool
                reaches its target as fast as possible without overshoot.
            torque: Largest torque of springs and dampers in each joint, in Nm, up to half of the maximum torque of the
                joint. If None, about the torques of the vendor's example. A joint that is too fast is braked with up to
                four times this torque. With springs of the tool, the limit applies only to the springs; the dampers may
                add further torque.
            speed: Largest speed of the joints, in rad/s; if None, 1. For springs of the tool, this is the largest speed
                of the tool in m/s and rad/s; if None, 0.25 and 0.8. The arm moves to targets at up to 0.7 of this
                speed.
            error: Largest extension of a spring, in rad; if None, 0.2. For springs of the tool, the extension is in m
                and rad; if None, 0.1 and 0.5. With a larger extension, the force of the spring does not increase
                further.
            force: Largest force and torque of the springs of the tool, in N and Nm; if None, 50 and 5.
            posture_stiffness: Stiffness in Nm/rad of posture springs, in addition to the springs of the tool; if None,
                0.5. Posture springs pull the joints to the posture of the target (`Impedance.send`). They determine the
                joint positions if the tool can turn freely, and in singular poses.
            friction_compensation: Whether the controller compensates the friction of the joints.
            watchdog: Longest time without a message from this computer, in seconds. After this time, the robot ends the
                motion. This computer answers each state with a message. You can choose a time that is longer than any
                delay of your program, because the limits also apply while no message arrives.
            link: See `follow`.

        Raises:
            BadValue: If an argument is out of range, or has no effect with this frame or this firmware.
            LocalError: If the robot has neither direct torque nor a force sensor, or if the model of the arm is
                unknown.
        """
        check_choice(frame, "frame", get_args(FrameName))
        parameters = ImpedanceParameters(
            frame, stiffness, damping, torque, speed, error, force, posture_stiffness, friction_compensation, watchdog
        )
        return Impedance(self._context, parameters, self._opener(link))

    def _freedrive(
        self, axes: Sequence[object] | None, frame: Numbers | str, watchdog: float, link: LinkName
    ) -> Freedrive:
        """Return a `Freedrive`; see `Robot.freedrive`."""
        free = None if axes is None else axes_of(axes, "axes")
        return Freedrive(self._context, free, frame_of(self._context, frame), watchdog, self._opener(link))

    def _tool_pose(self, q: FloatArray) -> FloatArray | None:
        """Return the pose of the TCP at given joint positions, with the TCP of the newest state; None if unknown."""
        identity, state = self._context.who.identity, self._context.realtime.latest
        if identity.arm is None or state is None:
            return None
        arm = identity.kinematics
        return arm.forward(q, shown_tcp(arm, state))

    # ----------------------------------------------------------------------------------------------------

    def _of_point(
        self,
        goal: Callable[[Point, KeepName | None, Arm, FloatArray], FloatArray],
        target: Numbers | Point,
        keep: KeepName | None,
    ) -> Numbers:
        """Return the numbers of a target: the target itself, or the goal of a motion to a point.

        Args:
            goal: Function that returns the goal for a point, `keep`, the arm and its current TCP.
        """
        if not isinstance(target, Point):
            if keep is not None:
                raise BadValue(f"keep={keep!r} applies only to a point of robot.points; omit keep")
            return target
        arm = self._context.who.identity.kinematics
        return goal(target, keep, arm, shown_tcp(arm, self._context.state()))

    def _check_reach(self, goal: FloatArray) -> None:
        """Raise `Unreachable` if the TCP cannot reach a pose. If the model of the arm is unknown, check nothing."""
        identity = self._context.who.identity
        if identity.arm is not None:
            state = self._context.state()
            arm = identity.kinematics
            arm.inverse(goal, state.q_target, shown_tcp(arm, state))

    def _upload(
        self,
        name: str,
        body: Sequence[str],
        gauge: Callable[[RealtimeState], float] = lambda state: 0.0,
        *,
        has_goal: bool = False,
        is_stop: bool = False,
        asks: bool = True,
        left_alone: str = _MAY_GO_ON,
    ) -> Motion:
        """Start a motion that consists of one short program.

        Args:
            has_goal: Whether the program has a goal. If the arm is moved during a pause, such a motion is ended,
                because the controller would otherwise drive the arm back onto the path to the goal.
        """
        context = self._context
        life = context.programs.life(name)

        def measure() -> float:
            state = context.realtime.latest
            return 0.0 if state is None else gauge(state)

        motion = Motion(life, measure)
        wrapped = context.programs.own(body, asks=asks and not is_stop)
        if has_goal:
            end_where_moved(life, context.realtime)
        context.programs.start(wrapped, life, is_stop=is_stop, left_alone=left_alone)
        return motion

    def _speed(self, name: str, speeds: FloatArray, acceleration: float, duration: float, link: LinkName) -> Motion:
        context = self._context
        is_tool = name == "speed_linear"
        duration = check_number(duration, "duration", _LEAST, _HOUR, "s")
        open_link = self._opener(link)
        self._check_speed(name, speeds, acceleration, duration)
        held = self.current
        # In a session with limits, every speed is held over a link, because only then urlink can stop the arm in time.
        is_watched = context.limits is not None
        if isinstance(held, HeldSpeed) and (duration >= UNLED or is_watched):
            context.channel.check()
            if held.change(name, speeds, acceleration, duration):
                return held
        if duration > UNLED or is_watched:
            return HeldSpeed(context, name, is_tool, speeds, acceleration, duration, open_link)
        # If a speed follows another speed, the program requests no start permission. Waiting for a permission would
        # make the arm stutter. If calls came faster than permissions, no call would ever move the arm. Even if the
        # controller executes a program too late, the arm moves no longer than `duration`.
        goes_on = any(life.name.startswith("speed_") for life in context.programs.permitted)
        write = commands.speed_linear if is_tool else commands.speed_joints
        clock = context.clock
        began = clock()
        return self._upload(
            name,
            write(context.who.identity.firmware, speeds.tolist(), acceleration, duration),
            lambda state: (clock() - began) / duration,
            asks=not goes_on,
            left_alone=f"the arm brakes on its own {duration:g} s after the motion started",
        )

    def _largest_speeds(self) -> tuple[float, ...]:
        """Return the largest speeds of the joints, (6,) in rad/s: those of the arm, or of the session if lower."""
        speeds, limits = largest_speeds(self._context.who.identity.arm), self._context.limits
        if limits is None or limits.joint_speed is None:
            return speeds
        return tuple(min(speed, limits.joint_speed) for speed in speeds)

    def _check_speed(self, name: str, speeds: FloatArray, acceleration: float, duration: float) -> None:
        """Refuse a motion at one speed that would certainly exceed a limit of the session.

        The motion is assumed to be as short as possible. While it runs, a `SpeedWatch` keeps the arm within the limits.
        """
        if self._context.limits is None:
            return
        self._context.limits.allow(name)
        limited = self._context.limited()
        assert limited is not None
        limited.check_inside()
        seconds = max(duration - RAMP, limited.cycle)
        if name == "speed_linear":
            limited.check_tool_speed(speeds, acceleration, seconds)
        else:
            limited.check_joint_speed(speeds, acceleration, seconds)

    def _limited(self, kind: str) -> LimitedArm | None:
        """Return the arm of a session with limits, at rest in its box; None if the session has no limits.

        Raises:
            LimitExceeded: If the session does not allow this kind, or the arm is moving, or its tool is outside.
        """
        if self._context.limits is not None:
            self._context.limits.allow(kind)
        return self._context.limited_at_rest()

    def _opener(self, link: LinkName, registers: RegisterPort[Any] | None = None) -> Callable[[], Link]:
        """Return the function that opens the link to a program.

        Args:
            link: Name of the link.
            registers: Registers for "rtde". If None, use the registers for set-points.
        """
        check_choice(link, "link", get_args(LinkName))
        if link == "reverse":
            return self._context.reverse.open
        firmware = self._context.who.identity.firmware
        if firmware not in HAS_REGISTERS:
            raise LocalError(
                f"firmware {firmware} does not have the registers for link='rtde'; 3.9, 5.3 or later is required"
            )
        return (registers or self._context.registers).open

    def _servoing(self, watchdog: float, lookahead_time: float, gain: float, period: float = 0.0) -> Servoing:
        return Servoing(
            self._context.who.identity.firmware,
            self._largest_speeds(),
            check_number(watchdog, "watchdog", 0.01, 10.0),
            check_number(lookahead_time, "lookahead_time", 0.03, 0.2),
            check_number(gain, "gain", 100.0, 2000.0),
            period,
        )

    def _repr_html_(self) -> str:
        from linkcore.text import html_table  # imported here to keep importing the library cheap

        current = self.current
        now = "no motion runs" if current is None else f"{current!r}, {current.progress:.0%}"
        begins = [name for name in dir(type(self)) if name[0] != "_" and name != "current"]
        return html_table("Motions", (), [("now", now), ("started by", ", ".join(begins))])

    def __repr__(self) -> str:
        return f"<Motions current={self.current!r}>"


def _arriving(goal: FloatArray, where: Callable[[RealtimeState], FloatArray]) -> Callable[[RealtimeState], float]:
    """Return a function that measures progress: 0 in the first state, 1 at the goal.

    The progress is 1 minus the distance to the goal, relative to the distance in the first state. A distance is the
    largest difference of any coordinate.
    """
    whole: list[float] = []

    def gauge(state: RealtimeState) -> float:
        left = float(np.abs(goal - where(state)).max())
        if not whole:
            whole.append(left)
        return 1.0 - left / whole[0] if whole[0] > 0.0 else 1.0

    return gauge


def _reporter(
    following: Following, feedback: Callable[[TrajectoryFeedback], object]
) -> Callable[[RealtimeState], None]:
    """Return a callback that passes the actual and the desired position of the arm to `feedback`, for each state."""

    def report(state: RealtimeState) -> None:
        times = following.times(state.time)
        if times is not None and not following.is_over and times[1] >= 0.0:
            q, qd = map(np.array, following.desired(times[1]))
            feedback(TrajectoryFeedback(*times, q, qd, state.q_actual, state.qd_actual, q - state.q_actual))

    return report


def _delay(delay: float | None) -> float | None:
    return None if delay is None else check_number(delay, "delay", 0.0, 1.0)


def _tool_rates(speed: float, acceleration: float) -> tuple[float, float]:
    return TOOL_SPEED.check(speed, "speed"), TOOL_ACCELERATION.check(acceleration, "acceleration")


def _joint_rates(arm: Model | None, speed: float, acceleration: float, prefix: str = "") -> tuple[float, float]:
    most, whose = (None, "") if arm is None else (float(arm.max_speed.max()), f"a {arm.name}")
    return JOINT_SPEED.check(speed, f"{prefix}speed", most, whose), _joint_acceleration(arm, acceleration, prefix)


def _joint_acceleration(arm: Model | None, value: float, prefix: str = "") -> float:
    most, whose = (None, "") if arm is None else (float(arm.max_acceleration.max()), f"a {arm.name}")
    return JOINT_ACCELERATION.check(value, f"{prefix}acceleration", most, whose)


def _timed(rates: tuple[float, float], duration: float | None, length: float) -> tuple[float, float]:
    """Return the speed and the acceleration of a move: `rates`, or those for the duration if there is one."""
    return rates if duration is None else evenly_timed(length, duration)


def _time(time: float | None, speed: float, acceleration: float) -> float | None:
    """Check the duration of a move; raise `BadValue` if a speed or an acceleration was also given."""
    if time is None:
        return None
    check_overridden("time sets the duration", speed=speed, acceleration=acceleration)
    return check_number(time, "time", _LEAST, _HOUR, "s")
