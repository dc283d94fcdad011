"""`robot.motion`: the methods that begin a motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

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
from .links.register_link import RegisterPort
from .moves.path import PathMotion, Rates, Waypoint, plan, shown_tcp
from .moves.speed_limit import check_joint_speeds, largest_speeds
from .moves.trajectory import Trajectory
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

#: The smallest value of what must be positive; and an hour: a longer duration is a mistake.
_LEAST, _HOUR = 1e-3, 3600.0
#: Hz; the largest rate of targets for a filter.
_MOST_TARGETS = 10_000.0
#: The first release in which speedl takes a time; the first that detects contacts; N that are a contact before that.
_TIMED_SPEED, _TOOL_CONTACT, _CONTACT_FORCE = Firmware(3, 3), Firmware(5, 4), 20.0
#: The state of a motion after its connection was lost, for messages.
_MAY_GO_ON = "the arm may still move, to the end of the motion"

#: The filters between the targets and the set-points of a servo.
TargetFilterName = Literal["jerk_limited"]
#: The link by which set-points get to the robot.
LinkName = Literal["reverse", "rtde"]


# A motion that is one short program has no class of its own.
@slider(move_joints=SliderEffect.SCALED)
class Motions(StrictAttributes):
    """Moves the arm. Each method begins a motion and returns its handle; it waits for the arm only if it is asked to.

    With ``wait=True`` it returns once the motion has come to its end, or raises what ended it. It waits for 60 s, or
    for the number of seconds that is given; after that it raises `LinkTimeout`, and the motion goes on. Ctrl-C
    while it waits cancels the motion, as in `Handle.wait`.

    A motion that is begun preempts the one that runs, whose `wait` then raises `Cancelled`. All methods raise
    `BadValue` for arguments that are invalid or beyond the limits of the arm, and `SafetyStop`, `NotEnabled` or
    `NotRunning` if the arm may not be moved now; nothing was sent then.
    """

    def __init__(self, context: MotionContext) -> None:
        self._context = context

    @property
    def current(self) -> Motion | None:
        """The motion that was begun last, while it runs; None if none runs."""
        life = self._context.programs.current
        handle = None if life is None else life.handle
        return handle if isinstance(handle, Motion) else None

    # -- one command -----------------------------------------------------------------------------------

    @starts_motion
    def move_joints(
        self,
        q: Numbers,
        speed: float = Default(1.05),
        acceleration: float = Default(1.4),
        *,
        time: float | None = None,
        wait: bool | float = False,
    ) -> Motion:
        """Move all joints to a position, in a straight line in joint space (URScript: `movej`).

        Args:
            q: (6,) rad.
            speed: rad/s of the joint that moves furthest.
            acceleration: rad/s².
            time: duration in seconds, instead of a speed and an acceleration; these cannot be given with it.
            wait: see `Motions`.
        """
        seconds = check_wait(wait)
        duration = _time(time, speed, acceleration)
        goal = six(q, "q")
        model = self._context.who.identity.arm
        if model is not None:
            model.check_joints(goal)
        body = commands.move_joints(goal.tolist(), *_joint_rates(model, speed, acceleration), duration)
        return waited(
            self._upload("move_joints", body, _arriving(goal, lambda state: state.q_actual), has_goal=True), seconds
        )

    @starts_motion
    def move_linear(
        self,
        pose: Numbers,
        speed: float = Default(0.25),
        acceleration: float = Default(1.2),
        *,
        time: float | None = None,
        wait: bool | float = False,
    ) -> Motion:
        """Move the tool to a pose in the base frame, in a straight line (URScript: `movel`).

        Args:
            pose: (6,) position in m, and rotation vector in rad.
            speed: m/s.
            acceleration: m/s².
            time: duration in seconds, instead of a speed and an acceleration; these cannot be given with it.
            wait: see `Motions`.
        """
        seconds = check_wait(wait)
        duration = _time(time, speed, acceleration)
        goal = check_pose(pose, "pose")
        body = commands.move_linear(goal.tolist(), *_tool_rates(speed, acceleration), duration)
        self._check_reach(goal)
        # Only the position of the pose: one rotation has more than one rotation vector.
        gauge = _arriving(goal[:3], lambda state: state.tool_vector_actual[:3])
        motion = self._upload("move_linear", body, gauge, has_goal=True)
        return waited(motion, seconds)

    @starts_motion
    def move_circular(
        self, via: Numbers, to: Numbers, speed: float = 0.25, acceleration: float = 1.2, *, wait: bool | float = False
    ) -> Motion:
        """Move the tool along the circle through one pose to another, both in the base frame (`movec`).

        Args:
            via: (6,) position in m, and rotation vector in rad, on the arc; its orientation has no effect.
            to: (6,) where it ends.
            speed: m/s.
            acceleration: m/s².
            wait: see `Motions`.
        """
        from ..arm.curves import Arc

        seconds = check_wait(wait)
        between, goal = check_pose(via, "via"), check_pose(to, "to")
        body = commands.move_circular(between.tolist(), goal.tolist(), *_tool_rates(speed, acceleration))
        self._check_reach(goal)
        # From where the arm is now; if it still moves, it stops not far from here.
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
        """Move through several waypoints in one motion; a waypoint with a blend is rounded, without a stop.

        The path is checked before it is sent, from the present position of the arm: every point of a line or an arc
        must be reachable on the branch in which the arm is, within the limits of the joints; no joint may get too fast;
        blends must not overlap. Corners are checked as if they were not blended. This needs the model of the arm
        (firmware 1.8 and later); if it is not known, only the numbers are checked. Collisions are not checked.

        Args:
            waypoints: `Joint`, `Linear` and `Circular`, each with a blend, and optionally a speed and acceleration.
            speed, acceleration: m/s and m/s² of the tool on lines and arcs.
            joint_speed, joint_acceleration: rad/s and rad/s² of the joint that moves furthest, towards a `Joint`.
            wait: see `Motions`.

        Raises:
            BadValue: a waypoint cannot be used; the message names it and says why.
            LinkTimeout: no state comes, so the position of the arm is not known.
        """
        seconds = check_wait(wait)
        context = self._context
        identity = context.who.identity
        arm = None if identity.arm is None else identity.kinematics
        joint_rates = Rates(*_joint_rates(identity.arm, joint_speed, joint_acceleration, "joint_"))
        tool_rates = Rates(*_tool_rates(speed, acceleration))
        planned = plan(list(waypoints), joint_rates, tool_rates, arm, context.state())
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

        To go on, call it again before: the arm changes from one speed to the next without stopping. If no more calls
        come, because this program has ended or the connection is lost, the robot brakes by itself, after 0.5 s at most:

        - A `duration` up to 0.5 s is one program that is sent. A call that follows another one is not held back by the
          start permission: if the controller hangs, it **may still be carried out**, for its `duration`.
        - A longer one is held over a `link` whose watchdog is 0.5 s. A call for 0.5 s or more that follows it with the
          same `acceleration` changes its speed and its time, and returns the same handle.

        Args:
            qd: (6,) rad/s.
            acceleration: rad/s², for changes of speed and for braking.
            duration: seconds until it brakes.
            link: see `follow`; has no effect up to 0.5 s.
            wait: see `Motions`.
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
        """Move the tool at a speed in the base frame, and brake after `duration` (`speedl`); see `speed_joints`.

        Args:
            xd: (6,) m/s, and rad/s about the three axes.
            acceleration: m/s².
            duration: seconds until it brakes.
            link: see `follow`; has no effect up to 0.5 s.
            wait: see `Motions`.
        """
        seconds = check_wait(wait)
        speeds, hardest = check_speeds(xd, "xd"), TOOL_ACCELERATION.check(acceleration, "acceleration")
        motion = self._speed("speed_linear", speeds, hardest, duration, link)
        return waited(motion, seconds)

    @starts_motion
    def stop(self, acceleration: float = 2.0, *, wait: bool | float = False) -> Motion:
        """Brake all joints, at `acceleration` in rad/s² (`stopj`). Done when the arm stands still.

        An ordinary stop by the controller's program, no substitute for the emergency stop. It is sent whether or not
        `safety.enable()` was called. While a safety stop holds it is refused; the arm stands still then.
        """
        seconds = check_wait(wait)
        body = commands.stop(_joint_acceleration(self._context.who.identity.arm, acceleration))
        self._context.channel.overtake("the robot was stopped")
        return waited(self._upload("stop", body, is_stop=True), seconds)

    # -- motions that last, linked to a program on the robot ---------------------------------------------

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
        """Follow a trajectory from where the arm stands.

        Its time passes as fast as the robot executes programs: the speed slider, the controller's own limits and a
        pause slow it down or stop it, and the arm stays on its path.

        Args:
            trajectory: what to follow; its first point is near the arm, and it is at rest at both ends.
            low_bandwidth: send it point by point, and let the robot interpolate, instead of streaming it at the
                controller's rate; from 3.0 on.
            path_tolerance: rad by which any joint may be off before the end; None for no limit. The lag of the arm at
                speed is part of it.
            goal_tolerance: rad by which any joint may be off at the end.
            goal_time: seconds after the end within which the arm must be there, in the time of the trajectory.
            start_tolerance: rad between any joint and the first point; and after a pause, between any joint and where
                it had come to rest: further away the motion ends with `ToleranceExceeded`.
            feedback: called with where the arm is and should be, in a thread of its own; may be slow, may raise.
            delay: s by which the arm lags behind its set-points, as `Servo.measure_delay` measures it: set-points are
                sent so much earlier, and tolerances and feedback are without this lag. None for the two cycles in which
                a set-point arrives.
            watchdog: seconds without a set-point after which the robot brakes by itself.
            lookahead_time: s, 0.03 to 0.2; how far ``servoj`` looks ahead: more is smoother and lags more. Not on CB2.
            gain: 100 to 2000; how stiffly ``servoj`` follows. Not on CB2.
            scaling: "ignore" for a trajectory by the controller's clock, whatever the scaling. Below 100 % the arm then
                lags, leaves its path where it curves, and is led at up to the full speed of its joints to catch up;
                `path_tolerance` should be set.
            link: how set-points get to the robot: "reverse", over a connection that the robot makes to this computer,
                or "rtde", over input registers of the robot, so that no connection to this computer is needed; from 3.9
                and 5.3.
            wait: see `Motions`.

        Raises:
            LocalError: `low_bandwidth` on a CB2 or over "rtde"; "rtde" on a firmware without these registers.
            BadAddress: the port for the robot's connection cannot be listened on.
            InputInUse: another RTDE client, or a fieldbus, holds a register.
        """
        seconds = check_wait(wait)
        if not isinstance(trajectory, Trajectory):
            raise BadValue(f"{trajectory!r} is no Trajectory")
        context, firmware = self._context, self._context.who.identity.firmware
        if low_bandwidth and firmware.is_cb2:
            raise LocalError(f"firmware {firmware} cannot interpolate by itself; leave out low_bandwidth")
        open_link = self._opener(link)
        if low_bandwidth and link == "rtde":
            raise LocalError("low_bandwidth needs link='reverse': the program requests its points over the connection")
        if low_bandwidth and scaling == "ignore":
            raise LocalError("low_bandwidth takes no scaling='ignore': the robot interpolates in its own time")
        if low_bandwidth and delay is not None:
            raise LocalError("low_bandwidth takes no delay: the robot is led by its own clock")
        tolerances = Tolerances.checked(path_tolerance, goal_tolerance, goal_time, start_tolerance)
        servoing = self._servoing(watchdog, lookahead_time, gain)
        check_choice(scaling, "scaling", get_args(ScalingName))
        model = context.who.identity.arm
        trajectory.check(model)
        state = context.state()
        if self.current is None and stands(state.qd_target):
            # Otherwise it is checked when the arm stands still, after the motion before. That motion may have ended
            # already, and the state may be from a little before its end.
            trajectory.check(near=state.q_target, within=tolerances.start)
        if low_bandwidth:
            following: Following = WaypointServer(trajectory, tolerances, firmware, lookahead_time, gain)
        else:
            timer = ProgramTimer(1.0 / firmware.rate, scaling)
            following = Follower(trajectory, tolerances, servoing, _delay(delay), timer)
        life = context.programs.life("follow")
        motion = Motion(life, lambda: following.progress)
        if feedback is not None:
            # In a queue and a thread of its own: it may be slow, and may raise.
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
        """Set-points for the joints from a loop of your own (URScript: `servoj`)::

            with robot.motion.servo() as servo:
                for state in robot.realtime:
                    servo.send(law(state))

        With ``target_filter="jerk_limited"`` the loop sends targets instead: any, at any time, however far away. The
        arm moves to the newest one, and never exceeds the limits of speed, acceleration and jerk
        (`urlink.motion.servo.jerk_limited`).

        Args:
            rate: set-points or targets per second that the loop intends to send, for the statistics; None for the
                controller's rate, which set-points cannot exceed. Targets for the filter can.
            target_filter: "jerk_limited", or None for a loop that sends set-points.
            speed, acceleration, jerk: limits of the target filter, rad/s, rad/s² and rad/s³, of all joints or (6,) of
                each. Without a filter they cannot be given, since nothing limits set-points to them.
            delay: s by which the arm lags behind its set-points, as `Servo.measure_delay` measures it: waypoints of
                `schedule` are sent so much earlier. None for the two cycles in which a set-point arrives. With a filter
                it cannot be given.
            watchdog: seconds without a set-point after which the robot brakes by itself.
            lookahead_time, gain, link: see `follow`.
        """
        firmware = self._context.who.identity.firmware
        fastest = float(firmware.rate) if target_filter is None else _MOST_TARGETS
        whose = f"firmware {firmware}" if target_filter is None else ""
        pace = float(firmware.rate) if rate is None else check_number(rate, "rate", 0.1, fastest, "Hz", whose)
        # With a filter, a set-point is made in each cycle, however often targets come.
        servoing = self._servoing(watchdog, lookahead_time, gain, 1.0 / pace if target_filter is None else 0.0)
        limits = None
        if target_filter is None:
            no_filter = "only a target filter has limits (target_filter='jerk_limited')"
            check_overridden(no_filter, speed=speed, acceleration=acceleration, jerk=jerk)
        else:
            check_choice(target_filter, "target_filter", get_args(TargetFilterName))
            check_overridden("schedule() is not available with a target filter", delay=delay)
            limits = joint_limits(self._context.who.identity.arm, speed, acceleration, jerk)
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
        """Points with times, appended while the arm moves through those before; from 3.4 on::

            with robot.motion.stream() as stream:
                for q, qd in planner:
                    stream.append(TrajectoryPoint(q, stream.end + 0.1, qd))
                stream.wait_until_dry()

        A program on the robot holds the next points and interpolates between them by what they carry, at the robot's
        own pace: the speed slider slows it down, and this computer may be late by what it holds. Where no point is
        left, it brakes, and the next points go on from there.

        Args:
            buffer: s of points that the program holds, at most 256 of them. The arm moves on for so long if this
                program hangs; the watchdog may end that sooner.
            acceleration, jerk: rad/s² and rad/s³, of all joints or (6,) of each: of the braking where no point is left,
                and of the path onto points that came late or replace others.
            watchdog: seconds without a message from this computer, which answers each state, after which the program
                brakes and ends.
            lookahead_time, gain: see `follow`.
            link: see `follow`. With "rtde" other registers are held than by other motions: `input_int_register_30` to
                `43` and `input_double_register_24` to `35`; the program reports in `output_int_register_30` to `36`.

        Raises:
            LocalError: firmware before 3.4, or for registers before 3.9 and 5.3.
        """
        arm = self._context.who.identity.arm
        servoing = self._servoing(check_number(watchdog, "watchdog", 0.1, 2.0), lookahead_time, gain)
        limits = joint_limits(arm, largest_speeds(arm), acceleration, jerk)
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
        """Speeds from a person, by a joystick or keys::

            with robot.motion.jog("base") as jog:
                while held():
                    jog.move([0, 0, 0.05, 0, 0, 0])

        A speed expires after `timeout` seconds, and the arm brakes, unless `move` has been called again. If this
        program or the connection fails, the robot brakes by itself after `watchdog` seconds.

        Args:
            frame: "joints" for speeds of the joints; "base" or "tool" for those of the tool, along and about the axes
                of that frame.
            acceleration: rad/s² of the joint whose speed changes most, or m/s² and rad/s² of the tool, for every change
                of speed and for braking.
            timeout: seconds for which a speed holds.
            watchdog: seconds without a message from this computer after which the robot brakes.
            link: see `follow`.
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
        """Move the tool straight until it touches something; `ContactMotion.contact` then says where that began.

        From 5.4 on the controller detects the contact, and where it began. Before that, and with `force`, a contact is
        where the force against the direction has grown by so much.

        Args:
            direction: (3,) in the base frame, of any length.
            speed: m/s.
            acceleration: m/s².
            distance: m after which it ends with `NoContact`.
            force: N that are a contact; None for the controller's own detection, and for 20 N if it has none. It must
                be above the oscillations of the force while the arm accelerates, and above the force with which the
                tool presses on what it is led away from: that this force ends is felt as one against the direction.
            retract: go back to where the contact began, which releases the force.
            wait: see `Motions`.

        Raises:
            LocalError: firmware before 3.3, on which the tool cannot be moved cycle by cycle.
        """
        seconds = check_wait(wait)
        context, identity = self._context, self._context.who.identity
        if identity.firmware < _TIMED_SPEED:
            raise LocalError(f"firmware {identity.firmware} cannot do this: {_TIMED_SPEED} is the first")
        way = numbers(direction, "direction")
        length = math.hypot(*way.tolist()) if way.shape == (3,) else 0.0
        if not 0.0 < length < math.inf:
            raise BadValue(f"direction is {way.tolist()}; expected three finite numbers, not all of them zero")
        if force is None and identity.firmware < _TOOL_CONTACT:
            force = _CONTACT_FORCE
        longest = check_number(distance, "distance", _LEAST, 10.0, "m")
        body = force_control.until_contact(
            identity.firmware,
            (way / length).tolist(),
            TOOL_SPEED.check(speed, "speed", 1.0),
            TOOL_ACCELERATION.check(acceleration, "acceleration"),
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
        """Force mode: yield along some axes until the tool exerts a wrench there, for as long as a block::

            with robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], [0.1] * 6) as pressing:
                ...
                pressing.set_wrench([0, 0, -20, 0, 0, 0])

        Whatever ends the block ends the mode: an exception, `close`, a stop. If no more messages from this computer
        arrive, the program on the robot ends it by itself.

        Args:
            frame: "base", "tool" (as the tool is now), or a (6,) pose in the base frame; only its axes have an effect.
            selection: six of 0 and 1 for x, y, z, rx, ry, rz; 1 where the arm yields.
            wrench: (6,) N and Nm that the tool exerts on what it touches.
            limits: (6,) largest speed along axes that yield, m/s and rad/s; largest deviation along the others, m and
                rad. The controller applies them.
            kind: 1 turns the y axis of the frame from the tool to its origin, 2 leaves it, 3 turns its x axis into the
                direction of movement in the x-y plane.
            damping: 0 to 1; the controller's default is 0.005. From 3.5 on.
            gain: 0 to 2; a smaller one is steadier on hard objects. From 5.0 on.
            watchdog: seconds without a message from this computer after which the robot ends the mode.
            link: see `follow`.

        Raises:
            LocalError: this firmware has no force mode, damping or gain.
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
        """Torques for the joints from a loop of your own (`direct_torque`), from 5.23 and 10.11 on::

            with robot.motion.torque() as torque:
                for state in robot.realtime:
                    torque.send(law(state))

        The controller holds the arm up against gravity; a torque is added to that. Only the loop, and the controller's
        own limits, keep the arm from getting fast.

        Args:
            limits: (6,) Nm beyond which `send` refuses; None for what the joints can exert.
            friction_compensation: whether the controller compensates the friction of the joints.
            watchdog: seconds over which the last torque fades if none follows; then the arm brakes.
            link: see `follow`.

        Raises:
            LocalError: this firmware has no direct torque.
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
        """Springs and dampers between the arm and a target::

            with robot.motion.impedance(stiffness=[800, 800, 400, 80, 80, 80]) as soft:
                for q in policy:
                    soft.send(q)

            with robot.motion.impedance("base", stiffness=[600, 600, 100, 30, 30, 30]) as soft:
                for pose in policy:
                    soft.send(pose)

        The program on the robot computes them in each cycle, and leads the arm evenly from one target to the next,
        however often they come. Where nothing has been sent, the arm is held where it is. No joint is driven faster
        than `speed`, nor over the end of its range; a push that is stronger than what brakes it may. At the end the
        springs are let go of within 0.2 s, and the arm stands.

        From 5.23 and 10.11 on they act by direct torque. From 5.10 on an e-Series arm whose firmware is older yields by
        the force that its wrist measures, with springs of the tool only: zero the sensor before.

        Args:
            frame: "joints" for springs in the joints. "base" or "tool" for those of the tool, along and about the axes
                of the base, or of the target; six numbers are then x, y, z, rx, ry, rz.
            stiffness: Nm/rad, of all joints or (6,) of each; 0 for a joint that is only damped. None for that of the
                vendor's example of impedance control, which it has for UR3e, UR5e and UR10e. Of the tool N/m and
                Nm/rad; None for 500 and 30.
            damping: ratio, likewise; with 1 a joint, or the tool along an axis, would just not swing past its target.
            torque: Nm of springs and dampers in each joint, up to half of what it can exert; None for about those of
                the vendor's example. A joint that is too fast is braked with up to four times as much. Springs of the
                tool have so much, and what damps them may have more.
            speed: rad/s, or of the tool m/s and rad/s; None for 1, or 0.25 and 0.8. Targets are approached with 0.7
                of it.
            error: rad, or m and rad, by which a spring is stretched at most: beyond, its force does not grow. None for
                0.2, or 0.1 and 0.5.
            force: N and Nm of the springs of the tool at most; None for 50 and 5.
            posture_stiffness: Nm/rad of springs in the joints, beside those of the tool, to the posture of the target
                (`Impedance.send`); None for 0.5. They decide where the tool is free to turn, and in singular poses.
            friction_compensation: whether the controller compensates the friction of the joints.
            watchdog: seconds without a message from this computer, which answers each state, after which the robot ends
                it. It may be longer than your program is ever busy: what the arm does meanwhile is bounded anyway.
            link: see `follow`.

        Raises:
            BadValue: out of range; or of no effect with this frame, or this firmware.
            LocalError: this firmware has neither direct torque nor a force sensor; or the arm is not known.
        """
        check_choice(frame, "frame", get_args(FrameName))
        parameters = ImpedanceParameters(
            frame, stiffness, damping, torque, speed, error, force, posture_stiffness, friction_compensation, watchdog
        )
        return Impedance(self._context, parameters, self._opener(link))

    def _freedrive(
        self, axes: Sequence[object] | None, frame: Numbers | str, watchdog: float, link: LinkName
    ) -> Freedrive:
        """See `Robot.freedrive`."""
        free = None if axes is None else axes_of(axes, "axes")
        return Freedrive(self._context, free, frame_of(self._context, frame), watchdog, self._opener(link))

    def _tool_pose(self, q: FloatArray) -> FloatArray | None:
        """The pose of the TCP at joint positions, with the TCP of the newest state."""
        identity, state = self._context.who.identity, self._context.realtime.latest
        if identity.arm is None or state is None:
            return None
        arm = identity.kinematics
        return arm.forward(q, shown_tcp(arm, state))

    # ----------------------------------------------------------------------------------------------------

    def _check_reach(self, goal: FloatArray) -> None:
        """Raise `Unreachable` if the arm cannot bring its TCP to a pose; if the arm is not known, it is not checked."""
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
        """A motion that is one short program: it is sent once, and the controller executes it.

        After a pause one that has a goal would be led back onto its path to it.
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
        held = self.current
        if isinstance(held, HeldSpeed) and duration >= UNLED:
            context.channel.check()
            if held.change(name, speeds, acceleration, duration):
                return held
        if duration > UNLED:
            return HeldSpeed(context, name, is_tool, speeds, acceleration, duration, open_link)
        # A speed that follows another one asks for no start permission: that would make the arm stutter, and if calls
        # come faster than permissions, none would ever move it. A call that the controller reads too late moves the arm
        # for no longer than `duration`.
        goes_on = any(life.name.startswith("speed_") for life in context.programs.permitted)
        write = commands.speed_linear if is_tool else commands.speed_joints
        clock = context.clock
        began = clock()
        return self._upload(
            name,
            write(context.who.identity.firmware, speeds.tolist(), acceleration, duration),
            lambda state: (clock() - began) / duration,
            asks=not goes_on,
            left_alone=f"the arm brakes by itself, {duration:g} s after it began",
        )

    def _opener(self, link: LinkName, registers: RegisterPort[Any] | None = None) -> Callable[[], Link]:
        """The function that opens the link to a program; `registers`: other than those of messages of two times six."""
        check_choice(link, "link", get_args(LinkName))
        if link == "reverse":
            return self._context.reverse.open
        firmware = self._context.who.identity.firmware
        if firmware not in HAS_REGISTERS:
            raise LocalError(
                f"firmware {firmware} has no input registers for this (3.9 and 5.3 are the first): without link='rtde'"
            )
        return (registers or self._context.registers).open

    def _servoing(self, watchdog: float, lookahead_time: float, gain: float, period: float = 0.0) -> Servoing:
        return Servoing(
            self._context.who.identity.firmware,
            largest_speeds(self._context.who.identity.arm),
            check_number(watchdog, "watchdog", 0.01, 10.0),
            check_number(lookahead_time, "lookahead_time", 0.03, 0.2),
            check_number(gain, "gain", 100.0, 2000.0),
            period,
        )

    def _repr_html_(self) -> str:
        from linkcore.text import html_table  # imported here: importing the library stays cheap

        current = self.current
        now = "no motion runs" if current is None else f"{current!r}, {current.progress:.0%}"
        begins = [name for name in dir(type(self)) if name[0] != "_" and name != "current"]
        return html_table("Motions", (), [("now", now), ("begun by", ", ".join(begins))])

    def __repr__(self) -> str:
        return f"<Motions current={self.current!r}>"


def _arriving(goal: FloatArray, where: Callable[[RealtimeState], FloatArray]) -> Callable[[RealtimeState], float]:
    """Progress by the distance to a goal: that of the furthest coordinate, relative to the first state."""
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
    """A callback that reports, for each state, where the arm is and should be."""

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


def _time(time: float | None, speed: float, acceleration: float) -> float | None:
    """The duration of a move; raises `BadValue` if a speed or an acceleration was given with it."""
    if time is None:
        return None
    check_overridden("time sets the duration", speed=speed, acceleration=acceleration)
    return check_number(time, "time", _LEAST, _HOUR, "s")
