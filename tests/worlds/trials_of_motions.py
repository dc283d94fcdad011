"""Trials of motions, blocks and groups: positions and times of the arm, and the states of handles."""

from __future__ import annotations

import contextlib
import itertools
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import urlink
from linkcore.errors import BadValue, Cancelled, LinkError, LinkTimeout, LocalError
from linkcore.handle import Phase
from urlink.arm.poses import rotvec_to_matrix
from urlink.errors import NoContact, ToleranceExceeded
from urlink.motion.teaching import Taught, TaughtPoint
from urlink.simulator import Controller

from .trials import Bench, trial

_READY = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
#: Time for an arm to come to rest from the motions of the trials, in s.
_RESTS = 1.0


def _goal(bench: Bench, far: float = 0.2) -> np.ndarray:
    goal: np.ndarray = bench.robot.realtime.wait(2.0).q_target + [bench.chance.uniform(-far, far) for _ in range(6)]
    return goal


def _rests(bench: Bench, robot: Any = None) -> bool:
    return bool(np.abs((robot or bench.robot).realtime.wait(2.0).qd_actual).max() < 0.02)


def _zero_force(robot: Any) -> None:
    """Remove the offset of the force sensor, which would push an arm in force mode away."""
    robot.zero_force_sensor()
    time.sleep(0.1)


def _brakes(bench: Bench, within: float, why: str) -> None:
    time.sleep(within)
    bench.check(_rests(bench), f"the arm moves {within:.2f} s after {why}")


def _follows(handle: Any, bench: Bench) -> tuple[list[Any], list[float]]:
    """Return the phases of a handle in order, and the values of `progress`, until it has ended."""
    phases, parts = [handle.phase], [handle.progress]
    until = bench.now + 20.0
    while not handle.done and bench.now < until:
        time.sleep(0.01)
        if handle.phase is not phases[-1]:
            phases.append(handle.phase)
        parts.append(handle.progress)
    return phases, parts


@trial
def a_move(bench: Bench) -> None:
    """A motion ends when the arm is at the goal; its callbacks are called once, and its phases follow the table."""
    robot, chance = bench.robot, bench.chance
    state = robot.realtime.wait(2.0)
    goal, pose = _goal(bench), state.tool_vector_actual.copy()
    pose[2] += 0.03
    via, to = pose.copy(), pose.copy()
    via[1] += 0.03
    to[1] += 0.06
    ways = [urlink.Joint(goal - 0.05), urlink.Joint(goal, blend=0.0)]
    name = chance.choice(("move_joints", "move_linear", "move_circular", "path", "timed", "taught"))
    begins: dict[str, Callable[[], Any]] = {
        "move_joints": lambda: robot.motion.move_joints(goal, speed=0.5),
        "timed": lambda: robot.motion.move_joints(goal, time=1.2),
        "move_linear": lambda: robot.motion.move_linear(pose, speed=0.1),
        "move_circular": lambda: robot.motion.move_circular(via, to, speed=0.1),
        "path": lambda: robot.motion.path(ways, joint_speed=0.5),
        "taught": lambda: Taught([TaughtPoint(q, state.tool_vector_actual) for q in (goal - 0.05, goal)]).play(robot),
    }
    done: list[Any] = []
    begun = bench.now
    handle = begins[name]()
    bench.check(handle.name and not handle.done and handle.error is None, f"{handle.name}, {handle.error}")
    bench.check(robot.motion.current is handle, f"the current motion is {robot.motion.current}")
    handle.add_done_callback(done.append)
    with bench.raises(LinkTimeout, after=0.05):
        handle.wait(0.05)
    phases, parts = _follows(handle, bench)
    took = bench.now - begun
    handle.wait(1.0)
    time.sleep(0.05)
    there = robot.realtime.wait(2.0)
    if name.startswith("move_l") or name.startswith("move_c"):
        expected = pose if name == "move_linear" else to
        bench.check(np.allclose(there.tool_vector_actual[:3], expected[:3], atol=0.003), f"{name} missed its goal")
    else:
        bench.check(np.allclose(there.q_actual, goal, atol=0.01), f"{name} missed its goal: {there.q_actual - goal}")
    bench.check(_rests(bench), "the arm moves after the end of the motion")
    bench.check(done == [handle], f"done callbacks: {done}")
    late: list[Any] = []
    handle.add_done_callback(late.append)
    time.sleep(0.05)
    bench.check(late == [handle], "a callback that was added after the end was not called")
    bench.check(phases[-1] is Phase.DONE and len(set(phases)) == len(phases), f"phases {phases}")
    known = [part for part in parts if part is not None]
    bench.check(all(0.0 <= part <= 1.0 for part in known), f"progress {known}")
    bench.check(all(b >= a - 1e-3 for a, b in itertools.pairwise(known)), f"progress decreases: {known}")
    bench.check(not known or known[-1] > 0.95, f"progress {known[-1:]} at the end")
    bench.check(robot.motion.current is None, "it is the current one after its end")
    if name == "timed":
        bench.check(1.15 < took < 1.7, f"a motion of 1.2 s took {took:.2f} s")


