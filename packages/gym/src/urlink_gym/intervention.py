"""Interventions: a held button, and a second arm that a person moves by hand."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

import urlink
from urlink import BadValue
from urlink.packets import DigitalBits, RealtimeState

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

    from .arm_env import ArmEnv

__all__ = ["LeaderArm", "held"]

#: Longest time, in s, until a state of the leader arrives.
_STATE_TIMEOUT = 1.0


def held(button: DigitalBits | int) -> Callable[[RealtimeState], bool]:
    """Return a function that shows whether a button at a digital input is held, in a state of the arm.

    Args:
        button: Bit of the input, such as `urlink.packets.DigitalBits.TOOL_0`.

    Raises:
        BadValue: If `button` is not a bit of a digital input.
    """
    if not isinstance(button, int) or isinstance(button, bool) or button <= 0:
        raise BadValue(f"button={button!r}; expected a bit such as DigitalBits.TOOL_0")

    def is_held(state: RealtimeState) -> bool:
        return bool(int(state.digital_input_bits or 0) & button)

    return is_held


class LeaderArm:
    """Second arm whose motion replaces the actions of a policy while a button is held.

    It is only read. A person moves it with its freedrive button. The environment's arm repeats the motion of the leader
    since the button was pressed, so both arms may be in different positions.

    Args:
        address: Address of its controller.
        button: Function that shows whether the button is held, in a state of the leader, such as
            `held(DigitalBits.TOOL_0)`.

    Raises:
        LinkError: If the controller cannot be reached.
    """

    def __init__(self, address: str, button: Callable[[RealtimeState], bool]) -> None:
        self._button = button
        self._before: RealtimeState | None = None
        self._robot = urlink.connect(address, read_only=True)
        try:
            self._robot.realtime.wait(5.0 * _STATE_TIMEOUT)
        except BaseException:
            self._robot.close()
            raise

    def __call__(self, env: ArmEnv) -> NDArray[np.float32] | None:
        """Return the action that repeats the motion since the last call; None while the button is not held.

        Raises:
            LinkTimeout: If no state of the leader arrives within a second.
        """
        state = self._robot.realtime.latest
        if state is None or state.received is None or state.received.age > _STATE_TIMEOUT:
            state = self._robot.realtime.wait(_STATE_TIMEOUT)
        before, self._before = self._before, state if self._button(state) else None
        if self._before is None:
            return None
        if before is None:
            return env.rest()
        return env.motion_between(before, state)

    def close(self) -> None:
        """Disconnect from the leader."""
        self._robot.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
