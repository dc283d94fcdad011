"""Several arms as one: their motions begin at once, pass in one time, and end together; their states by one clock.

Each arm is led by a program of its own, as with `follow`. What makes them one is the time of their trajectories
(`urlink.motion.stream.common_time`), and that what ends one before its time stops all.
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

#: Peak of speed and of acceleration of the quintic from 0 to 1 in one second, at rest at both ends.
_PEAK_SPEED, _PEAK_ACCELERATION = 1.875, 10.0 / math.sqrt(3.0)
#: s of a movement at least: of arms that are at their goal already.
_SHORTEST = 0.1
#: States of one arm that wait for those of the others.
WAITING = 64


class Group(StrictAttributes):
    """Arms that move together::

        with urlink.connect(LEFT) as left, urlink.connect(RIGHT) as right:
            both = urlink.Group(left, right)
            both.follow([reach_left, reach_right]).wait()

    Motions begin at the same moment, by the clocks of the controllers (`Robot.clock`), and pass as slowly as the arm
    that is slowest with its program: speed slider, pause, and the controller's own limits. What ends the motion of one
    arm before its time (a stop, an error, another motion, `cancel`) stops all.

    Args:
        robots: at least two, each once.

    Attributes:
        robots: as given.

    Raises:
        BadValue: fewer than two, or one of them twice.
    """

    def __init__(self, *robots: Robot) -> None:
        for robot in robots:
            if not isinstance(robot, Robot):
                raise BadValue(f"{robot!r} is no Robot of urlink.connect")
        if len(robots) < 2 or len({id(robot) for robot in robots}) < len(robots):
            raise BadValue(f"a group of {len(robots)} robots; expected at least two, each of them once")
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
        """Follow a trajectory with each arm, all in one time.

        The arms begin 50 ms after the last of them is at rest and its program has connected. One whose program is
        paused halts all; once it goes on, it catches up with the others by a tenth of the speed.

        Args:
            trajectories: one for each arm; see `Motions.follow`. They may have different durations.
            path_tolerance, goal_tolerance, goal_time, start_tolerance, watchdog, lookahead_time, gain, link: as for
                `Motions.follow`, of each arm.
            wait: see `Motions`.

        Raises:
            BadValue: not one trajectory for each arm; or one of an arm is refused, and nothing was sent.
            LinkError: one arm could not begin; none has moved.
        """
        seconds = check_wait(wait)
        if len(trajectories) != len(self.robots):
            raise BadValue(f"{len(trajectories)} trajectories for a group of {len(self.robots)} robots")
        tolerances = Tolerances.checked(path_tolerance, goal_tolerance, goal_time, start_tolerance)
        common = CommonTime()
        parts = []
        for robot, trajectory in zip(self.robots, trajectories, strict=True):
            if not isinstance(trajectory, Trajectory):
                raise BadValue(f"{trajectory!r} is no Trajectory")
            motions = robot.motion
            trajectory.check(robot.identity.arm)
            trajectory.check(near=motions._context.state().q_target, within=tolerances.start)
            timer = common.member(robot.clock.to_local, 1.0 / robot.firmware.rate)
            servoing = motions._servoing(watchdog, lookahead_time, gain)
            parts.append((motions, Follower(trajectory, tolerances, servoing, timer=timer), timer))
        # Before the first arm moves: what ends the motion of one arm stops the others in this thread.
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
            end_all([motion._life for motion in begun], "stopped, since that of another arm could not begin")
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
        """Move each arm from where it stands to joint positions, straight in joint space; all arrive at the same time.

        It is a `follow` of quintic trajectories that are at rest at both ends, so no joint exceeds the speed and the
        acceleration.

        Args:
            q: (6,) rad for each arm.
            speed: rad/s of the joint that moves fastest, of all arms.
            acceleration: rad/s² of the joint that is accelerated most.
            time: s that it takes, instead of a speed and an acceleration; these cannot be given with it.
            wait: see `Motions`.

        Raises:
            BadValue: not one goal for each arm; or beyond the limits of an arm.
            LocalError: an arm moves.
            LinkError: one arm could not begin; none has moved.
        """
        check_wait(wait)
        if time is not None:
            check_overridden("time sets the duration", speed=speed, acceleration=acceleration)
        if len(q) != len(self.robots):
            raise BadValue(f"{len(q)} goals for a group of {len(self.robots)} robots")
        goals = [six(goal, f"q[{number}]") for number, goal in enumerate(q)]
        starts = []
        for robot in self.robots:
            state = robot.motion._context.state()
            if not stands(state.qd_target):
                raise LocalError(f"{robot.address} moves: a group begins where its arms stand")
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
        """Points with times for all arms, appended while they move through those before::

            with both.stream() as stream:
                for left, right in planner:
                    stream.append([left, right])
                stream.wait_until_dry()

        Each program holds the next points of its arm, as that of `Motions.stream`. Where one has none left, or is
        stopped, all come to a stop within the limits of the stream.

        Args:
            buffer, acceleration, jerk, watchdog, lookahead_time, gain, link: as for `Motions.stream`, of each arm.

        Raises:
            LocalError: as `Motions.stream`, for one of the arms.
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
        """Brake all arms, at `acceleration` in rad/s²; each is sent the stop, also where another one cannot be.

        Raises:
            LinkError: that of the first one to which the stop could not be sent.
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
        """The addresses, with the number of the robot if two simulated arms have the same address."""
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
        """States of all arms of the same moment, the newest that there are, by the clocks of their controllers.

        Those of the slowest controller, or of the first of the slowest, and of each other arm the one nearest to it: at
        most half of a cycle of that arm away, and what both clocks may be off (`RobotClock.bound`). Moments of which an
        arm has no state are left out.

        Args:
            timeout: s within which each arm must send a state; None for ever.

        Yields:
            one state for each arm, in the order of the group.

        Raises:
            LinkTimeout: none came from an arm in time.
            RemoteError, LocalError: as `Stream.iterate`.
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
    """States of several arms of the same moment, found by the time of this computer. Times only go on.

    Args:
        arms: of each, what converts s of its controller to monotonic s of this computer, and its states per second.

    Attributes:
        first: number of the arm whose states set the moments: the slowest, or the first of those.
        others: numbers of the other ones.
    """

    def __init__(self, arms: Sequence[tuple[Callable[[float], float], float]]) -> None:
        self.first = min(range(len(arms)), key=lambda number: arms[number][1])
        self.others = [number for number in range(len(arms)) if number != self.first]
        self._arms = arms
        #: of each other arm, its state before the moment, and after it
        self._around: dict[int, tuple[RealtimeState | None, RealtimeState | None]]
        self._around = dict.fromkeys(self.others, (None, None))

    def lacking(self, state: RealtimeState) -> int | None:
        """Number of an arm whose next state is needed for the moment of a state of the first; None if there is none."""
        local = self._local(self.first, state)
        for number, (_, after) in self._around.items():
            if after is None or self._local(number, after) < local:
                return number
        return None

    def take(self, number: int, state: RealtimeState) -> None:
        """The next state of an arm."""
        self._around[number] = self._around[number][1], state

    def at(self, state: RealtimeState) -> tuple[RealtimeState, ...] | None:
        """The states of all arms, nearest to one of the first; None if one of them has none near it."""
        local, found = self._local(self.first, state), {self.first: state}
        for number, around in self._around.items():
            off = {abs(self._local(number, each) - local): each for each in around if each is not None}
            if min(off) > 0.75 / self._arms[number][1]:
                return None
            found[number] = off[min(off)]
        return tuple(found[number] for number in range(len(found)))

    def _local(self, number: int, state: RealtimeState) -> float:
        return self._arms[number][0](state.time)