@trial
def ended_motions(bench: Bench) -> None:
    """A cancelled, left or replaced motion brakes and has an error; the next motion reaches its goal."""
    robot, chance = bench.robot, bench.chance
    goal = _goal(bench, 0.5)
    handle = robot.motion.move_joints(goal, speed=0.2)
    time.sleep(0.15 + 0.2 * chance.random())
    how = chance.choice(("cancel", "leave", "replace", "stop", "pendant"))
    done: list[Any] = []
    handle.add_done_callback(done.append)
    if how == "cancel":
        handle.cancel()
        handle.cancel()
    elif how == "leave":
        with contextlib.suppress(ZeroDivisionError), handle:
            raise ZeroDivisionError
    elif how == "stop":
        robot.motion.stop(wait=5.0)
    elif how == "pendant":
        bench.call(bench.controller.pendant.stop)
    if how == "replace":
        other = _goal(bench, 0.1)
        robot.motion.move_joints(other, speed=0.5, wait=10.0)
        bench.check(np.allclose(robot.realtime.wait(2.0).q_actual, other, atol=0.01), "the next one missed its goal")
    with bench.raises(Cancelled if how != "pendant" else LinkError, within=1.0):
        handle.wait(5.0)
    expected = {"pendant": (Phase.FAILED, Phase.CANCELLED)}.get(how, (Phase.CANCELLED,))
    bench.check(handle.phase in expected and handle.error is not None, f"{how}: {handle.phase}, {handle.error!r}")
    _brakes(bench, _RESTS, how)
    bench.check(done == [handle], f"{how}: done callbacks {done}")
    bench.check(not np.allclose(robot.realtime.wait(2.0).q_actual, goal, atol=0.01), f"{how}: it reached its goal")
    again = _goal(bench, 0.1)
    robot.motion.move_joints(again, speed=0.5, wait=True)
    bench.check(np.allclose(robot.realtime.wait(2.0).q_actual, again, atol=0.01), "the next one missed its goal")
    for wrong in ([9.0] * 6, [0.0] * 5, [float("nan")] * 6):
        with bench.raises(BadValue):
            robot.motion.move_joints(wrong)


@trial
def speeds(bench: Bench) -> None:
    """A speed lasts for its duration in its frame, and then the arm is at rest."""
    robot, chance = bench.robot, bench.chance
    axis, sign = chance.randrange(3), chance.choice((-1.0, 1.0))
    duration = chance.choice((0.4, 1.0))
    values = [0.0] * 6
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    is_joints = chance.random() < 0.5
    values[axis] = sign * (0.2 if is_joints else 0.06)
    begun = bench.now
    move = robot.motion.speed_joints if is_joints else robot.motion.speed_linear
    handle = move(values, duration=duration, link=link)
    time.sleep(0.35)
    state = robot.realtime.wait(2.0)
    found = state.qd_actual if is_joints else state.tcp_speed_actual
    bench.check(abs(found[axis] - values[axis]) < 0.4 * abs(values[axis]), f"commanded {values}, it moves at {found}")
    handle.wait(5.0)
    took = bench.now - begun
    bench.check(duration - 0.02 <= took < duration + 1.0, f"{duration} s took {took:.2f} s")
    _brakes(bench, 0.5, "a speed")
    held = robot.motion.speed_joints([0.1, 0, 0, 0, 0, 0], duration=3.0)
    time.sleep(0.4)
    again = robot.motion.speed_joints([-0.1, 0, 0, 0, 0, 0], duration=3.0)
    time.sleep(0.5)
    bench.check(robot.realtime.wait(2.0).qd_actual[0] < -0.05, "another speed does not replace the first one")
    again.cancel()
    held.cancel()
    _brakes(bench, 0.6, "cancel")


@trial
def jogging(bench: Bench) -> None:
    """A jog moves along the axes of its frame until the next speeds or its timeout; leaving the block stops it."""
    robot, chance = bench.robot, bench.chance
    frame = chance.choice(("joints", "base", "tool"))
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    seconds = 0.4 + 0.3 * chance.random()
    robot.motion.move_joints(_READY + 0.2 * np.array([chance.uniform(-1, 1) for _ in range(6)]), wait=True)
    with robot.motion.jog(frame, timeout=seconds, link=link) as jog:
        for _ in range(2):
            axis, sign = chance.randrange(3), chance.choice((-1.0, 1.0))
            values = np.zeros(6)
            values[axis] = sign * (0.2 if frame == "joints" else 0.05)
            jog.move(values)
            time.sleep(0.33)
            state = robot.realtime.wait(2.0)
            if frame == "joints":
                found, wanted = state.qd_actual, values
            else:
                found, wanted = state.tcp_speed_actual[:3], values[:3]
                if frame == "tool":
                    wanted = rotvec_to_matrix(state.tool_vector_actual[3:]) @ wanted
            bench.check(np.linalg.norm(found - wanted) < 0.4 * np.linalg.norm(wanted), f"{frame}: {wanted} is {found}")
            time.sleep(seconds - 0.33 + 0.4)
            bench.check(_rests(bench), f"a speed did not expire after {seconds:.2f} s")
        jog.move(values)
        time.sleep(0.2)
        jog.stop()
        _brakes(bench, 0.4, "jog.stop")
        with bench.raises(BadValue):
            jog.move([99.0] * 6)
        jog.move(values)
        time.sleep(0.1)
    _brakes(bench, 0.6, "a jog was left")
    with bench.raises(LinkError):
        jog.move(values)
    bench.check(jog.done, "it has not ended after its block")


