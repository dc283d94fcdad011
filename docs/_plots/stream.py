"""A stream that runs dry, continues, and is replaced: position, speed and acceleration of the joint."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

import urlink
from urlink import TrajectoryPoint

SIZE = (8.0, 4.6)
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])
WAY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def wave(t: float, offset: float = 0.0) -> TrajectoryPoint:
    """Return a point on a wave of wrist 3, with an offset in rad."""
    c, s = math.cos(2.0 * t), math.sin(2.0 * t)
    q, qd, qdd = 0.1 * (1 - c) ** 2, 0.4 * (1 - c) * s, 0.8 * (s * s + (1 - c) * c)
    return TrajectoryPoint(READY + (q + offset) * WAY, t, qd * WAY, qdd * WAY)


def draw(figure: Figure) -> str:
    """Plot positions, speeds and accelerations of wrist 3 over time, and the points."""
    rows: list[tuple[float, float, float]] = []
    marks: dict[str, float] = {}
    given: list[tuple[float, float]] = []
    with urlink.simulated_time(seed=1), urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.motion.move_joints(READY, 2.0, 10.0).wait()

        def now() -> float:
            return float(robot.realtime.wait().time)

        with (
            robot.realtime.subscribe(
                lambda state: rows.append((state.time, float(state.q_target[5]), float(state.qd_target[5]))),
                inline=True,
            ),
            robot.motion.stream() as stream,
        ):
            begun = now()
            first = [wave(0.05 * step) for step in range(1, 25)]
            stream.append(first)
            robot.realtime.wait_until(lambda state: stream.time > 0.9, 20.0)
            begin = now() - stream.time
            stream.wait_until_dry()
            marks["dry"] = begin + first[-1].time
            later = now()
            second = [wave(0.05 * step) for step in range(25, 75)]
            stream.append(second, wait=False)
            marks["next points"] = later
            robot.realtime.wait_until(lambda state: stream.time > 2.4, 20.0)
            looked = stream.time
            marks["replaced"] = now()
            third = [wave(looked + 0.05 * step, 0.1) for step in range(40)]
            stream.replace(looked, third)
            stream.wait_until_dry()
            given += [(begin + point.time, float(point.q[5])) for point in first]
            delay = marks["replaced"] - looked
            given += [(delay + point.time, float(point.q[5])) for point in (*second[:24], *third)]
    time, q, qd = np.array(rows[:-10]).T
    time, shown = time - begun, time >= begun
    qdd = np.gradient(qd, time)
    position, speed, acceleration = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 2))
    position.plot(time[shown], q[shown], color="#2b6cb0")
    position.plot(*(np.array(given) - [begun, 0.0]).T, ".", color="#c05621", markersize=3, label="points")
    speed.plot(time[shown], qd[shown], color="#2b6cb0")
    acceleration.plot(time[shown], qdd[shown], color="#2b6cb0")
    for axes, label in ((position, "wrist 3, rad"), (speed, "rad/s"), (acceleration, "rad/s²")):
        axes.set_ylabel(label)
        for at in marks.values():
            axes.axvline(at - begun, color="0.7", linestyle=":", linewidth=0.8)
    for name, at in marks.items():
        position.annotate(name, (at - begun, 0.98), xycoords=("data", "axes fraction"), va="top", fontsize=8)
    position.legend(loc="lower right")
    acceleration.set_xlabel("controller time, s")
    return (
        "A stream on a simulated UR5e. It runs dry at 1.2 s, brakes, and continues when the next points arrive. "
        "Then a chunk that is 0.1 rad off replaces the rest, from a time in the past."
    )
