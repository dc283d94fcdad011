"""Drawn commands to a simulated arm with limits: how many are accepted, and whether the arm ever leaves the limits.

    python -m tests.urlink.session.limits_drawn --each 1000 --seed 45

Each command is drawn by a seed, and sent over a connection with limits. If it is refused, the same command is sent from
the same position over a connection without limits. So the report tells for every kind how many commands the arm could
have executed within the limits, how many of them were accepted, and how many accepted commands have left the limits.
The limits are compared with the targets of the simulated arm in every cycle of its controller.

Some commands consist of several calls, such as the points of a stream and their replacement. If a call is refused, the
connection without limits makes the calls up to this one, because a later call must not make an earlier one harmless. A
motion that is stopped at a limit while it runs counts as refused, unless the arm moved exactly as without limits,
because the command ended in the same cycle.

The report also gives the share among the commands that themselves stay within the limits, with the margins that
docs/session-limits.md states. For these, the values that the arm was asked for are compared with the limits too: the
set-points of ``servoj``, and the speeds of a jog. The arm can be slower, because the controller smooths set-points, and
because the arm might not reach its speed before the command ends.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import itertools
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing import get_context
from typing import Any
from unittest import mock

import numpy as np

import urlink
from linkcore import clock
from linkcore.errors import LinkError
from linkcore.handle import Motion
from urlink import Circular, Joint, LimitExceeded, Linear, SessionLimits, Trajectory, TrajectoryPoint
from urlink.arm.kinematics import Arm
from urlink.arm.poses import rotvec_to_matrix
from urlink.arm.vectors import FloatArray
from urlink.robot import Robot
from urlink.session.session_limits import KINDS, MARGIN
from urlink.session.session_limits import SLACK as STATED_SLACK
from urlink.simulator import Controller
from urlink.simulator.robot.generator.streamed_motion import ServoMotion

#: Box of the TCP, and the part of it in which motions begin, in m in the base frame of the arm.
BOX = ((-0.75, -0.40, 0.10), (-0.25, 0.25, 0.60))
#: Limits of the speeds, in m/s and rad/s.
TOOL_SPEED, JOINT_SPEED = 0.25, 1.0
LIMITS = SessionLimits(tool_speed=TOOL_SPEED, joint_speed=JOINT_SPEED, box=BOX, allowed=KINDS)
#: Fraction by which a speed may exceed its limit before it counts as outside. Predictions are computed from samples.
SLACK = 2e-3
#: Joint positions near all starts, in rad: elbow up, tool down.
READY = np.array([0.0, -1.6, 1.9, -1.9, -1.57, 0.0])
#: Longest time to wait for the end of a motion, in s of the simulated clock.
TIMEOUT = 120.0
#: Commands in one simulated world, and arms by their firmware.
_CHUNK, _ARMS = 20, (("ur5", "3.15"),) * 9 + (("ur5e", "5.11"),)
#: Time in s over which the speed of set-points is measured. They are rounded, so a shorter time is not precise enough.
_PERIOD = 0.008
#: Largest difference in rad between two motions that count as the same.
_SAME = 1e-6
#: Time in s within which springs pull the arm to a target.
_ARRIVING = 10.0
#: First firmware with direct torque, for impedances of the joints.
_TORQUE = ("ur5e", "5.25")


@dataclass
class Tally:
    """Figures of one kind.

    Attributes:
        commands: Number of drawn commands.
        accepted: Number of accepted commands.
        inside: Number of commands that stay within the limits.
        accepted_inside: Number of accepted commands among them.
        proper: Number of commands among those inside that ask only for values within the limits, with the margins.
        accepted_proper: Number of accepted commands among them.
        escaped: Descriptions of accepted commands that have left the limits.
        box, tool_speed, joint_speed: Largest distance outside of the box in m, and largest speeds in m/s and rad/s, of
            the accepted commands.
    """

    commands: int = 0
    accepted: int = 0
    inside: int = 0
    accepted_inside: int = 0
    proper: int = 0
    accepted_proper: int = 0
    escaped: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    box: float = -np.inf
    tool_speed: float = 0.0
    joint_speed: float = 0.0

    def add(self, other: Tally) -> None:
        """Add the figures of other commands."""
        for name in ("commands", "accepted", "inside", "accepted_inside", "proper", "accepted_proper"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for name in ("box", "tool_speed", "joint_speed"):
            setattr(self, name, max(getattr(self, name), getattr(other, name)))
        self.escaped += other.escaped
        self.refused += other.refused

    def count(self, seen: Seen, *, is_accepted: bool) -> None:
        """Count a command that stayed within the limits."""
        self.inside += 1
        self.accepted_inside += is_accepted
        self.proper += seen.is_proper
        self.accepted_proper += is_accepted and seen.is_proper

    def __str__(self) -> str:
        share, proper = (
            accepted / count if count else 1.0
            for accepted, count in ((self.accepted_inside, self.inside), (self.accepted_proper, self.proper))
        )
        return (
            f"{self.commands:5d} drawn {self.accepted:5d} accepted {self.inside:5d} stay inside, of which accepted "
            f"{self.accepted_inside:5d} = {share:7.2%}; ask so {self.proper:5d}, of which accepted "
            f"{self.accepted_proper:5d} = {proper:7.2%}; outside {len(self.escaped):3d}; "
            f"box {self.box * 1e3:+8.2f} mm, tool {self.tool_speed:.4f} m/s, joint {self.joint_speed:.4f} rad/s"
        )


@dataclass(frozen=True)
class Seen:
    """What the arm did: distance outside of the box in m, and largest speeds in m/s and rad/s.

    Attributes:
        asked: The same for the set-points and the speeds that the arm was asked for; None if there were none.
    """

    box: float
    tool_speed: float
    joint_speed: float
    error: str = ""
    asked: Seen | None = None

    @property
    def is_inside(self) -> bool:
        """Whether the arm stayed within the limits."""
        return self._is_within(0.0, SLACK)

    @property
    def is_proper(self) -> bool:
        """Whether what the arm did and was asked for is within the limits, with the margins that the page states."""
        return all(each is None or each._is_within(-MARGIN, STATED_SLACK) for each in (self, self.asked))

    def _is_within(self, box: float, slack: float) -> bool:
        return (
            self.box <= box
            and self.tool_speed <= TOOL_SPEED * (1.0 + slack)
            and self.joint_speed <= JOINT_SPEED * (1.0 + slack)
        )


#: A drawn command: it is executed on a robot, and returns when the arm is at rest.
Command = Callable[["Bench"], None]


class Bench:
    """Simulated arm with two connections: one with limits, one without."""

    def __init__(
        self, controller: Controller, limited: Robot, free: Robot, rng: np.random.Generator, goals: list[list[float]]
    ) -> None:
        self.controller, self.limited, self.free, self.rng = controller, limited, free, rng
        self.robot = limited
        self.arm: Arm = free.kinematics
        self.rows: list[tuple[FloatArray, FloatArray]] = []
        #: goals of ``servoj`` in each cycle, in rad
        self.goals = goals
        #: speeds that the arm was asked for: number of the first row, frame, speeds, and their duration in s
        self.speeds: list[tuple[int, str, FloatArray, float]] = []
        self.cycle = 1.0 / free.firmware.rate
        #: number of calls that the command has made, and that it may make
        self._made, self._wanted = 0, np.inf
        free.realtime.subscribe(lambda state: self.rows.append((state.q_target, state.qd_target)), inline=True)
        free.realtime.wait()

    @property
    def motion(self) -> Any:
        """Motions of the robot that executes the command now."""
        return self.robot.motion

    def rest(self) -> None:
        """Wait until the arm is at rest."""
        # Two cycles later the last packet of a motion has arrived.
        self.free.realtime.wait_until(lambda state: not state.qd_target.any(), TIMEOUT)

    def start(self) -> FloatArray:
        """Return the positions from which the next command begins: those of the arm, or others if it is outside."""
        q = self.free.realtime.wait().q_target
        place, (low, high) = self.arm.forward(q)[:3], np.array(BOX)
        is_inside = (place > low + 0.01).all() and (place < high - 0.01).all() and np.abs(q - READY).max() < 1.5
        return q if is_inside else self.joints()

    def place(self, q: FloatArray) -> None:
        """Bring the arm to a position, over the connection without limits."""
        if np.abs(self.free.realtime.wait().q_target - q).max() < 1e-6:
            return
        self.free.motion.move_joints(q, speed=3.0, acceleration=15.0).wait(TIMEOUT)
        self.rest()

    def begins_call(self) -> bool:
        """Return whether the command makes its next call: not after the call that was refused with limits."""
        if self._made >= self._wanted:
            return False
        self._made += 1
        return True

    @property
    def was_refused(self) -> bool:
        """Whether a call of this command was refused over the connection with limits."""
        return self._wanted < np.inf

    def run(self, command: Command, robot: Robot) -> Seen | LimitExceeded:
        """Execute a command; return what the arm did, or the refusal if it was refused or stopped at a limit.

        Over the connection without limits, the command ends after the call that was refused.
        """
        self.robot = robot
        self._made = 0
        if robot is self.limited:
            self._wanted = np.inf
        newest = self.free.realtime.latest
        assert newest is not None
        self.rows[:] = [(newest.q_target, newest.qd_target)]
        self.goals.clear()
        self.speeds.clear()
        error = ""
        refusal = None
        try:
            command(self)
        except LimitExceeded as exceeded:
            refusal = exceeded
            self._wanted = max(self._made, 1)
        except LinkError as failed:
            error = f"{type(failed).__name__}: {failed}"
        self.rest()
        if "SafetyStop" in error:
            self.unlock()
        seen = self.seen(error)
        if refusal is not None and seen.is_inside:
            return refusal
        return seen

    def unlock(self) -> None:
        """End a protective stop."""
        self.free.realtime.wait_until(lambda state: True)
        clock.sleep(6.0)
        with contextlib.suppress(LinkError):
            self.free.dashboard.unlock_protective_stop()
        clock.sleep(1.0)

    def seen(self, error: str) -> Seen:
        """Return what the arm did since the command began."""
        q, qd = (np.array(each) for each in zip(*self.rows, strict=True))
        return dataclasses.replace(self._measured(q, qd), error=error, asked=self._setpoints() or self._speeds())

    def _setpoints(self) -> Seen | None:
        """Return what an arm would do that is always at its set-points."""
        goals = np.array(self.goals[:: max(round(_PERIOD / self.cycle), 1)])
        if len(goals) < 4:
            return None
        begin, end = goals[:-1], goals[1:]
        rates = (end - begin) / max(_PERIOD, self.cycle)
        # If a set-point arrives one cycle late, the next step is twice as long. So the median of three steps counts.
        steady = np.sort(np.stack([np.linalg.norm(rates, axis=1)[i : len(rates) - 2 + i] for i in range(3)]), axis=0)[1]
        is_steady = np.linalg.norm(rates[1:-1], axis=1) <= steady * (1.0 + 1e-9)
        if not is_steady.any():
            return None
        middles = 0.5 * (begin + end)[1:-1]
        return self._measured(middles[is_steady], rates[1:-1][is_steady])

    def ask(self, frame: str, speeds: FloatArray, seconds: float) -> None:
        """Note that the arm is asked for speeds in a frame: "joints", "base" or "tool"."""
        self.speeds.append((len(self.rows) - 1, frame, speeds, seconds))

    def _speeds(self) -> Seen | None:
        """Return what an arm would do that is always at the speeds that it was asked for."""
        if not self.speeds:
            return None
        found = []
        ends = [first for first, *_ in self.speeds[1:]] + [len(self.rows)]
        for (first, frame, speeds, seconds), end in zip(self.speeds, ends, strict=True):
            rows = self.rows[first : max(min(end, first + round(seconds / self.cycle)), first + 1)]
            q = np.array([row[0] for row in rows])
            rates = np.broadcast_to(speeds, q.shape)
            if frame != "joints":
                turns = [np.eye(3) if frame == "base" else rotvec_to_matrix(pose[3:]) for pose in self.arm.forward(q)]
                twists = [np.concatenate([turn @ speeds[:3], turn @ speeds[3:]]) for turn in turns]
                rates = np.linalg.solve(self.arm.jacobian(q), np.array(twists)[..., np.newaxis])[..., 0]
            found.append(self._measured(q, rates))
        return Seen(*(max(getattr(each, name) for each in found) for name in ("box", "tool_speed", "joint_speed")))

    def moved(self) -> FloatArray:
        """Return the positions of the arm from its first to its last motion since the command began, (n, 6) rad."""
        q, qd = (np.array(each) for each in zip(*self.rows, strict=True))
        moving = np.flatnonzero(qd.any(axis=1))
        return q[moving[0] : moving[-1] + 1] if len(moving) else q[:0]

    def _measured(self, q: FloatArray, qd: FloatArray) -> Seen:
        places = self.arm.forward(q)[:, :3]
        low, high = np.array(BOX)
        speeds = np.linalg.norm(np.einsum("nij,nj->ni", self.arm.jacobian(q)[:, :3], qd), axis=1)
        outside = float(np.maximum(low - places, places - high).max())
        return Seen(outside, float(speeds.max()), float(np.abs(qd).max()))

    # -- drawing -----------------------------------------------------------------------------------------

    def pose(self, wider: float = 0.0) -> FloatArray:
        """Draw a pose with the tool about downwards: in the box, or `wider` m around it."""
        low, high = np.array(BOX)
        place = self.rng.uniform(low + 0.01 - wider, high - 0.01 + wider)
        turn = np.array([np.pi, 0.0, 0.0]) + self.rng.uniform(-0.3, 0.3, 3)
        return np.concatenate([place, turn])

    def joints(self, wider: float = 0.0) -> FloatArray:
        """Draw joint positions whose TCP is in the box, or `wider` m around it."""
        while True:
            with contextlib.suppress(LinkError):
                q: FloatArray = self.arm.inverse(self.pose(wider), READY)
                if np.abs(q - READY).max() < 2.0:
                    return q

    def goal(self, wider: float = 0.0) -> FloatArray:
        """Draw joint positions on the way from the arm to positions in the box, or `wider` m around it."""
        here = self.free.realtime.wait().q_target
        return np.asarray(here + (self.joints(wider) - here) * self.rng.uniform(0.1, 0.6))

    def goal_pose(self, wider: float = 0.0) -> FloatArray:
        """Draw a pose whose position is on the way from the tool to a position in the box, or `wider` m around it."""
        here = self.arm.forward(self.free.realtime.wait().q_target)
        pose = self.pose(wider)
        pose[:3] = here[:3] + (pose[:3] - here[:3]) * self.rng.uniform(0.1, 0.6)
        return pose

    def log(self, low: float, high: float) -> float:
        """Draw a number whose logarithm is uniform."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def way(self, size: float) -> FloatArray:
        """Draw a vector with a uniform direction and this length."""
        vector = self.rng.normal(size=3)
        return np.asarray(size * vector / np.linalg.norm(vector))