@trial
def servoing(bench: Bench) -> None:
    """The arm follows the set-points, and brakes if none arrives within the watchdog, and after the block."""
    robot, chance = bench.robot, bench.chance
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    kind = chance.choice(("send", "filter", "schedule"))
    watchdog = 0.15 + 0.2 * chance.random()
    how: dict[str, Any] = {"watchdog": watchdog, "link": link}
    if kind == "filter":
        how["target_filter"] = "jerk_limited"
    q = robot.realtime.wait(2.0).q_target
    far = np.array([0.1 * chance.uniform(-1, 1) for _ in range(6)])
    with robot.motion.servo(**how) as servo:
        if kind == "filter":
            servo.send(q + far)
            time.sleep(1.5)
        elif kind == "schedule":
            at = robot.realtime.wait(2.0).time + 0.8
            reached = servo.schedule(q + far, at)
            bench.check(reached is not None and reached >= at - 1e-6, f"scheduled for {at}, reached at {reached}")
            bench.check(servo.schedule(q, at - 5.0) is None, "a time in the past is accepted")
            with bench.raises(LocalError):
                servo.send(q)
            state = robot.realtime.wait_until(lambda state: state.time >= (reached or at) + 0.15, 5.0)
            bench.check(np.allclose(state.q_target, q + far, atol=0.005), "it is not at the target at its time")
            time.sleep(0.3)
        else:
            count = int(0.6 / bench.cycle)
            for step in range(count):
                servo.send(q + far * (step + 1) / count)
                robot.realtime.wait(2.0)
            stats = servo.stats
            bench.check(stats.count == count, f"{count} set-points are counted as {stats}")
            for _ in range(int(0.3 / bench.cycle)):
                servo.send(q + far)
                robot.realtime.wait(2.0)
            with bench.raises(BadValue):
                servo.send(q + 2.0)
        state = robot.realtime.wait(2.0)
        bench.check(np.allclose(state.q_target, q + far, atol=0.01), f"{kind}: {state.q_target - q - far}")
        bench.check(abs(servo.scaling - 1.0) < 0.01, f"scaling {servo.scaling}")
        if kind == "send":
            for step in range(int(0.3 / bench.cycle)):
                servo.send(q + far - 0.3 * step * bench.cycle)
                robot.realtime.wait(2.0)
            # Without further set-points, the robot continues for a moment, and then its watchdog brakes it.
            time.sleep(watchdog + 0.5)
            bench.check(_rests(bench), f"{watchdog + 0.5:.2f} s after the last set-point it moves")
    _brakes(bench, 0.5, "a servo was left")
    with bench.raises(LinkError):
        servo.send(q)


def _points(bench: Bench, q: np.ndarray, begin: float, count: int = 4) -> list[urlink.TrajectoryPoint]:
    return [
        urlink.TrajectoryPoint(
            q + np.array([0.05 * bench.chance.uniform(-1, 1) for _ in range(6)]), begin + 0.4 * (each + 1), [0.0] * 6
        )
        for each in range(count)
    ]


