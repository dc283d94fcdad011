"""Comparison of a recording with the simulator, which runs the same motions.

A recording of states does not contain the commands. Therefore each movement between two rests is run as a command that
fits the movement: a `movej` or a `movel` between the two postures, with the acceleration and speed of the recorded
targets. If neither fits, for example because of blends or set-points, the movement is counted but not run.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from urlink.simulator import Controller, Still
from urlink.tools import ArmFile, FloatArray, Progress, unseen

from .samples import COLUMNS, Samples

#: Maximum deviation of the targets, in rad, with which a command fits a movement.
_SAME = 0.1
#: Compared quantities, with their units.
QUANTITIES = {"target_q": "rad", "target_moment": "Nm", "target_current": "A", "actual_q": "rad", "actual_current": "A"}


@dataclass(frozen=True)
class Movement:
    """One movement of a recording.

    Attributes:
        begin: Last row of the rest before the movement.
        command: Line of URScript that the simulator ran; "" if no command fits.
        late: Additional time of the simulator in s; nan if no command fits.
    """

    begin: int
    command: str
    late: float


@dataclass(frozen=True)
class Disagreement:
    """Differences between a recording and the simulator.

    Attributes:
        movements: All movements of the recording.
        rms: Root mean square of the difference of each quantity, by joint, shape (6,), over all movements that were
            run. The keys are the names of the quantities.
    """

    movements: tuple[Movement, ...]
    rms: dict[str, tuple[float, ...]]


def compare(samples: Samples, like: ArmFile, progress: Progress = unseen) -> Disagreement:
    """Run each movement of a recording on a simulated arm.

    Args:
        samples: Samples of the recording.
        like: Arm from `identify`, or from its file. An `ArmFile(model, {})` is the arm of the model.
        progress: Function that is called with the completed fraction of the recording, 0 to 1.
    """
    movements = []
    left: dict[str, list[FloatArray]] = defaultdict(list)
    for begin, end in _movements(samples):
        progress(begin / len(samples["timestamp"]))
        movement, differences = _run(samples, like, begin, end)
        movements.append(movement)
        for name, difference in differences.items():
            left[name].append(difference)
    rms = {name: tuple(np.sqrt((np.concatenate(parts) ** 2).mean(axis=0)).tolist()) for name, parts in left.items()}
    return Disagreement(tuple(movements), rms)


def _movements(samples: Samples) -> Iterator[tuple[int, int]]:
    """Yield the last row of each rest, and the first row of the next rest."""
    rest = samples.is_rest
    for begin in np.flatnonzero(rest[:-1] & ~rest[1:]).tolist():
        after = np.flatnonzero(rest[begin + 1 :])
        if len(after):
            yield begin, begin + 1 + int(after[0])


def _run(samples: Samples, like: ArmFile, begin: int, end: int) -> tuple[Movement, dict[str, FloatArray]]:
    """Run a movement, and return it with the differences of all quantities in its rows.

    The differences are empty if no command fits the movement.
    """
    best = _SAME
    found: tuple[Movement, dict[str, FloatArray]] = (Movement(begin, "", math.nan), {})
    q, times = samples["target_q"], samples["timestamp"]
    lead = int(np.argmax(np.abs(q[end] - q[begin])))
    way = math.copysign(1.0, q[end, lead] - q[begin, lead])
    rows = np.arange(begin + 1, end)
    rows = rows[np.abs(samples["target_qd"][rows, lead]) > 0.02 * np.abs(samples["target_qd"][rows, lead]).max()]
    if len(rows) < 4:
        return found
    for command in _commands(samples, like, begin, end, lead):
        controller = Controller(motion=Still(q[begin].tolist()), like=like, noise=False)
        controller.take(f"def p():\n  {command}\nend\n")
        cycles = round((times[end] - times[begin]) * controller.firmware.rate) + controller.firmware.rate // 2
        shown: dict[str, list[list[float]]] = {name: [] for name in QUANTITIES}
        speeds = []
        for _ in range(cycles):
            controller.step()
            speeds.append(controller.arm.setpoint.qd[lead])
            for name, values in shown.items():
                values.append(list(getattr(controller.arm.sample, COLUMNS[name])))
        moving = np.flatnonzero(speeds)
        if not len(moving):
            continue
        span = np.arange(moving[0], moving[-1] + 1)
        columns = {name: np.array(each) for name, each in shown.items()}
        # Index of the simulated cycle in which the leading joint is at its recorded position, for each row.
        reached = np.interp(way * q[rows, lead], way * columns["target_q"][span, lead], span)
        at = np.clip(np.round(reached).astype(int), moving[0], moving[-1])
        late = (reached - reached[0]) / controller.firmware.rate - (times[rows] - times[rows[0]])
        # A time difference counts as the distance that the joints move in this time.
        apart = np.abs(columns["target_q"][at] - q[rows]).max()
        off = float(max(apart, np.abs(late).max() * np.abs(samples["target_qd"][rows, lead]).max()))
        if off < best:
            differences = {name: each[at] - samples[name][rows] for name, each in columns.items() if name in samples}
            best, found = off, (Movement(begin, command, float(late[-1])), differences)
        if best < 0.001 * _SAME:
            break
    return found


def _commands(samples: Samples, like: ArmFile, begin: int, end: int, lead: int) -> Iterator[str]:
    """Yield the possible commands, the most likely first."""
    q, qd, qdd = (samples[f"target_{name}"] for name in ("q", "qd", "qdd"))
    speed = float(np.abs(qd[begin:end, lead]).max())
    # Use the median of the accelerations. The accelerations of the ramp are smaller or larger, but there are only a
    # few.
    pushes = np.abs(qdd[begin + 1 : end, lead])
    push = float(np.median(pushes[pushes > 0.3 * pushes.max()]))
    # A movement without a constant speed does not show its maximum speed.
    for most in (2.0 * speed, speed):
        yield f"movej({q[end].tolist()}, a={push!r}, v={most!r})"
    if like.tcp is not None and "target_TCP_pose" in samples:
        place = samples["target_TCP_pose"][begin : end + 1]
        steps = np.linalg.norm(np.diff(place[:, :3], axis=0), axis=1) / np.diff(samples["timestamp"][begin : end + 1])
        changes = np.abs(np.diff(steps)) / np.diff(samples["timestamp"][begin:end])
        if changes.max() > 0.0:
            hard = float(np.median(changes[changes > 0.3 * changes.max()]))
            yield f"movel(p{place[-1].tolist()}, a={hard!r}, v={2.0 * float(steps.max())!r})"