# -- kinds -------------------------------------------------------------------------------------------------


def move_joints(bench: Bench) -> Command:
    q, speed, acceleration = bench.goal(0.3), bench.log(0.15, 1.5), bench.log(1.0, 5.0)
    how: dict[str, float] = {"speed": speed, "acceleration": acceleration}
    if bench.rng.random() < 0.25:
        how = {"time": bench.log(0.5, 5.0)}
    return lambda on: on.motion.move_joints(q, **how).wait(TIMEOUT)


def move_linear(bench: Bench) -> Command:
    pose, speed, acceleration = bench.goal_pose(0.3), bench.log(0.1, 0.4), bench.log(0.5, 3.0)
    how: dict[str, float] = {"speed": speed, "acceleration": acceleration}
    if bench.rng.random() < 0.25:
        how = {"time": bench.log(1.0, 5.0)}
    return lambda on: on.motion.move_linear(pose, **how).wait(TIMEOUT)


def move_circular(bench: Bench) -> Command:
    via, to, speed = bench.goal_pose(0.1), bench.goal_pose(0.1), bench.log(0.15, 0.4)
    return lambda on: on.motion.move_circular(via, to, speed, 1.0).wait(TIMEOUT)


def path(bench: Bench) -> Command:
    points: list[Any] = []
    for number in range(3):
        blend = float(bench.rng.uniform(0.0, 0.04)) if number < 2 and bench.rng.random() < 0.7 else 0.0
        what = bench.rng.random()
        if what < 0.4:
            points.append(Joint(bench.goal(), blend=blend))
        elif what < 0.8:
            points.append(Linear(bench.goal_pose(), blend=blend))
        else:
            points.append(Circular(bench.goal_pose(), bench.goal_pose(), blend=blend))
    speed, joint_speed = bench.log(0.15, 0.3), bench.log(0.15, 0.5)
    return lambda on: on.motion.path(points, speed, 1.0, joint_speed=joint_speed).wait(TIMEOUT)