@trial
def a_stream_of_points(bench: Bench) -> None:
    """The arm reaches each point at its time on the stream's clock; cleared or replaced points are not executed."""
    robot, chance = bench.robot, bench.chance
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    q = robot.realtime.wait(2.0).q_target
    with robot.motion.stream(buffer=chance.uniform(0.2, 0.8), link=link) as stream:
        points = _points(bench, q, stream.end)
        room = stream.append(points, wait=chance.choice((True, False, 3.0)))
        bench.check(abs(room - stream.room) < 0.5, f"append returned {room}, but there is room for {stream.room}")
        bench.check(abs(stream.end - points[-1].time) < 1e-6, f"it ends at {stream.end}, not {points[-1].time}")
        for point in [each for each in points[:3] if each.time > stream.time + 0.05]:
            until = bench.now + 5.0
            while stream.time < point.time and bench.now < until:
                robot.realtime.wait(2.0)
            ahead = stream.time - point.time
            state = robot.realtime.wait(2.0)
            bench.check(ahead < 0.1, f"the clock of the stream jumps by {ahead:.3f} s")
            bench.check(np.allclose(state.q_target, point.q, atol=0.03), f"at {point.time}: {state.q_target - point.q}")
            bench.check(stream.buffered >= 0.0 and not stream.is_dry, f"buffered {stream.buffered}")
        stream.wait_until_dry(5.0)
        last = robot.realtime.wait(2.0)
        bench.check(
            stream.is_dry and np.allclose(last.q_target, points[-1].q, atol=0.003), "it is not at the last point"
        )
        time.sleep(0.1)
        bench.check(_rests(bench), "it moves when it is dry")
        how = chance.choice(("clear", "replace", "starve"))
        more = _points(bench, q, stream.end + 0.2)
        stream.append(more, wait=False)
        time.sleep(0.5)
        if how == "clear":
            end = stream.clear()
            bench.check(
                abs(end - stream.end) < 1e-6 and end <= more[-1].time, f"cleared until {end}, ends {stream.end}"
            )
            stream.wait_until_dry(3.0)
            bench.check(bench.now and stream.time < more[-1].time, "a cleared point was executed")
        elif how == "replace":
            since = stream.time + 0.3
            others = [urlink.TrajectoryPoint(q + 0.02, since + 1.0, [0.0] * 6)]
            begins = stream.replace(since, others)
            bench.check(begins >= since - 1e-6, f"replaced from {begins}, requested {since}")
            bench.check(abs(stream.end - others[0].time) < 0.5, f"it ends at {stream.end}, not {others[0].time}")
            stream.wait_until_dry(5.0)
            bench.check(
                np.allclose(robot.realtime.wait(2.0).q_target, q + 0.02, atol=0.003), "it is not at the new point"
            )
        else:
            with bench.raises(LinkTimeout, after=0.2):
                stream.wait_until_dry(0.2)
            starved = stream.starved
            stream.wait_until_dry(5.0)
            bench.check(stream.starved >= starved, f"starved {stream.starved}")
        with bench.raises(BadValue):
            stream.append([urlink.TrajectoryPoint(q + 3.0, stream.end + 0.05, [0.0] * 6)])
        stream.append(_points(bench, robot.realtime.wait(2.0).q_target, stream.end + 0.2), wait=False)
        time.sleep(0.4)
    _brakes(bench, 0.6, "a stream was left")
    with bench.raises(LinkError):
        stream.append(points)


def _paths(q: np.ndarray, seconds: float, far: float) -> urlink.Trajectory:
    times = np.linspace(0.0, seconds, 5)
    shape = 0.5 - 0.5 * np.cos(np.pi * times / seconds)
    ways = q + shape[:, None] * far
    speeds = (0.5 * np.pi / seconds * np.sin(np.pi * times / seconds))[:, None] * np.full((1, 6), far)
    return urlink.Trajectory.from_arrays(times, ways, speeds)


@trial
def a_trajectory(bench: Bench) -> None:
    """A trajectory is followed in its time, scaled by the slider; exceeding the tolerance raises an error."""
    robot, chance = bench.robot, bench.chance
    q = robot.realtime.wait(2.0).q_target
    seconds, far = 1.0, 0.15 * chance.choice((-1, 1))
    path = _paths(q, seconds, far)
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    how: dict[str, Any] = chance.choice(({}, {"low_bandwidth": True}, {"link": link}))
    seen: list[Any] = []
    fraction = chance.choice((1.0, 0.5))
    if fraction < 1.0:
        robot.set_speed_slider(fraction)
    begun = bench.now
    motion = robot.motion.follow(path, feedback=seen.append, **how)
    _, parts = _follows(motion, bench)
    motion.wait(1.0)
    took = bench.now - begun
    bench.check(
        seconds / fraction - 0.05 <= took < seconds / fraction + 1.5, f"{seconds / fraction} s took {took:.2f} s"
    )
    bench.check(np.allclose(robot.realtime.wait(2.0).q_actual, q + far, atol=0.02), "it is not at the end")
    known = [part for part in parts if part is not None]
    bench.check(all(b >= a - 1e-3 for a, b in itertools.pairwise(known)), f"progress decreases: {known}")
    if seen:
        times = [each.trajectory_time for each in seen]
        bench.check(all(b >= a for a, b in itertools.pairwise(times)), "feedback goes backwards in time")
        wrong = max(
            float(np.abs(each.q_desired - path.at(min(each.trajectory_time, seconds))[0]).max()) for each in seen
        )
        bench.check(wrong < 0.01, f"q_desired of the feedback is {wrong:.3f} rad from the trajectory")
        apart = max(float(np.abs(each.q_desired - each.q_actual - each.error).max()) for each in seen)
        bench.check(apart < 1e-6, "the error is not the difference")
    robot.set_speed_slider(1.0)
    with bench.raises(BadValue, LinkError):
        robot.motion.follow(_paths(q + 1.0, seconds, far))
    back = robot.motion.follow(_paths(q + far, 2.0, -far), path_tolerance=1e-4)
    with bench.raises(ToleranceExceeded, within=2.5):
        back.wait(5.0)
    _brakes(bench, 0.6, "its tolerance was exceeded")


