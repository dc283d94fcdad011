"""Groups of arms, with motions that start, run and end together, and with states that are matched by time.

Each arm is driven by its own program, as with `Motions.follow`. All trajectories use a common time
(`urlink.motion.stream.common_time`). If the motion of one arm ends early, all arms stop.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from linkcore.arguments import Default, check_number, check_overridden, check_wait
from linkcore.errors import BadValue, LinkError, LocalError
from linkcore.handle import Lifecycle, Motion, waited
from linkcore.names import StrictAttributes
from linkcore.pending_call import starts_motion
from linkcore.streaming.packet_queue import drop_oldest, latest
from linkcore.threads import CallbackThread

from .arm.bounds import JOINT_ACCELERATION, JOINT_SPEED
from .arm.vectors import Numbers, six
from .motion.motions import LinkName
from .motion.moves.trajectory import Trajectory
from .motion.servo.follower import Follower
from .motion.servo.following import Tolerances, stands
from .motion.servo.linked_program import LinkedProgram
from .motion.stream.common_time import CommonPace, CommonTime
from .motion.stream.group_motion import GroupMotion, GroupStream, end_all, naming
from .protocol.realtime.packets import RealtimeState
from .robot import Robot

#: Peak speed and peak acceleration of the quintic from 0 to 1 in one second, at rest at both ends.
_PEAK_SPEED, _PEAK_ACCELERATION = 1.875, 10.0 / math.sqrt(3.0)
#: Minimum duration of a motion, in s. This duration is used if the arms are already at their goals.
_SHORTEST = 0.1
#: Number of states of one arm that are queued until the states of the other arms arrive.
WAITING = 64


class Group(StrictAttributes):
    """Group of arms that move together::

        with urlink.connect(LEFT) as left, urlink.connect(RIGHT) as right:
            both = urlink.Group(left, right)
            both.follow([reach_left, reach_right]).wait()

    Motions start at the same moment, according to the clocks of the controllers (`Robot.clock`). All motions run at the
    pace of the slowest program. The pace of a program depends on its speed slider, on pauses, and on the limits of its
    controller. If the motion of one arm ends early (a stop, an error, another motion, `cancel`), all arms stop.

    Args:
        robots: Robots of the group: at least two, each only once.

    Attributes:
        robots: Robots of the group, in the order of the arguments.

    Raises:
        BadValue: If there are fewer than two robots, or a robot is given twice.
    """

    def __init__(self, *robots: Robot) -> None:
        for robot in robots:
            if not isinstance(robot, Robot):
                raise BadValue(f"{robot!r} is not a Robot returned by urlink.connect")
        if len(robots) < 2 or len({id(robot) for robot in robots}) < len(robots):
            raise BadValue(f"got {len(robots)} robots; expected at least two, each of them only once")
        self.robots = tuple(robots)
        self._callbacks = CallbackThread("group callbacks")
        self._stopping = CallbackThread("group stops")

    # -- motions ---------------------------------------------------------------------------------------

    @starts_motion
    def follow(
        self,
        trajectories: Sequence[Trajectory],
        *,
        path_tolerance: float | None = None,
        goal_tolerance: float = 0.01,
        goal_time: float = 1.0,
        start_tolerance: float = 0.05,
        watchdog: float = 0.1,
        lookahead_time: float = 0.03,
        gain: float = 300.0,
        link: LinkName = "reverse",
        wait: bool | float = False,
    ) -> GroupMotion:
        """Follow one trajectory with each arm, on a common time.

        The arms start 50 ms after all arms are at rest and all programs have connected. If the program of one arm is
        paused, all arms halt. When the program resumes, its arm moves up to a tenth faster until it has caught up with
        the others.

        Args:
            trajectories: One trajectory for each arm; see `Motions.follow`. Their durations can differ.
            path_tolerance, goal_tolerance, goal_time, start_tolerance, watchdog, lookahead_time, gain, link: Options of
                each arm; see `Motions.follow`.
            wait: See `Motions`.

        Raises:
            BadValue: If the number of trajectories is wrong, or the trajectory of one arm is rejected. Nothing is sent.
            LinkError: If one arm cannot start. No arm has moved.
        """
        seconds = check_wait(wait)
        if len(trajectories) != len(self.robots):
            raise BadValue(
                f"got {len(trajectories)} trajectories for a group of {len(self.robots)} robots; expected one for each"
            )
        tolerances = Tolerances.checked(path_tolerance, goal_tolerance, goal_time, start_tolerance)
        common = CommonTime()
        parts = []
        for robot, trajectory in zip(self.robots, trajectories, strict=True):
            if not isinstance(trajectory, Trajectory):
                raise BadValue(f"{trajectory!r} is not a Trajectory")
            motions = robot.motion
            trajectory.check(robot.identity.arm)
            limited = motions._limited("follow")
            if limited is not None:
                limited.check_trajectory(trajectory, begins_slowly=False)
            trajectory.check(near=motions._context.state().q_target, within=tolerances.start)
            timer = common.member(robot.clock.to_local, 1.0 / robot.firmware.rate)
            servoing = motions._servoing(watchdog, lookahead_time, gain)
            parts.append((motions, Follower(trajectory, tolerances, servoing, timer=timer), timer))
        # Start this thread before the first arm moves: it stops the other arms when the motion of one arm ends.
        self._stopping.start()
        begun: list[Motion] = []
        try:
            for name, (motions, follower, timer) in zip(self._names, parts, strict=True):
                life = motions._context.programs.life("follow")
                program = LinkedProgram(
                    life, motions._context, follower, motions._opener(link), tolerance=tolerances.start
                )
                timer.is_paused = partial(getattr, program, "is_paused")
                life.on_end(timer.leave)
                begun.append(Motion(life, partial(getattr, follower, "progress")))
                with naming(name):
                    program.begin()
        except BaseException:
            end_all([motion._life for motion in begun], "stopped, because the motion of another arm could not start")
            raise
        life = self._life("follow")
        life.begin()
        return waited(GroupMotion(life, begun, self._names, self._stopping), seconds)

    @starts_motion
    def move_joints(
        self,
        q: Sequence[Numbers],
        speed: float = Default(1.05),
        acceleration: float = Default(1.4),
        *,
        time: float | None = None,
        wait: bool | float = False,
    ) -> GroupMotion:
        """Move each arm to joint positions, straight in joint space. All arms arrive at the same time.

        Each arm starts at its current position. The call uses `follow` with quintic trajectories that are at rest at
        both ends, so no joint exceeds the speed or the acceleration.

        Args:
            q: Goal joint positions of each arm, shape (6,), in rad.
            speed: Speed of the fastest joint of all arms, in rad/s.
            acceleration: Acceleration of the joint with the highest acceleration, in rad/s².
            time: Duration in seconds. `time` cannot be combined with `speed` or `acceleration`.
            wait: See `Motions`.

        Raises:
            BadValue: If the number of goals is wrong, or a goal exceeds the limits of an arm.
            LocalError: If an arm is moving.
            LinkError: If one arm cannot start. No arm has moved.
        """
        check_wait(wait)
        if time is not None:
            check_overridden("time sets the duration", speed=speed, acceleration=acceleration)
        if len(q) != len(self.robots):
            raise BadValue(f"got {len(q)} goals for a group of {len(self.robots)} robots; expected one for each")
        goals = [six(goal, f"q[{number}]") for number, goal in enumerate(q)]
        starts = []
        for robot in self.robots:
            state = robot.motion._context.state()
            if not stands(state.qd_target):
                raise LocalError(f"{robot.address} is moving; all arms of the group must be at rest at the start")
            starts.append(state.q_target)
        if time is None:
            way = max(float(np.abs(goal - start).max()) for goal, start in zip(goals, starts, strict=True))
            by_speed = _PEAK_SPEED * way / JOINT_SPEED.check(speed, "speed")
            by_acceleration = math.sqrt(
                _PEAK_ACCELERATION * way / JOINT_ACCELERATION.check(acceleration, "acceleration")
            )
            seconds = max(by_speed, by_acceleration, _SHORTEST)
        else:
            seconds = check_number(time, "time", _SHORTEST, 3600.0, "s")
        rest = np.zeros((2, 6))
        ways = zip(starts, goals, strict=True)
        trajectories = [Trajectory.from_arrays([0.0, seconds], [start, goal], rest, rest) for start, goal in ways]
        return self.follow(trajectories, wait=wait)

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
    ) -> GroupStream:
        """Return a stream for all arms. Your program appends timed points to it while the arms move.

        Use it as a ``with`` block::

            with both.stream() as stream:
                for left, right in planner:
                    stream.append([left, right])
                stream.wait_until_dry()

        Each program buffers the next points of its arm, as with `Motions.stream`. If the buffer of one program is
        empty, or the program is stopped, all arms stop within the limits of the stream.

        Args:
            buffer, acceleration, jerk, watchdog, lookahead_time, gain, link: Options of each arm; see `Motions.stream`.

        Raises:
            LocalError: If `Motions.stream` would raise this error for one of the arms.
        """
        common = CommonPace()
        streams = []
        for robot in self.robots:
            stream = robot.motion.stream(
                buffer,
                acceleration=acceleration,
                jerk=jerk,
                watchdog=watchdog,
                lookahead_time=lookahead_time,
                gain=gain,
                link=link,
            )
            stream._join(common.member(robot.clock.to_local, 1.0 / robot.firmware.rate))
            streams.append(stream)
        return GroupStream(self._life("stream"), streams, self._names, self._stopping)

    def stop(self, acceleration: float = 2.0, *, wait: bool | float = False) -> None:
        """Stop all arms with the deceleration `acceleration`, in rad/s².

        The stop is sent to every arm, even if sending it to another arm fails.

        Raises:
            LinkError: If the stop cannot be sent to an arm. The error of the first such arm is raised.
        """
        seconds = check_wait(wait)
        stops: list[Motion] = []
        errors: list[LinkError] = []
        for robot, name in zip(self.robots, self._names, strict=True):
            try:
                with naming(name):
                    stops.append(robot.motion.stop(acceleration))
            except LinkError as error:
                errors.append(error)
        if seconds:
            for stop in stops:
                stop.wait(seconds)
        if errors:
            raise errors[0]

    @property
    def _names(self) -> list[str]:
        """Addresses of the robots, with the index of the robot if several robots have the same address."""
        addresses = [robot.address for robot in self.robots]
        return [
            address if addresses.count(address) == 1 else f"{address} (robots[{number}])"
            for number, address in enumerate(addresses)
        ]

    def _life(self, name: str) -> Lifecycle:
        sections = [robot.motion._context.section for robot in self.robots]

        @contextlib.contextmanager
        def waiting() -> Iterator[None]:
            with contextlib.ExitStack() as stack:
                for section in sections:
                    stack.enter_context(section.waiting())
                yield

        return Lifecycle(f"{name} of {len(self.robots)} arms", self._callbacks, waiting)

    # -- states ----------------------------------------------------------------------------------------

    def states(self, timeout: float | None = 5.0) -> Iterator[tuple[RealtimeState, ...]]:
        """Iterate over the newest states of all arms at the same moment, matched by the clocks of the controllers.

        Each moment is the time of a state of the slowest controller (the first one, if several are equally slow). For
        each other arm, the state nearest to this moment is used. The time of this state differs by at most half a cycle
        of that arm, plus the errors of both clocks (`RobotClock.bound`). Moments without a state from every arm are
        skipped.

        Args:
            timeout: Longest time to wait for a state of each arm, in seconds; None waits forever.

        Yields:
            One state for each arm, in the order of the group.

        Raises:
            LinkTimeout: If no state of an arm arrives in time.
            RemoteError, LocalError: See `Stream.iterate`.
        """
        moments = self._moments()
        others = {each: self.robots[each].realtime.iterate(drop_oldest(WAITING), timeout) for each in moments.others}
        for state in self.robots[moments.first].realtime.iterate(latest, timeout):
            while (lacking := moments.lacking(state)) is not None:
                newer = next(others[lacking], None)
                if newer is None:
                    return
                moments.take(lacking, newer)
            states = moments.at(state)
            if states is not None:
                yield states

    def _moments(self) -> Moments:
        return Moments([(robot.clock.to_local, robot.firmware.rate) for robot in self.robots])

    def __repr__(self) -> str:
        return f"<Group of {', '.join(robot.address for robot in self.robots)}>"


class Moments:
    """Matching of states of several arms at the same moment, in the time of this computer.

    The times of successive states must increase.

    Args:
        arms: Two values for each arm: a function that converts the controller's time in seconds to this computer's
            monotonic time, and the number of states per second.

    Attributes:
        first: Index of the arm that sets the moments with its states: the first of the slowest arms.
        others: Indices of the other arms.
    """

    def __init__(self, arms: Sequence[tuple[Callable[[float], float], float]]) -> None:
        self.first = min(range(len(arms)), key=lambda number: arms[number][1])
        self.others = [number for number in range(len(arms)) if number != self.first]
        self._arms = arms
        # For each other arm: its state before the moment, and its state after the moment.
        self._around: dict[int, tuple[RealtimeState | None, RealtimeState | None]]
        self._around = dict.fromkeys(self.others, (None, None))

    def lacking(self, state: RealtimeState) -> int | None:
        """Return the index of an arm that has no state after `state` of the first arm yet; None if all have one."""
        local = self._local(self.first, state)
        for number, (_, after) in self._around.items():
            if after is None or self._local(number, after) < local:
                return number
        return None

    def take(self, number: int, state: RealtimeState) -> None:
        """Store the next state of an arm."""
        self._around[number] = self._around[number][1], state

    def at(self, state: RealtimeState) -> tuple[RealtimeState, ...] | None:
        """Return the states of all arms nearest in time to `state` of the first arm; None if one is too far away."""
        local, found = self._local(self.first, state), {self.first: state}
        for number, around in self._around.items():
            off = {abs(self._local(number, each) - local): each for each in around if each is not None}
            if min(off) > 0.75 / self._arms[number][1]:
                return None
            found[number] = off[min(off)]
        return tuple(found[number] for number in range(len(found)))

    def _local(self, number: int, state: RealtimeState) -> float:
        return self._arms[number][0](state.time)
