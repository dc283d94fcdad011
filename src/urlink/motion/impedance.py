"""Impedance: springs and dampers between the arm and a target, computed on the controller by direct torque."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError
from linkcore.wire.fields import Since

from ..interfaces.realtime.packets import RealtimeState
from ..models import Model
from ..parameters import numbers as parameter
from ..parameters import parameters
from ..urscript.links import FOLLOW, InputRegisters, ReverseSocket
from ..urscript.springs import GAINS, Springs, impedance
from ..vectors import JOINTS, FloatArray, Numbers, six
from .context import MotionContext
from .linked import Link
from .linked_block import LinkedBlock
from .setpoints import STOP_WORD, packed

__all__ = ["Impedance"]

_DIRECT_TORQUE = Since("5.23/10.11")
#: Nm/rad of a joint at most: with its inertia more would swing faster than a cycle lets it be damped.
_STIFFEST = 10_000.0
#: The largest damping ratio.
_DAMPEST = 3.0
#: rad/s, rad: the least speed and the largest error that a joint can be given.
_SLOWEST, _FURTHEST = 0.01, 3.0
#: The part of its largest torque that springs and dampers of a joint may have; and how many times as much, at most,
#: brakes it. Chosen: so that what brakes is always more than what drives.
_SHARE, _BRAKING = 0.5, 4.0
#: rad that stand for a joint that turns without end.
_ENDLESS = 1e6
#: One word of so many has the gains. No simple fraction: a program that takes each n-th word meets them all the same.
_GOLDEN, _GAINS_SHARE = 0.6180339887, 0.25


class Impedance(LinkedBlock):
    """Draws the arm to a target by springs and dampers; made by `robot.motion.impedance`.

    Args:
        context: the robot.
        stiffness: Nm/rad, of all joints or (6,) of each; None for that of the vendor's example.
        damping: ratio, likewise.
        torque: (6,) Nm, or one for all, of springs and dampers; None for about those of the vendor's example.
        speed, error: rad/s and rad, of all joints or (6,) of each.
        friction_compensation: whether the controller compensates the friction of the joints.
        watchdog: s without a word from this computer after which the robot ends it.
        open_link: opens the link to the program.

    Raises:
        BadValue: a number out of range, or needed for this arm.
        LocalError: this firmware has no direct torque, or the arm is not known.
    """

    def __init__(
        self,
        context: MotionContext,
        stiffness: ArrayLike | None,
        damping: ArrayLike,
        torque: ArrayLike | None,
        speed: ArrayLike,
        error: ArrayLike,
        friction_compensation: bool,
        watchdog: float,
        open_link: Callable[[], Link],
    ) -> None:
        firmware, model = context.who.identity.firmware, context.who.identity.arm
        if firmware not in _DIRECT_TORQUE:
            raise LocalError(f"firmware {firmware} has no direct torque, by which springs act: 5.23 and 10.11 have it")
        if model is None:
            raise LocalError("the controller does not say which arm this is, so its torques and speeds are not known")
        self._model = model
        most = model.max_torque
        low, high = np.clip(model.position_limits, -_ENDLESS, _ENDLESS).T
        if torque is None:
            torque = _default("impedance_torque", model)
        torques = _within(torque, "torque", 0.0, (_SHARE * most).tolist(), "Nm")
        springs = Springs(
            stiffness=_stiffness(_default("impedance_stiffness", model) if stiffness is None else stiffness).tolist(),
            damping=_damping(damping).tolist(),
            speed=_within(speed, "speed", _SLOWEST, model.max_speed.tolist(), "rad/s").tolist(),
            torque=torques.tolist(),
            braking=np.minimum(_BRAKING * torques, most).tolist(),
            error=_within(error, "error", 0.0, [_FURTHEST] * 6, "rad").tolist(),
            lowest=low.tolist(),
            highest=high.tolist(),
            friction_compensation=bool(friction_compensation),
            watchdog=check_number(watchdog, "watchdog", 0.05, 10.0, "s"),
        )
        self._words = _Words(partial(impedance, firmware, springs=springs), springs.stiffness, springs.damping)
        super().__init__(context, "impedance", self._words, open_link)

    @property
    def target(self) -> FloatArray | None:
        """(6,) rad; None before the first, when the arm is held where it was."""
        return None if self._words.target is None else np.array(self._words.target)

    @property
    def stiffness(self) -> FloatArray:
        """(6,) Nm/rad, as they were set last."""
        return np.array(self._words.gains[0])

    @property
    def damping(self) -> FloatArray:
        """(6,) ratios, as they were set last; 1 is critical."""
        return np.array(self._words.gains[1])

    def send(self, q: Numbers) -> None:
        """Draw the arm to joint positions from now on, at any rate: 10 or 500 a second, or one for all.

        The program goes to each in as long as the last ones took to come, so it is about one interval behind, and never
        faster than 0.7 of the largest speed.

        Args:
            q: (6,) rad.

        Raises:
            BadValue: not six numbers, or out of the range of a joint; the target is as before.
            LinkError: the impedance is over; the error says why.
            LocalError: not within the block.
        """
        self._check_open()
        goal = six(q, "q")
        self._model.check_joints(goal)
        self._words.lead(goal.tolist())

    def set_gains(self, stiffness: ArrayLike | None = None, damping: ArrayLike | None = None) -> None:
        """Go over to another stiffness and damping, within some tenths of a second.

        Args:
            stiffness: Nm/rad, of all joints or (6,) of each; None leaves it.
            damping: ratio, likewise.

        Raises:
            BadValue: out of range; the gains are as before.
            LinkError: the impedance is over; the error says why.
            LocalError: not within the block.
        """
        self._check_open()
        old = self._words.gains
        self._words.gains = (
            old[0] if stiffness is None else _stiffness(stiffness).tolist(),
            old[1] if damping is None else _damping(damping).tolist(),
        )


class _Words:
    """The dialogue with the program: each state is answered with the target, or with the gains.

    Attributes:
        target: (6,) said last; None before.
        gains: stiffness and damping, (6,) each; may be set by any thread.
    """

    farewell = STOP_WORD
    is_over = False
    survives_its_program = False

    def __init__(
        self,
        body: Callable[[ReverseSocket | InputRegisters], list[str]],
        stiffness: Sequence[float],
        damping: Sequence[float],
    ) -> None:
        self.gains = list(stiffness), list(damping)
        self._body = body
        self._told: tuple[int, list[float]] = (0, [0.0] * 6)
        self._turn = 0.0

    @property
    def target(self) -> list[float] | None:
        number, values = self._told
        return values if number else None

    def lead(self, target: list[float]) -> None:
        """Go to another target."""
        self._told = (self._told[0] % 1000 + 1, target)

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        return self._body(link)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        self._turn = (self._turn + _GOLDEN) % 1.0
        if self._turn < _GAINS_SHARE:
            stiffness, damping = self.gains
            return packed([each / 1000.0 for each in stiffness], damping, GAINS)
        number, target = self._told
        return packed(target, [number, 0.0, 0.0, 0.0, 0.0, 0.0], FOLLOW)

    def resume(self, state: RealtimeState) -> None: ...

    def conclude(self) -> None: ...


def _default(name: str, model: Model) -> FloatArray:
    if (name, model.name) not in parameters():
        what = name.removeprefix("impedance_")
        raise BadValue(f"{what} has no default for a {model.name}; expected a number, or six")
    return np.array(parameter(name, model.name))


def _stiffness(values: ArrayLike) -> FloatArray:
    return _within(values, "stiffness", 0.0, [_STIFFEST] * 6, "Nm/rad")


def _damping(values: ArrayLike) -> FloatArray:
    return _within(values, "damping", 0.0, [_DAMPEST] * 6)


def _within(values: ArrayLike, name: str, least: float, most: list[float], unit: str = "") -> FloatArray:
    """One number for all joints or six, each within its range."""
    given = six(np.broadcast_to(values, 6) if np.ndim(values) == 0 else values, name)
    for joint, (value, limit) in enumerate(zip(given.tolist(), most, strict=True)):
        check_number(value, f"{name}[{joint}] ({JOINTS[joint]})", least, limit, unit)
    return given