@trial
def paused(bench: Bench) -> None:
    """A motion that is paused at the pendant is at rest, and continues to its end when it is played."""
    robot, chance = bench.robot, bench.chance
    q = robot.realtime.wait(2.0).q_target
    goal = q + 0.2 * chance.choice((-1, 1))
    kind = chance.choice(("move", "follow", "path", "stream"))
    pendant = bench.controller.pendant

    def pause(handle: Any) -> None:
        time.sleep(0.5)
        bench.call(pendant.pause)
        time.sleep(0.8)
        bench.check(_rests(bench), "it moves while it is paused")
        bench.check(not handle.done, f"{kind} ended when it was paused: {handle.error!r}")
        bench.call(pendant.play)

    if kind == "stream":
        with robot.motion.stream(buffer=0.5) as stream:
            stream.append([urlink.TrajectoryPoint(goal, stream.end + 2.0, [0.0] * 6)], wait=False)
            pause(stream)
            stream.wait_until_dry(8.0)
            bench.check(np.allclose(robot.realtime.wait(2.0).q_target, goal, atol=0.01), "it is not at its end")
        return
    handle = {
        "move": lambda: robot.motion.move_joints(goal, speed=0.12),
        "follow": lambda: robot.motion.follow(_paths(q, 2.0, float(goal[0] - q[0]))),
        "path": lambda: robot.motion.path([urlink.Joint((q + goal) / 2), urlink.Joint(goal)], joint_speed=0.12),
    }[kind]()
    pause(handle)
    handle.wait(15.0)
    bench.check(np.allclose(robot.realtime.wait(2.0).q_actual, goal, atol=0.02), f"{kind} is not at its end")


@trial
def soft(bench: Bench) -> None:
    """Force mode, freedrive and impedance end after their block, and report their settings."""
    robot, chance = bench.robot, bench.chance
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    kind = chance.choice(("force", "freedrive", "impedance", "torque"))
    if kind in ("impedance", "torque") and bench.controller.firmware.major < 10:
        with bench.raises(LinkError), robot.motion.torque():
            pass
        kind = "force"
    if bench.controller.firmware.major >= 3:
        _zero_force(robot)
    if kind == "force":
        wrench = [0.0, 0.0, -10.0 * chance.random(), 0.0, 0.0, 0.0]
        frame = chance.choice(("base", "tool"))
        with robot.motion.force_mode(frame, [0, 0, 1, 0, 0, 0], wrench, [0.05] * 6, link=link) as block:
            bench.check(np.allclose(block.wrench, wrench), f"{wrench} is shown as {block.wrench}")
            time.sleep(0.3)
            block.set_wrench([0.0] * 6)
            bench.check(np.allclose(block.wrench, 0.0), f"{block.wrench}")
            time.sleep(0.2)
    elif kind == "freedrive":
        with robot.freedrive(link=link) as block:
            time.sleep(0.4)
    elif kind == "torque":
        with robot.motion.torque(link=link) as block:
            for _ in range(40):
                block.send([0.0] * 6)
                robot.realtime.wait(2.0)
    else:
        q = robot.realtime.wait(2.0).q_actual
        frame = chance.choice(("joints", "base", "tool"))
        with robot.motion.impedance(frame, link=link) as block:
            if frame == "joints":
                block.send(q + 0.02)
                time.sleep(0.2)
                bench.check(block.target is not None and np.allclose(block.target, q + 0.02), f"{block.target}")
            gains = chance.uniform(100.0, 300.0)
            block.set_gains(gains, 0.8)
            bench.check(np.allclose(block.stiffness, gains) and np.allclose(block.damping, 0.8), f"{block.stiffness}")
            with bench.raises(BadValue):
                block.set_gains(-1.0)
            time.sleep(0.3)
    bench.check(block.done, f"{block.phase} after the block")
    _brakes(bench, 0.6, f"{kind} was left")
    time.sleep(0.3)
    bench.check(not bench.controller.is_running_program, "its program keeps running")
    goal = _goal(bench, 0.05)
    robot.motion.move_joints(goal, wait=True)
    bench.check(np.allclose(robot.realtime.wait(2.0).q_actual, goal, atol=0.01), "the next motion missed its goal")


