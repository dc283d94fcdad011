"""Tool, payload and kinematics of ur_rtde's control interface, and what it asks of the controller.

The value of a URScript expression comes from a program that runs beside the one that moves the arm.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from queue import Empty, SimpleQueue

import urlink
from linkcore.errors import LinkTimeout

from ..kinematics import Unreachable
from ..packets import CartesianInfo
from ..poses import compose
from ..urscript import text
from .interface import NotOffered, RtdeInterface, succeeds

__all__ = ["STATE_TIMEOUT", "ControlTool", "ask"]

#: Seconds to wait for an answer.
_TIMEOUT = 5.0

_numbers = itertools.count(1)


def ask(robot: urlink.Robot, expression: str) -> str:
    """The value of an expression, as text that the controller makes of it.

    Raises:
        SafetyStop, NotRunning: the controller accepts no programs now.
        CompileError: a function does not exist on this controller.
        LinkTimeout: no answer within 5 s.
    """
    mark = f"urlink answer {next(_numbers)} "
    answers: SimpleQueue[str] = SimpleQueue()

    def on_message(message: urlink.packets.TextMessage) -> None:
        if message.text.startswith(mark):
            answers.put(message.text[len(mark) :])

    # Subscribed to the stream and not to the program: a line of text does not say which program sent it.
    with robot.primary.subscribe(on_message, urlink.packets.TextMessage, inline=True):
        robot.script.run(f'sec urlink_question():\n  textmsg("{mark}", {expression})\nend')
        try:
            return answers.get(timeout=_TIMEOUT)
        except Empty:
            raise LinkTimeout(f"no answer to {expression} within {_TIMEOUT:g} s") from None


#: Seconds to wait for a state.
STATE_TIMEOUT = 5.0


class ControlTool(RtdeInterface):
    """TCP, payload and kinematics."""

    def setTcp(self, tcp_offset: Sequence[float]) -> bool:
        """Set the TCP: a pose in the frame of the flange, m and rad."""
        return succeeds(lambda: self._robot.set_tcp(tcp_offset))

    def getTCPOffset(self) -> list[float]:
        """The TCP, a pose in the frame of the flange, m and rad; from 3.2 on."""
        feed = self._robot.primary.of(CartesianInfo)
        info = feed.latest or feed.wait(STATE_TIMEOUT)
        if info.tcp_offset_X is None:
            raise NotOffered("a controller before 3.2 does not send the offset of its tool")
        turn = (info.tcp_offset_Rx, info.tcp_offset_Ry, info.tcp_offset_Rz)
        return [float(each or 0.0) for each in (info.tcp_offset_X, info.tcp_offset_Y, info.tcp_offset_Z, *turn)]

    def setPayload(self, mass: float, cog: Sequence[float] = ()) -> bool:
        """Set the payload: mass in kg, centre of gravity in m."""
        return succeeds(lambda: self._robot.set_payload(mass, cog or None))

    def setTargetPayload(self, mass: float, cog: Sequence[float] = (), inertia: Sequence[float] = (0.0,) * 6) -> bool:
        """Set the payload with its inertia, (6,) kg m²; from 5.10 on."""
        return succeeds(lambda: self._robot.set_payload(mass, cog or None, inertia))

    def getForwardKinematics(self, q: Sequence[float] = (), tcp_offset: Sequence[float] = ()) -> list[float]:
        """The pose of the tool at joint positions; without arguments, of the present positions and TCP."""
        values = q or self._robot.realtime.wait(STATE_TIMEOUT).q_actual
        return list(map(float, self._robot.kinematics.forward(values, tcp_offset or self.getTCPOffset())))

    def getInverseKinematics(
        self,
        x: Sequence[float],
        qnear: Sequence[float] = (),
        max_position_error: float = 1e-10,
        max_orientation_error: float = 1e-10,
    ) -> list[float]:
        """The joint positions for a pose of the tool that are closest to `qnear`, or to the target joint positions.

        The largest errors have no effect: the result is exact to 1e-12 m and rad.

        Raises:
            Unreachable: the pose is out of reach.
        """
        near = qnear or self._robot.realtime.wait(STATE_TIMEOUT).q_target
        return list(map(float, self._robot.kinematics.inverse(x, near, self.getTCPOffset())))

    def getInverseKinematicsHasSolution(
        self,
        x: Sequence[float],
        qnear: Sequence[float] = (),
        max_position_error: float = 1e-10,
        max_orientation_error: float = 1e-10,
    ) -> bool:
        """Whether a pose of the tool is within reach."""
        try:
            self.getInverseKinematics(x, qnear)
        except Unreachable:
            return False
        return True

    def getActualToolFlangePose(self) -> list[float]:
        """The pose of the flange."""
        return list(map(float, self._robot.kinematics.forward(self._robot.realtime.wait(STATE_TIMEOUT).q_actual)))

    def poseTrans(self, p_from: Sequence[float], p_from_to: Sequence[float]) -> list[float]:
        """The pose `p_from_to`, which is given in the frame `p_from`, in the frame that `p_from` is given in."""
        return list(map(float, compose(p_from, p_from_to)))

    def isPoseWithinSafetyLimits(self, pose: Sequence[float]) -> bool:
        """Whether the safety configuration allows this pose of the tool; computed by the controller."""
        return ask(self._robot, f"is_within_safety_limits({text.pose(pose, 'pose')})") == "True"

    def isJointsWithinSafetyLimits(self, q: Sequence[float]) -> bool:
        """Whether the safety configuration allows these joint positions; computed by the controller."""
        return ask(self._robot, f"is_within_safety_limits({text.vector(q, 6, 'q')})") == "True"