def speed_joints(bench: Bench) -> Command:
    qd = bench.rng.normal(size=6) * bench.log(0.03, 0.6)
    duration, acceleration = bench.log(0.1, 1.5), bench.log(0.5, 4.0)

    def start(on: Bench) -> Motion:
        on.ask("joints", qd, duration)
        motion: Motion = on.motion.speed_joints(qd, acceleration, duration=duration)
        return motion

    return lambda on: _continued(on, start, duration)


def speed_linear(bench: Bench) -> Command:
    xd = np.concatenate([bench.way(bench.log(0.02, 0.4)), bench.rng.normal(size=3) * 0.1])
    duration, acceleration = bench.log(0.1, 1.5), bench.log(0.3, 3.0)

    def start(on: Bench) -> Motion:
        on.ask("base", xd, duration)
        motion: Motion = on.motion.speed_linear(xd, acceleration, duration=duration)
        return motion

    return lambda on: _continued(on, start, duration)


def _continued(on: Bench, start: Callable[[Bench], Motion], duration: float) -> None:
    """Start a motion at one speed. Start it again before a short speed has expired."""
    on.begins_call()
    motion = start(on)
    if duration <= 0.5:
        clock.sleep(0.5 * duration)
        if on.begins_call():
            motion = start(on)
    motion.wait(TIMEOUT)


