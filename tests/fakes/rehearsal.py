"""A robot whose arm is where it is led to, cycle by cycle as the test says; it plays both sides of the reverse link."""

from __future__ import annotations

import math
import re
import socket
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

from linkcore.errors import ConnectionLost
from linkcore.handle import Phase
from tests.fakes.controller import ScriptedController
from tests.fakes.packets import packet
from tests.waiting import until
from urlink.arm.kinematics import Arm
from urlink.arm.vectors import FloatArray
from urlink.motion.context import MotionContext
from urlink.motion.links.messages import MESSAGE_SIZE
from urlink.motion.links.register_link import (
    POINT_INPUTS,
    SETPOINT_INPUTS,
    PointRegisterLink,
    RegisterLink,
    RegisterPort,
)
from urlink.motion.links.reverse import ReversePort
from urlink.motion.motions import LinkName, Motions
from urlink.protocol.enums import RobotMode, RobotModeCB2, SafetyMode
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.wrapping import finish_marker, start_marker

_ARM = Arm("UR5e")
TIMEOUT = 60.0
STOP, FOLLOW, WAIT = 0, 1, 2
#: rad; far from the limits and from singular postures.
HOME = (0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0)


class InputClaim:
    """RTDE inputs that were claimed: the packages of them that were written."""

    def __init__(self) -> None:
        self.written: SimpleQueue[dict[str, float]] = SimpleQueue()
        self.is_cut = False

    def _write(self, values: Mapping[str, float]) -> None:
        if self.is_cut:
            raise ConnectionLost("cut")
        self.written.put(dict(values))