@trial
def teaching(bench: Bench) -> None:
    """Points are recorded at the arm's position, once for each call and input edge; loaded points are the same."""
    robot, chance = bench.robot, bench.chance
    signals = bench.controller.signals
    signals.digital_inputs &= ~0b1111
    number = chance.randrange(4)
    reported: list[Any] = []
    with robot.teach(digital_input=number, on_point=reported.append) as taught:
        time.sleep(0.2)
        for _ in range(2):
            signals.digital_inputs |= 1 << number
            time.sleep(0.3)
            signals.digital_inputs &= ~(1 << number)
            time.sleep(0.3)
        if hasattr(taught, "record"):
            taught.record()
        points = list(getattr(taught, "taught", taught)) if hasattr(taught, "__iter__") else reported
    bench.check(len(reported) in (2, 3), f"on_point was called {len(reported)} times for two edges")
    q = robot.realtime.wait(2.0).q_actual
    bench.check(all(np.allclose(point.q, q, atol=0.02) for point in points), "a point is elsewhere")
    count = len(reported)
    signals.digital_inputs |= 1 << number
    time.sleep(0.3)
    bench.check(len(reported) == count, "a point is recorded after the block")
    made = Taught([TaughtPoint(q + far, np.array([0.1, 0.2, far, 0.0, 3.0, 0.0])) for far in (0.05, 0.0)])
    with tempfile.TemporaryDirectory() as folder:
        made.save(Path(folder) / "points.json")
        loaded = Taught.load(Path(folder) / "points.json")
        path = _paths(q, 1.0, 0.1)
        path.to_csv(Path(folder) / "path.csv")
        again = urlink.Trajectory.from_csv(Path(folder) / "path.csv")
    bench.check(len(loaded) == 2, f"{len(loaded)} points were loaded")
    for one, other in zip(made, loaded, strict=True):
        bench.check(np.allclose(one.q, other.q) and np.allclose(one.pose, other.pose), f"{one} was loaded as {other}")
    for at in (0.0, 0.33, 1.0):
        bench.check(
            np.allclose(path.at(at)[0], again.at(at)[0], atol=1e-6), "the loaded trajectory has other positions"
        )
        bench.check(np.allclose(path.at(at)[1], again.at(at)[1], atol=1e-5), "the loaded trajectory has other speeds")
    slow = path.retimed(0.5, 1.0)
    bench.check(np.allclose(slow.at(slow.duration)[0], path.at(1.0)[0], atol=1e-3), "the retimed one ends elsewhere")
    moments = np.linspace(0.0, slow.duration, 50)
    bench.check(
        np.abs(slow.at(moments)[1]).max() < 0.55,
        f"the retimed one has {np.abs(slow.at(moments)[1]).max():.2f} rad/s",
    )
    loaded.play(robot).wait(10.0)
    bench.check(np.allclose(robot.realtime.wait(2.0).q_actual, q, atol=0.01), "play does not end at the last point")


@trial
def contact(bench: Bench) -> None:
    """Without contact, `until_contact` ends after its distance with `NoContact`."""
    robot = bench.robot
    distance = 0.02 + 0.03 * bench.chance.random()
    begin = robot.realtime.wait(2.0).tool_vector_actual
    motion = robot.motion.until_contact([0, 0, -1], 0.05, distance=distance)
    try:
        motion.wait(10.0)
    except NoContact:
        pass
    except LinkError as error:
        bench.check(False, f"it ended with {error!r}")
    _brakes(bench, 0.6, "the end of until_contact")
    moved = begin[2] - robot.realtime.wait(2.0).tool_vector_actual[2]
    bench.check(-0.005 < moved < distance + 0.02, f"distance {distance:.3f} m, but it has moved {moved:.3f} m")


@contextlib.contextmanager
def second_controller(bench: Bench) -> Iterator[Controller]:
    """Run the controller of another arm, on its own computer."""
    computer = bench.sim.computer("robot2", "192.168.0.101")
    computer.rate += bench.chance.uniform(-1e-4, 1e-4)
    with bench.sim.on(computer):
        firmware = str(bench.controller.firmware)
        arm = "UR5e" if bench.controller.firmware.is_e_series else "UR5"
        controller = Controller(arm, firmware, host="192.168.0.101", ports="standard").start()
    try:
        yield controller
    finally:
        with bench.sim.on(computer):
            controller.close()


@trial
def a_group(bench: Bench) -> None:
    """Arms of a group start, end and stop together, and their states belong to the same moment."""
    chance = bench.chance
    with second_controller(bench) as controller, urlink.connect(controller.host, timeout=3.0) as other:
        both = urlink.Group(bench.robot, other)
        goals = [robot.realtime.wait(2.0).q_target + chance.uniform(0.1, 0.2) for robot in both.robots]
        moves: list[list[float]] = [[], []]
        for robot, seen in zip(both.robots, moves, strict=True):

            def note(state: Any, seen: list[float] = seen) -> None:
                if np.abs(state.qd_target).max() > 1e-3:
                    seen.append(bench.now)

            robot.realtime.subscribe(note, inline=True)
        begun = bench.now
        motion = both.move_joints(goals, time=1.0)
        motion.wait(8.0)
        took = bench.now - begun
        bench.check(0.95 < took < 2.0, f"a motion of 1 s took {took:.2f} s")
        bench.check(abs(moves[0][0] - moves[1][0]) < 0.02, f"they begin {abs(moves[0][0] - moves[1][0]):.3f} s apart")
        bench.check(abs(moves[0][-1] - moves[1][-1]) < 0.05, f"they end {abs(moves[0][-1] - moves[1][-1]):.3f} s apart")
        for robot, goal in zip(both.robots, goals, strict=True):
            bench.check(
                np.allclose(robot.realtime.wait(2.0).q_actual, goal, atol=0.01), f"{robot.address} missed its goal"
            )
        for count, states in enumerate(both.states(2.0)):
            local = [robot.clock.to_local(state.time) for robot, state in zip(both.robots, states, strict=True)]
            bench.check(abs(local[0] - local[1]) < bench.cycle + 2e-3, f"states {abs(local[0] - local[1]):.4f} s apart")
            if count == 5:
                break
        how = chance.choice(("cancel", "stop", "fault", "stream", "one", "pause"))
        if how == "stream":
            _stream_of_both(bench, both, goals)
            return
        back = [goal - 0.3 for goal in goals]
        motion = both.move_joints(back, time=3.0)
        time.sleep(0.8)
        if how == "pause":
            bench.call(bench.controller.pendant.pause)
            time.sleep(0.8)
            bench.check(_rests(bench) and _rests(bench, other), "an arm moves while the other is paused")
            bench.call(bench.controller.pendant.play)
            motion.wait(10.0)
            for robot, goal in zip(both.robots, back, strict=True):
                bench.check(np.allclose(robot.realtime.wait(2.0).q_actual, goal, atol=0.02), "an arm missed its goal")
            return
        if how == "cancel":
            motion.cancel()
        elif how == "stop":
            both.stop(wait=5.0)
        elif how == "one":
            other.motion.stop()
        else:
            controller.faults.protective_stop()
        with bench.raises(LinkError, within=1.0):
            motion.wait(5.0)
        time.sleep(_RESTS)
        bench.check(_rests(bench) and _rests(bench, other), f"an arm moves after {how}")
        bench.check(all(robot.motion.current is None for robot in both.robots), f"{how}: a motion is still current")
        with bench.raises(BadValue):
            both.move_joints(goals[:1])