def _trajectory(bench: Bench, start: FloatArray) -> Trajectory:
    rows = [start, *(bench.goal(0.2) for _ in range(2))]
    reach = [float(np.abs(b - a).max()) for a, b in itertools.pairwise(rows)]
    times = np.concatenate([[0.0], np.cumsum([max(each / bench.log(0.2, 0.6), 0.2) for each in reach])])
    return Trajectory.from_arrays(times, rows)


def follow(bench: Bench) -> Command:
    trajectory = _trajectory(bench, bench.free.realtime.wait().q_target)
    low_bandwidth = bool(bench.rng.random() < 0.3)
    return lambda on: on.motion.follow(trajectory, low_bandwidth=low_bandwidth).wait(TIMEOUT)


def servo(bench: Bench) -> Command:
    begin, end = bench.free.realtime.wait().q_target, bench.goal(0.25)
    if bench.rng.random() < 0.4:
        # The second target follows while the arm moves to the first one, which is well inside.
        targets = [bench.goal(-0.08), end] if bench.rng.random() < 0.3 else [end]
        speed, acceleration, pause = bench.log(0.1, 0.6), bench.log(1.0, 5.0), bench.log(0.1, 1.0)

        def filtered(on: Bench) -> None:
            with on.motion.servo(
                target_filter="jerk_limited", speed=speed, acceleration=acceleration, jerk=40.0
            ) as loop:
                sent = begin
                for target in targets:
                    if target is not targets[0]:
                        clock.sleep(pause)
                    if on.begins_call():
                        loop.send(target)
                        sent = target
                on.robot.realtime.wait_until(lambda state: bool(np.abs(state.q_target - sent).max() < 1e-4), TIMEOUT)

        return filtered
    seconds = float(np.abs(end - begin).max()) / bench.log(0.2, 0.6) + 0.3

    def looped(on: Bench) -> None:
        first = None
        with on.motion.servo() as loop:
            for state in on.robot.realtime:
                first = state.time if first is None else first
                u = (state.time - first) / seconds
                if u > 1.05:
                    break
                u = min(u, 1.0)
                loop.send(begin + (10.0 - 15.0 * u + 6.0 * u * u) * u**3 * (end - begin))

    return looped