class Rehearsal(ScriptedController):
    """Each `tick` is one state of the robot; `q` is where its arm is, and what is sent to it is read by `message`."""

    def __init__(
        self, firmware: str = "5.11", model: str = "UR5e", port: int = 0, link: LinkName = "reverse", **options: Any
    ) -> None:
        super().__init__(firmware, model=model, **options)
        self.has_registers = link == "rtde"
        self.inputs = InputClaim()
        reverse = ReversePort("127.0.0.1", port=port)
        self.motion = Motions(
            MotionContext(
                self.programs,
                self.channel,
                self.realtime,
                self.who,
                reverse,
                RegisterPort(self._claim, 1.0, SETPOINT_INPUTS, RegisterLink),
                RegisterPort(self._claim, 1.0, POINT_INPUTS, lambda inputs: PointRegisterLink(inputs, lambda: None)),
                self.section,
                # Motions go by the clock of the test: one cycle passes with each state.
                clock=lambda: self.time,
            )
        )
        if self.has_registers:
            self.motion.follow = partial(self.motion.follow, link=link)  # type: ignore[method-assign]
            self.motion.servo = partial(self.motion.servo, link=link)  # type: ignore[method-assign]
        self.q = list(HOME)
        self.qd = [0.0] * 6
        self.time = 100.0
        #: as it is reported; not on CB2
        self.scaling = 1.0
        self.cycle = 1.0 / self.firmware.rate
        self.link: socket.socket | None = None
        #: those in the last message, rad/s
        self.speeds = [0.0] * 6
        self._rest = b""
        self.clear()
        self.show()

    def __enter__(self) -> Rehearsal:
        return self

    def close(self) -> None:
        if self.link is not None:
            self.link.close()
        super().close()

    def tick(self, away: float = 0.0) -> None:
        """One state later; wrist 3 is reported `away` rad from where it was led."""
        self.time += self.cycle
        self.state(fast=False)
        mode = {"robot_mode": RobotModeCB2.RUNNING if self.firmware.is_cb2 else RobotMode.RUNNING}
        safety = {} if self.firmware.is_cb2 else {"safety_mode": SafetyMode.NORMAL}
        time = {} if self.firmware.is_cb2 else {"speed_scaling": self.scaling}
        actual = [*self.q[:5], self.q[5] + away]
        state = packet(
            RealtimeState,
            self.firmware,
            time=self.time,
            q_target=self.q,
            q_actual=actual,
            qd_target=self.qd,
            qd_actual=self.qd,
            tool_vector_actual=self.pose,
            **mode,
            **time,
            **safety,
        )
        self.fast.put(bytes(state))

    @property
    def pose(self) -> FloatArray:
        """Of its flange, which is its tool."""
        return _ARM.forward(self.q)

    def _claim(self, names: tuple[str, ...]) -> InputClaim:
        assert names == SETPOINT_INPUTS
        return self.inputs

    def show(self) -> None:
        """Tick, and wait until that has been heard."""
        self.tick()
        until(lambda: self.realtime.latest and self.realtime.latest.time == self.time)

    def until(self, condition: Callable[[], object]) -> None:
        """Tick until something is so."""

        def tick() -> bool:
            self.tick()
            return bool(condition())

        until(tick)

    # -- its program ---------------------------------------------------------------------------------

    @property
    def program(self) -> str:
        """Name of the program that was sent last."""
        return re.match(r"def (\w+)\(\):", self.uploaded)[1]  # type: ignore[index]

    @property
    def uploaded(self) -> str:
        """Text of the program that was sent last."""
        return next(text for text in reversed(self.sent) if text.startswith("def "))

    def begin(self) -> None:
        """The program that was sent last begins, and is let go on if it asks."""
        name, sent = self.program, len(self.sent)
        is_asking = "urlink_cycles" in self.uploaded
        self.key("PROGRAM_XXX_STARTED", name)
        self.text(start_marker(name))
        if is_asking:
            until(lambda: len(self.sent) > sent)

    def finish(self, name: str | None = None) -> None:
        """It comes to its end."""
        self.text(finish_marker(name or self.program))
        self.key("PROGRAM_XXX_STOPPED", name or self.program)

    def vanish(self) -> None:
        """It is stopped."""
        self.key("PROGRAM_XXX_STOPPED", self.program)

    # -- the reverse link ----------------------------------------------------------------------------

    @property
    def port(self) -> int:
        return int(re.search(r'socket_open\("127\.0\.0\.1", (\d+)\)', self.uploaded)[1])  # type: ignore[index]

    @property
    def token(self) -> bytes:
        """What the program says first."""
        return int(re.search(r"socket_send_int\((\d+)\)", self.uploaded)[1]).to_bytes(4, "big")  # type: ignore[index]

    def connect(self) -> None:
        """The program that was sent last begins, and connects or sees its token."""
        self.inputs.written = SimpleQueue()  # without the last messages of the motion before
        self.begin()
        if self.has_registers:
            # It is told on another connection than the states, at which it is written to.
            until(lambda: (motion := self.motion.current) is None or motion.phase is Phase.RUNNING)
            return
        if self.link is not None:
            self.link.close()
        self.link = socket.create_connection(("127.0.0.1", self.port), TIMEOUT)
        self.link.sendall(self.token)
        self._rest = b""

    def message(self) -> tuple[list[float], int] | None:
        """The next message: six joints in rad, and what to do; None where the connection has ended.

        Registers have no end; there it is None once nothing more can come, since no motion is left.
        """
        if self.has_registers:
            until(lambda: self.motion.current is None or not self.inputs.written.empty())
            try:
                inputs = self.inputs.written.get(block=False)
            except Empty:
                return None
            assert inputs["input_int_register_47"] == int(
                re.search(r"input_integer_register\(47\) == (\d+)", self.uploaded)[1]  # type: ignore[index]
            )
            numbers = [inputs[f"input_double_register_{36 + i}"] for i in range(12)]
            self.speeds = numbers[6:]
            return numbers[:6], int(inputs["input_int_register_46"])
        assert self.link is not None
        while len(self._rest) < MESSAGE_SIZE + 4:
            try:
                data = self.link.recv(4096)
            except ConnectionError:
                return None
            if not data:
                return None
            self._rest += data
        *whole, mode = struct.unpack(">13i", self._rest[:MESSAGE_SIZE])
        self._rest = self._rest[MESSAGE_SIZE + 4 :]  # without its date
        numbers = [each / 1e6 for each in whole]
        self.speeds = numbers[6:]
        return numbers[:6], mode

    def obey(self) -> tuple[list[float], int] | None:
        """One tick, and the message that answers it; the arm goes there."""
        self.tick()
        message = self.message()
        if message is not None and message[1] == FOLLOW:
            self.q = message[0]
        return message

    def line(self) -> str:
        """The next line that was answered."""
        assert self.link is not None
        while b"\n" not in self._rest:
            data = self.link.recv(4096)
            assert data, "closed"
            self._rest += data
        line, self._rest = self._rest.split(b"\n", 1)
        return line.decode().strip()

    def ask(self, number: int) -> list[float]:
        """Ask for something as the waypoint program does, and return the answer."""
        assert self.link is not None
        self.link.sendall(b"%d\n" % number)
        answer: list[str] = []

        def is_answered() -> bool:
            assert self.link is not None
            self.link.settimeout(0.01)
            try:
                answer.append(self.line())
            except TimeoutError:
                return False
            finally:
                self.link.settimeout(TIMEOUT)
            return True

        self.until(is_answered)
        return [float(each) for each in answer[0].strip("()").split(",")]


def turned(angle: float, q: Sequence[float] = HOME) -> list[float]:
    """A posture with wrist 3 turned."""
    return [*q[:5], q[5] + angle]