def _stream_of_both(bench: Bench, both: urlink.Group, starts: list[Any]) -> None:
    with both.stream(buffer=0.4) as stream:
        begin = stream.end

        def points(far: float, at: float) -> list[Any]:
            return [[urlink.TrajectoryPoint(q + far, at, [0.0] * 6)] for q in starts]

        stream.append(points(0.05, begin + 0.8))
        stream.append(points(-0.05, begin + 1.8), wait=False)
        bench.check(abs(stream.end - begin - 1.8) < 1e-6, f"it ends at {stream.end}")
        stream.wait_until_dry(8.0)
        for robot, q in zip(both.robots, starts, strict=True):
            bench.check(np.allclose(robot.realtime.wait(2.0).q_target, q - 0.05, atol=0.005), "an arm missed its point")
        bench.check(stream.is_dry, "it is not dry")
        stream.append(points(0.1, stream.end + 2.0), wait=False)
        time.sleep(0.5)
        if bench.chance.random() < 0.5:
            since = stream.time + 0.4
            stream.replace(since, points(0.0, since + 1.0))
            stream.wait_until_dry(8.0)
            for robot, q in zip(both.robots, starts, strict=True):
                bench.check(
                    np.allclose(robot.realtime.wait(2.0).q_target, q, atol=0.005), "one is not at the new point"
                )
        else:
            stream.clear()
            stream.wait_until_dry(5.0)
        # The arm lags behind the last point by up to a tenth of a second.
        time.sleep(0.4)
        bench.check(all(_rests(bench, robot) for robot in both.robots), "an arm moves when the stream is dry")
        stream.append(points(0.1, stream.end + 2.0), wait=False)
        time.sleep(0.5)
    time.sleep(0.8)
    bench.check(all(_rests(bench, robot) for robot in both.robots), "an arm moves after the block")


@trial
def a_lost_program(bench: Bench) -> None:
    """A block whose program is stopped ends with an error, and the arm brakes."""
    robot, chance = bench.robot, bench.chance
    q = robot.realtime.wait(2.0).q_target
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    kind = chance.choice(("servo", "jog", "stream", "held", "force"))
    with contextlib.ExitStack() as stack:
        if kind == "servo":
            block = stack.enter_context(robot.motion.servo(watchdog=0.3, link=link))
            block.send(q)
        elif kind == "jog":
            block = stack.enter_context(robot.motion.jog("joints", timeout=5.0, link=link))
            block.move([0.1] * 6)
        elif kind == "stream":
            block = stack.enter_context(robot.motion.stream(buffer=0.5, watchdog=0.3, link=link))
            block.append([urlink.TrajectoryPoint(q + 0.1, block.end + 3.0, [0.0] * 6)], wait=False)
        elif kind == "force":
            _zero_force(robot)
            block = stack.enter_context(
                robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0.0] * 6, [0.05] * 6, link=link)
            )
        else:
            block = robot.motion.speed_joints([0.1] * 6, duration=8.0, link=link)
        time.sleep(0.3)
        is_stopped = chance.random() < 0.5
        if is_stopped:
            bench.call(bench.controller.pendant.stop)
        else:
            bench.reset()
        if is_stopped:
            with bench.raises(LinkError, within=1.5):
                block.wait(5.0)
            bench.check(block.done and block.phase is Phase.FAILED, f"{kind}: {block.phase}")
            _brakes(bench, 0.8, "its program was stopped")
        else:
            time.sleep(2.5)
        block.cancel()
    time.sleep(0.8)
    robot.safety.wait_until_clear(5.0)
    bench.check(_rests(bench), "it moves after the block")
    robot.motion.move_joints(q, wait=10.0)