def stream(bench: Bench) -> Command:
    trajectory = _trajectory(bench, bench.free.realtime.wait().q_target)
    has_speeds = bool(bench.rng.random() < 0.6)
    points = [
        TrajectoryPoint(q, t, qd if has_speeds else None)
        for q, t, qd in zip(trajectory.q, trajectory.time.tolist(), trajectory.qd, strict=True)
    ]
    replaced = None
    if bench.rng.random() < 0.4:
        replaced = TrajectoryPoint(bench.goal(), float(trajectory.time[-1]) + 1.0, np.zeros(6))

    def command(on: Bench) -> None:
        with on.motion.stream() as flow:
            on.begins_call()
            flow.append(points)
            if replaced is not None and on.begins_call():
                flow.replace(flow.time + 0.3, replaced)
            flow.wait_until_dry(TIMEOUT)

    return command


def jog(bench: Bench) -> Command:
    frame: Any = bench.rng.choice(["joints", "base", "tool"])
    timeout = float(bench.rng.uniform(0.1, 0.5))
    moves = []
    for _ in range(3):
        if frame == "joints":
            speeds = bench.rng.normal(size=6) * bench.log(0.03, 0.3)
        else:
            speeds = np.concatenate([bench.way(bench.log(0.02, 0.3)), bench.rng.normal(size=3) * 0.1])
        # The next speeds follow when these have expired: while the arm brakes, or when it is at rest.
        moves.append((speeds, timeout + float(bench.rng.choice([0.0, 0.05, 0.6]))))

    def command(on: Bench) -> None:
        with on.motion.jog(str(frame), timeout=timeout) as handle:
            for speeds, pause in moves:
                if not on.begins_call():
                    break
                on.ask(str(frame), speeds, timeout)
                handle.move(speeds)
                clock.sleep(pause)
                if handle.limit is not None:
                    raise handle.limit

    return command


