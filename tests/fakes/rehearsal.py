"""Robot whose arm follows set-points exactly, with one cycle for each step of the test, including its reverse link."""

from __future__ import annotations

import math
import re
import socket
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from queue import Empty, SimpleQueue
from types import SimpleNamespace
from typing import Any, cast

from linkcore.errors import ConnectionLost
from linkcore.handle import Phase
from tests.fakes.controller import ScriptedController
from tests.fakes.packets import packet
from tests.waiting import until
from urlink.arm.kinematics import Arm
from urlink.arm.vectors import FloatArray
from urlink.motion.context import MotionContext
from urlink.motion.links.register_link import (
    POINT_INPUTS,
    SETPOINT_INPUTS,
    PointRegisterLink,
    RegisterLink,
    RegisterPort,
)
from urlink.motion.links.reverse import ReversePort
from urlink.motion.motions import LinkName, Motions
from urlink.motion.servo.force_control import Freedrive
from urlink.protocol.enums import RobotMode, RobotModeCB2, SafetyMode
from urlink.protocol.realtime.packets import RealtimeState
from urlink.robot import Robot
from urlink.script.messages import MESSAGE_SIZE
from urlink.script.wrapping import finish_marker, start_marker

_ARM = Arm("UR5e")
TIMEOUT = 60.0
STOP, FOLLOW, WAIT = 0, 1, 2
#: Joint positions in rad, far from the limits and from singular postures.
HOME = (0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0)


class InputClaim:
    """Claimed RTDE inputs, with the packages that were written to them."""

    def __init__(self) -> None:
        self.written: SimpleQueue[dict[str, float]] = SimpleQueue()
        self.is_cut = False
        #: function that is called before each package is written
        self.before_write: Callable[[], object] = lambda: None

    def _write(self, values: Mapping[str, float]) -> None:
        self.before_write()
        if self.is_cut:
            raise ConnectionLost("cut")
        self.written.put(dict(values))


class Rehearsal(ScriptedController):
    """Robot that sends one state for each `tick`; `q` is the position of its arm, and `message` reads set-points."""

    def __init__(
        self, firmware: str = "5.11", model: str = "UR5e", port: int = 0, link: LinkName = "reverse", **options: Any
    ) -> None:
        super().__init__(firmware, model=model, **options)
        self.has_registers = link == "rtde"
        self.inputs = InputClaim()
        reverse = ReversePort("127.0.0.1", port=port)
        self.context = MotionContext(
            self.programs,
            self.channel,
            self.realtime,
            self.who,
            reverse,
            RegisterPort(self._claim, 1.0, SETPOINT_INPUTS, RegisterLink),
            RegisterPort(self._claim, 1.0, POINT_INPUTS, lambda inputs: PointRegisterLink(inputs, lambda: None)),
            self.section,
            # Motions use the clock of the test, in which one cycle passes with each state.
            clock=lambda: self.time,
        )
        self.motion = Motions(self.context)
        if self.has_registers:
            self.motion.follow = partial(self.motion.follow, link=link)  # type: ignore[method-assign]
            self.motion.servo = partial(self.motion.servo, link=link)  # type: ignore[method-assign]
        self.q = list(HOME)
        self.qd = [0.0] * 6
        self.time = 100.0
        #: Reported speed scaling; CB2 does not report it.
        self.scaling = 1.0
        self.cycle = 1.0 / self.firmware.rate
        self.link: socket.socket | None = None
        #: Joint speeds in the last message, in rad/s.
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
        """Send the next state; the actual position of wrist 3 is `away` rad from its target."""
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
        """Pose of the flange, which is the TCP."""
        return _ARM.forward(self.q)

    def _claim(self, names: tuple[str, ...]) -> InputClaim:
        assert names == SETPOINT_INPUTS
        return self.inputs

    def show(self) -> None:
        """Tick, and wait until the state was received."""
        self.tick()
        until(lambda: self.realtime.latest and self.realtime.latest.time == self.time)

    def until(self, condition: Callable[[], object]) -> None:
        """Tick until the condition is true."""

        def tick() -> bool:
            self.tick()
            return bool(condition())

        until(tick)

    # -- the program on the robot --------------------------------------------------------------------

    @property
    def program(self) -> str:
        """Name of the last sent program."""
        return re.match(r"def (\w+)\(\):", self.uploaded)[1]  # type: ignore[index]

    @property
    def uploaded(self) -> str:
        """Text of the last sent program."""
        return next(text for text in reversed(self.sent) if text.startswith("def "))

    def begin(self) -> None:
        """Start the last sent program, and wait for its start permission if it asks for one."""
        name, sent = self.program, len(self.sent)
        is_asking = "urlink_cycles" in self.uploaded
        self.key("PROGRAM_XXX_STARTED", name)
        self.text(start_marker(name))
        if is_asking:
            until(lambda: len(self.sent) > sent)

    def finish(self, name: str | None = None) -> None:
        """End the program normally."""
        self.text(finish_marker(name or self.program))
        self.key("PROGRAM_XXX_STOPPED", name or self.program)

    def vanish(self) -> None:
        """Stop the program before its end."""
        self.key("PROGRAM_XXX_STOPPED", self.program)

    # -- the reverse link ----------------------------------------------------------------------------

    @property
    def port(self) -> int:
        return int(re.search(r'socket_open\("127\.0\.0\.1", (\d+)\)', self.uploaded)[1])  # type: ignore[index]

    @property
    def token(self) -> bytes:
        """Token that the program sends first."""
        return int(re.search(r"socket_send_int\((\d+)\)", self.uploaded)[1]).to_bytes(4, "big")  # type: ignore[index]

    def connect(self) -> None:
        """Start the last sent program, which connects to the reverse link, or sees its token in a register."""
        self.inputs.written = SimpleQueue()  # discard the last messages of the previous motion
        self.begin()
        if self.has_registers:
            # The start is reported on another connection than the states, and the states trigger the next writes.
            until(lambda: (motion := self.motion.current) is None or motion.phase is Phase.RUNNING)
            return
        if self.link is not None:
            self.link.close()
        self.link = socket.create_connection(("127.0.0.1", self.port), TIMEOUT)
        self.link.sendall(self.token)
        self._rest = b""

    def message(self) -> tuple[list[float], int] | None:
        """Return the next message: six joint positions in rad, and the mode; None if the connection has ended.

        Registers have no end of a connection. There the result is None when no motion is left that could write.
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
        """Tick once, and return the message that answers it; the arm moves to the set-point of the message."""
        self.tick()
        message = self.message()
        if message is not None and message[1] == FOLLOW:
            self.q = message[0]
        return message

    def line(self) -> str:
        """Return the next answered line."""
        assert self.link is not None
        while b"\n" not in self._rest:
            data = self.link.recv(4096)
            assert data, "the library has closed the connection"
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


def freedrive(motions: Motions, *axes: Any, **options: Any) -> Freedrive:
    """Call `Robot.freedrive` of a robot with these motions."""
    return Robot.freedrive(cast(Robot, SimpleNamespace(motion=motions)), *axes, **options)


def turned(angle: float, q: Sequence[float] = HOME) -> list[float]:
    """Return a posture with wrist 3 turned by an angle."""
    return [*q[:5], q[5] + angle]