@trial
def watchdogs(bench: Bench) -> None:
    """The robot brakes on its own when no message arrives within the watchdog, even if this process is suspended."""
    robot, chance = bench.robot, bench.chance
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    watchdog = 0.15 + 0.2 * chance.random()
    kind = chance.choice(("servo", "filter", "jog", "held", "follow"))
    seconds = watchdog + 2.5
    speeds: list[float] = []

    def look() -> None:
        speeds.append(max(map(abs, bench.controller.arm.setpoint.qd)))

    def hold() -> None:
        at = bench.now
        bench.sim.at(at + 0.3, look)
        bench.sim.at(at + 0.3, bench.here.suspend)
        bench.sim.at(at + 0.3 + (0.5 if kind == "held" else watchdog) + 1.2, look)
        bench.sim.at(at + 0.3 + seconds, bench.here.resume)

    q = robot.realtime.wait(2.0).q_target
    with contextlib.suppress(LinkError):
        if kind == "held":
            motion = robot.motion.speed_joints([0.1, 0, 0, 0, 0, 0], duration=8.0, link=link)
            hold()
            time.sleep(seconds + 0.5)
            motion.cancel()
        elif kind == "jog":
            with robot.motion.jog("joints", timeout=9.0, watchdog=watchdog, link=link) as jog:
                jog.move([0.1, 0, 0, 0, 0, 0])
                hold()
                time.sleep(seconds + 0.5)
        elif kind == "follow":
            path = _paths(q, 6.0, 0.5)
            motion = robot.motion.follow(path, watchdog=watchdog, link=link)
            hold()
            time.sleep(seconds + 0.5)
            motion.cancel()
        else:
            target = "jerk_limited" if kind == "filter" else None
            with (
                robot.motion.servo(target_filter=target, watchdog=watchdog, speed=0.1, link=link)
                if target
                else (robot.motion.servo(watchdog=watchdog, link=link)) as servo
            ):
                hold()
                begun = bench.now
                if target:
                    servo.send(q + 1.0)
                while bench.now < begun + seconds + 0.5:
                    if target is None:
                        servo.send(q + 0.1 * (bench.now - begun))
                    robot.realtime.wait(2.0)
    bench.check(len(speeds) == 2, f"{speeds}")
    bench.check(
        speeds[-1] < 0.02, f"{kind}: it moves at {speeds[-1]:.3f} rad/s long after its watchdog of {watchdog:.2f} s"
    )
    time.sleep(1.0)
    time.sleep(4.0)  # the robot object may have to reconnect
    robot.safety.wait_until_clear(10.0)
    bench.check(_rests(bench), "it moves after the block")
    robot.motion.move_joints(q, wait=True)


@trial
def changes_of_a_stream(bench: Bench) -> None:
    """After any append, replace, clear or pause, the arm ends at the last point; the clock never goes backwards."""
    robot, chance = bench.robot, bench.chance
    link = chance.choice(("reverse", "rtde")) if bench.controller.firmware.major >= 3 else "reverse"
    q = robot.realtime.wait(2.0).q_target
    with robot.motion.stream(buffer=chance.uniform(0.2, 0.8), link=link) as stream:
        last: Any = None
        clock = 0.0
        for _ in range(6):
            what = chance.choice(("append", "append", "replace", "clear", "pause", "slow", "rest"))
            far = np.array([0.04 * chance.uniform(-1, 1) for _ in range(6)])
            if what == "append" or last is None:
                last = q + far
                begin = max(stream.end, stream.time) + 0.3
                points = [urlink.TrajectoryPoint(last, begin + 0.6, [0.0] * 6)]
                if chance.random() < 0.5:
                    points.insert(0, urlink.TrajectoryPoint(q + far / 2, begin + 0.2, [0.0] * 6))
                stream.append(points, wait=chance.choice((False, 5.0)))
            elif what == "replace":
                since = stream.time + chance.uniform(0.2, 0.5)
                with contextlib.suppress(BadValue):
                    stream.replace(since, [urlink.TrajectoryPoint(q + far, since + 1.0, [0.0] * 6)])
                    last = q + far
                    bench.check(stream.end >= since, f"replaced from {since}, but it ends at {stream.end}")
            elif what == "clear":
                stream.clear()
                stream.wait_until_dry(5.0)
                last = robot.realtime.wait(2.0).q_target
            elif what == "pause":
                bench.call(bench.controller.pendant.pause)
                time.sleep(0.4)
                bench.call(bench.controller.pendant.play)
            elif what == "slow":
                robot.set_speed_slider(chance.choice((0.5, 1.0)))
            time.sleep(chance.uniform(0.0, 0.6))
            now = stream.time
            bench.check(now >= clock - 1e-6, f"the clock of the stream went backwards from {clock:.3f} to {now:.3f}")
            clock = now
        stream.wait_until_dry(15.0)
        time.sleep(0.1)
        state = robot.realtime.wait(2.0)
        bench.check(
            np.allclose(state.q_target, last, atol=0.005), f"it ends {state.q_target - last} from the last point"
        )
        bench.check(stream.is_dry and _rests(bench), "it is not dry")
    robot.set_speed_slider(1.0)