def until_contact(bench: Bench) -> Command:
    direction, speed, distance = bench.way(1.0), bench.log(0.05, 0.3), bench.log(0.02, 0.3)

    def command(on: Bench) -> None:
        with contextlib.suppress(urlink.NoContact):
            on.motion.until_contact(direction, speed, distance=distance, force=50.0).wait(TIMEOUT)

    return command


def force_mode(bench: Bench) -> Command:
    selection = [int(each) for each in bench.rng.random(3) < 0.5] + [0, 0, 0]
    wrench = [*bench.way(bench.log(2.0, 30.0)), 0.0, 0.0, 0.0]
    speed, seconds = bench.log(0.02, 0.3), bench.log(0.2, 2.0)
    fastest = [speed if each else 0.1 for each in selection[:3]] + [0.3] * 3

    def command(on: Bench) -> None:
        with (
            on.motion.force_mode("base", selection, wrench, fastest) as pressing,
            contextlib.suppress(urlink.LinkTimeout),
        ):
            pressing.wait(seconds)

    return command


def impedance(bench: Bench) -> Command:
    begin, end = bench.free.realtime.wait().q_target, bench.joints(0.05)
    target = begin + (end - begin) * bench.log(0.05, 1.0)
    speed, seconds = bench.log(0.1, 1.3), bench.log(0.5, 4.0)

    def command(on: Bench) -> None:
        with on.motion.impedance(speed=speed) as soft:
            soft.send(target)
            with contextlib.suppress(urlink.LinkTimeout):
                # A target that was refused must not count as harmless because the arm did not arrive in time.
                soft.wait(_ARRIVING if on.was_refused else seconds)

    return command


DRAWN: dict[str, Callable[[Bench], Command]] = {
    each.__name__: each
    for each in (
        move_joints,
        move_linear,
        move_circular,
        path,
        speed_joints,
        speed_linear,
        follow,
        servo,
        stream,
        jog,
        until_contact,
        force_mode,
        impedance,
    )
}


# -- measuring -----------------------------------------------------------------------------------------------


