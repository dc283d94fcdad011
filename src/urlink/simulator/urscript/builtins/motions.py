"""Functions that move the arm. These functions take time, and only one thread at a time may move the arm.

The defaults of `a` and `v` are known for `movej` and `movel`. For the other functions, the defaults are assumed. It is
also assumed that `servoj` without a time takes one cycle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..errors import Fault, type_error
from ..machine import ScriptThread, Waiting
from ..values import NUMBERS, type_name
from .declaration import declare, integer, is_list, joints, number, number_within, pose, six
from .poses import solution


def _positive(value: Any, what: str) -> float:
    x = float(number(value, what))
    if x <= 0:
        raise Fault(f"{what} is {x:g}; expected a number above 0")
    return x


def _not_negative(value: Any, what: str) -> float:
    x = float(number(value, what))
    if x < 0:
        raise Fault(f"{what} is {x:g}; expected 0 or more")
    return x


def _joints(thread: ScriptThread, target: Any, what: str) -> list[float]:
    """Return joint positions. A pose is converted to the joint positions that are closest to the current target."""
    if is_list(target):
        return joints(target, what)
    found = solution(thread, pose(target, what))
    if found is None:
        raise Fault(f"{what}: unable to find an inverse kinematics solution")
    return found


def _pose(thread: ScriptThread, target: Any, what: str) -> Sequence[float]:
    """Return a pose. Joint positions are converted to the pose of the TCP."""
    if is_list(target):
        arm = thread.world.kinematics
        return arm.forward(joints(target, what), list(thread.world.tcp)).tolist()  # type: ignore[no-any-return]
    return pose(target, what)


@declare(takes_time=True, in_secondary=False)
def movej(thread: ScriptThread, q: Any, a: Any = 1.4, v: Any = 1.05, t: Any = 0, r: Any = 0) -> Waiting:
    target = _joints(thread, q, "movej: q")
    figures = _path("movej", a, v, t, r)
    return thread.machine.moving(thread, lambda: thread.world.motion.movej(target, *figures))


@declare(takes_time=True, in_secondary=False)
def movel(thread: ScriptThread, pose: Any, a: Any = 1.2, v: Any = 0.25, t: Any = 0, r: Any = 0) -> Waiting:
    target = _pose(thread, pose, "movel: pose")
    figures = _path("movel", a, v, t, r)
    return thread.machine.moving(thread, lambda: thread.world.motion.movel(target, *figures))


@declare(takes_time=True, in_secondary=False)
def movep(thread: ScriptThread, pose: Any, a: Any = 1.2, v: Any = 0.25, r: Any = 0) -> Waiting:
    target = _pose(thread, pose, "movep: pose")
    acceleration, speed, _, blend = _path("movep", a, v, 0, r)
    return thread.machine.moving(thread, lambda: thread.world.motion.movep(target, acceleration, speed, blend))


@declare(takes_time=True, in_secondary=False)
def movec(
    thread: ScriptThread, pose_via: Any, pose_to: Any, a: Any = 1.2, v: Any = 0.25, r: Any = 0, mode: Any = 0
) -> Waiting:
    via, to = _pose(thread, pose_via, "movec: pose_via"), _pose(thread, pose_to, "movec: pose_to")
    acceleration, speed, _, blend = _path("movec", a, v, 0, r)
    way = integer(mode, "movec: mode", 0, 1)
    return thread.machine.moving(thread, lambda: thread.world.motion.movec(via, to, acceleration, speed, blend, way))


@declare(takes_time=True, in_secondary=False, since="5.22/10.8")
def optimovej(thread: ScriptThread, q: Any, a: Any = 0.3, v: Any = 0.3, r: Any = 0) -> Waiting:
    """Move like `movej`; `a` and `v` are fractions of the lowest limits of all joints.

    The simulator does not search for the fastest motion, as a real controller does.
    """
    model = thread.world.kinematics.model
    target = _joints(thread, q, "optimovej: q")
    acceleration = _fraction(a, "optimovej: a") * float(model.max_acceleration.min())
    speed, blend = _fraction(v, "optimovej: v") * float(model.max_speed.min()), _not_negative(r, "optimovej: r")
    return thread.machine.moving(thread, lambda: thread.world.motion.movej(target, acceleration, speed, 0.0, blend))


@declare(takes_time=True, in_secondary=False, since="5.22/10.8")
def optimovel(thread: ScriptThread, pose: Any, a: Any = 0.3, v: Any = 0.3, r: Any = 0) -> Waiting:
    """Move like `movel`; `v` and `a` are fractions of 1 m/s and 2 m/s².

    Speed and acceleration are lowered so that no joint exceeds its limits on the path. The reference values of a real
    controller are unknown.
    """
    target = _pose(thread, pose, "optimovel: pose")
    acceleration, speed = 2.0 * _fraction(a, "optimovel: a"), _fraction(v, "optimovel: v")
    blend = _not_negative(r, "optimovel: r")
    return thread.machine.moving(thread, lambda: thread.world.motion.optimovel(target, acceleration, speed, blend))


def _fraction(value: Any, what: str) -> float:
    """Return a fraction above 0 and up to 1. This range and the default values are assumed."""
    part = _positive(value, what)
    if part > 1.0:
        raise Fault(f"{what} is {part:g}; expected at most 1")
    return part


def _path(name: str, a: Any, v: Any, t: Any, r: Any) -> tuple[float, float, float, float]:
    """Return the acceleration, the speed, the time and the blend radius of a path move.

    If a time is given, acceleration and speed are ignored, and can be zero (assumed).
    """
    seconds, blend = _not_negative(t, f"{name}: t"), _not_negative(r, f"{name}: r")
    if seconds > 0:
        return _not_negative(a, f"{name}: a") or 1.0, _not_negative(v, f"{name}: v") or 1.0, seconds, blend
    return _positive(a, f"{name}: a"), _positive(v, f"{name}: v"), seconds, blend


@declare(takes_time=True, in_secondary=False, until="3.0")
def servoj(thread: ScriptThread, q: Any, a: Any = 3, v: Any = 0.75, t: Any = 0) -> Waiting:
    """Follow a set-point on CB2, which has no look-ahead time and no gain. Zeros are passed for them."""
    return _servoj(thread, q, a, v, t, 0.0, 0.0)


@declare(name="servoj", takes_time=True, in_secondary=False, since="3.0")
def servoj_with_gain(
    thread: ScriptThread, q: Any, a: Any = 0, v: Any = 0, t: Any = 0, lookahead_time: Any = 0.1, gain: Any = 300
) -> Waiting:
    """Follow a set-point of the joints.

    The ranges of the last two arguments are from the manuals (cited from memory).
    """
    ahead = number_within(lookahead_time, "servoj: lookahead_time", 0.03, 0.2)
    stiffness = number_within(gain, "servoj: gain", 100, 2000)
    return _servoj(thread, q, a, v, t, ahead, stiffness)


def _servoj(thread: ScriptThread, q: Any, a: Any, v: Any, t: Any, ahead: float, stiffness: float) -> Waiting:
    target = joints(q, "servoj: q")
    # These two arguments have no other effect. A real controller ignores them too.
    number(a, "servoj: a")
    number(v, "servoj: v")
    seconds = _not_negative(t, "servoj: t") or thread.world.period
    return thread.machine.moving(thread, lambda: thread.world.motion.servoj(target, seconds, ahead, stiffness))


@declare(takes_time=True, in_secondary=False)
def servoc(thread: ScriptThread, pose: Any, a: Any = 1.2, v: Any = 0.25, r: Any = 0) -> Waiting:
    target = _pose(thread, pose, "servoc: pose")
    acceleration, speed, _, blend = _path("servoc", a, v, 0, r)
    return thread.machine.moving(thread, lambda: thread.world.motion.servoc(target, acceleration, speed, blend))


def _change(a: Any, what: str) -> float:
    """Return an acceleration of at least 1e-6.

    Zero must be accepted, because a driver passes zero if the speed does not change.
    """
    return max(_not_negative(a, what), 1e-6)


def _seconds(t: Any, what: str) -> float | None:
    """Return the duration of a speed command in s; None if it is not limited.

    Firmware before 3.3 requires this argument (1.x) or does not have it (3.1, 3.2). In the simulator, it is always
    optional.
    """
    return None if t is None or (t.__class__ in NUMBERS and t == 0) else _not_negative(t, what)


@declare(takes_time=True, in_secondary=False)
def speedj(thread: ScriptThread, qd: Any, a: Any = 1.4, t: Any = None) -> Waiting:
    speeds = six(qd, "speedj: qd")
    acceleration, seconds = _change(a, "speedj: a"), _seconds(t, "speedj: t")
    return thread.machine.moving(thread, lambda: thread.world.motion.speedj(speeds, acceleration, seconds))


@declare(takes_time=True, in_secondary=False)
def speedl(thread: ScriptThread, xd: Any, a: Any = 1.2, t: Any = None, aRot: Any = "a") -> Waiting:
    speeds = six(xd, "speedl: xd")
    acceleration, seconds = _change(a, "speedl: a"), _seconds(t, "speedl: t")
    turning = _turning(aRot, acceleration, "speedl: aRot")
    return thread.machine.moving(thread, lambda: thread.world.motion.speedl(speeds, acceleration, seconds, turning))


@declare(takes_time=True, in_secondary=False)
def stopj(thread: ScriptThread, a: Any = 2.0) -> Waiting:
    acceleration = _positive(a, "stopj: a")
    return thread.machine.moving(thread, lambda: thread.world.motion.stopj(acceleration))


@declare(takes_time=True, in_secondary=False)
def stopl(thread: ScriptThread, a: Any = 1.2, aRot: Any = "a") -> Waiting:
    acceleration = _positive(a, "stopl: a")
    turning = _turning(aRot, acceleration, "stopl: aRot")
    return thread.machine.moving(thread, lambda: thread.world.motion.stopl(acceleration, turning))


def _turning(aRot: Any, a: float, what: str) -> float:
    """Return the angular acceleration in rad/s². Its default is the same number as the acceleration in m/s²."""
    if isinstance(aRot, str):
        if aRot != "a":
            raise type_error(f"{what} has the type {type_name(aRot)}; expected a number")
        return a
    return _positive(aRot, what)


@declare()
def is_steady(thread: ScriptThread) -> bool:
    """Return whether the arm is at rest. A real arm must have been at rest for some time; this is not modelled."""
    return thread.world.motion.is_standing