@contextlib.contextmanager
def bench(arm: str, firmware: str, rng: np.random.Generator) -> Iterator[Bench]:
    """Yield a simulated arm with both connections."""
    goals: list[list[float]] = []
    advance = ServoMotion.advance

    def noting(motion: ServoMotion, *how: Any) -> Any:
        setpoint = advance(motion, *how)
        goals.append(list(motion.goal))
        return setpoint

    with (
        mock.patch.object(ServoMotion, "advance", noting),
        Controller(model=arm, firmware=firmware, noise=False) as controller,
        urlink.connect(controller.address, limits=LIMITS) as limited,
        urlink.connect(controller.address) as free,
    ):
        yield Bench(controller, limited, free, rng, goals)


def measured(kind: str, seed: int, number: int, count: int) -> Tally:
    """Execute `count` drawn commands of one kind in a new simulated world; return the figures."""
    tally = Tally()
    arm, firmware = _TORQUE if kind == "impedance" else _ARMS[number % len(_ARMS)]
    with urlink.simulated_time():
        rng = np.random.default_rng([seed, sorted(DRAWN).index(kind), number])
        with bench(arm, firmware, rng) as on:
            for _ in range(count):
                measure_one(kind, on, tally)
    return tally


def measure_one(kind: str, on: Bench, tally: Tally) -> None:
    """Execute one drawn command, and add its figures to the tally."""
    start = on.start()
    on.place(start)
    command = DRAWN[kind](on)
    tally.commands += 1
    seen = on.run(command, on.limited)
    moved = on.moved()
    if isinstance(seen, Seen):
        tally.accepted += 1
        tally.box, tally.tool_speed = max(tally.box, seen.box), max(tally.tool_speed, seen.tool_speed)
        tally.joint_speed = max(tally.joint_speed, seen.joint_speed)
        if not seen.is_inside:
            tally.escaped.append(f"{kind} {tally.commands}: {seen}")
        elif not seen.error:
            tally.count(seen, is_accepted=True)
        return
    on.place(start)
    free = on.run(command, on.free)
    assert isinstance(free, Seen)
    if free.is_inside and not free.error:
        as_free = on.moved()
        is_same = len(moved) == len(as_free) > 0 and bool(np.abs(moved - as_free).max() < _SAME)
        tally.count(free, is_accepted=is_same)
        tally.accepted += is_same
        if is_same:
            return
        tally.refused.append(f"{kind} {tally.commands}: {seen} but {free}")


def _of_chunk(job: tuple[str, int, int, int]) -> tuple[str, Tally]:
    return job[0], measured(*job)


def main(arguments: Sequence[str]) -> int:
    """Measure all kinds, print one line for each, and return 1 if an arm has left the limits."""
    parser = argparse.ArgumentParser(prog="limits_drawn", description=__doc__.splitlines()[0])
    parser.add_argument("--each", type=int, default=1000, help="commands of each kind (default: 1000)")
    parser.add_argument("--seed", type=int, default=45, help="seed (default: 45)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: 1)")
    parser.add_argument("--kinds", nargs="*", choices=sorted(DRAWN), default=list(DRAWN), help="kinds (default: all)")
    parser.add_argument("--minutes", type=float, default=np.inf, help="stop after this time (default: never)")
    parser.add_argument("--show", action="store_true", help="show commands that were wrongly accepted or refused")
    args = parser.parse_args(arguments)
    jobs = [
        (kind, args.seed, first // _CHUNK, min(_CHUNK, args.each - first))
        for kind in args.kinds
        for first in range(0, args.each, _CHUNK)
    ]
    until = time.monotonic() + 60.0 * args.minutes
    totals = {kind: Tally() for kind in args.kinds}
    with (
        get_context("spawn").Pool(args.jobs, maxtasksperchild=8) if args.jobs > 1 else contextlib.nullcontext() as pool
    ):
        results = map(_of_chunk, jobs) if pool is None else pool.imap(_of_chunk, jobs)
        for kind, tally in results:
            totals[kind].add(tally)
            is_over = time.monotonic() > until
            if totals[kind].commands == args.each or is_over:
                print(f"{kind:14}{totals[kind]}", flush=True)
                if args.show:
                    print(*(totals[kind].escaped + totals[kind].refused), sep="\n", flush=True)
            if is_over:
                break
    return 1 if any(tally.escaped for tally in totals.values()) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
