"""Run one program on one arm without a controller, network or clock; the test advances each cycle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, Literal, cast

import numpy as np

from tests.fakes.rehearsal import HOME
from tests.fakes.world import NotedSensors
from urlink.arm.kinematics import Arm
from urlink.arm.models import model
from urlink.motion.moves.speed_limit import largest_speeds
from urlink.motion.servo.resampling import ResampledSetpoints, ResampledSource
from urlink.motion.servo.setpoints import Servoing
from urlink.protocol.enums import ProgramState
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.links import ReverseSocket
from urlink.script.messages import MESSAGE_SIZE, WAIT_MESSAGE, dated, read_message
from urlink.script.wrapping import Permission, program
from urlink.simulator.registers import RegisterBanks
from urlink.simulator.robot.generator import MotionGenerator
from urlink.simulator.robot.setpoint_sources import Setpoint
from urlink.simulator.urscript import Execution, ScriptWorld, compile_script

#: Fields of a state whose program runs at full speed.
PLAYING: dict[str, Any] = {"speed_scaling": 1.0, "program_state": ProgramState.PLAYING}


class Line:
    """The program's only socket: `sent` holds the bytes it sent, `waiting` the bytes it will receive."""

    def __init__(self) -> None:
        self.is_open = False
        self.is_refused = False
        self.sent = bytearray()
        self.waiting = bytearray()

    def open(self, name: str, host: str, port: int) -> None:
        self.is_open = not self.is_refused

    def state(self, name: str) -> Literal["connecting", "open", "failed", "closed"]:
        return "open" if self.is_open else "failed" if self.is_refused else "closed"

    def send(self, name: str, data: bytes) -> bool:
        if self.is_open:
            self.sent += data
        return self.is_open

    def received(self, name: str) -> bytearray:
        return self.waiting

    def close(self, name: str) -> None:
        self.is_open = False

    def close_all(self) -> None:
        self.is_open = False

    def lines(self) -> list[int]:
        """Return and remove the complete lines sent since the last call."""
        *lines, rest = bytes(self.sent).split(b"\n")
        self.sent = bytearray(rest)
        return [int(line) for line in lines]


class Bench:
    """Bench that runs the lines of a program on one arm.

    `q` is the start position of the arm, `path` its position after each cycle, and `texts` the program's messages.
    """

    def __init__(
        self, body: Sequence[str], firmware: Firmware, q: Sequence[float] = HOME, permission: Permission | None = None
    ) -> None:
        self.firmware = firmware
        self.model = model("UR5e" if firmware.is_e_series else "UR5")
        self.period = 1.0 / firmware.rate
        self.cycle = 0
        self.motion = MotionGenerator(Arm(self.model), Setpoint(list(q), [0.0] * 6, [0.0] * 6))
        self.sockets = Line()
        self.texts: list[str] = []
        self.path: list[list[float]] = []
        self.flags = [False] * 32
        self.registers = RegisterBanks()
        #: (variable, frequency, action) of each watchdog that the program has set
        self.watched: list[tuple[str, float, str]] = []
        script = compile_script(program("tried", body, permission).text, firmware)
        self.execution = Execution(script, cast(ScriptWorld, self))

    @property
    def q_actual(self) -> Sequence[float]:
        return self.motion.setpoint.q

    @property
    def sensors(self) -> NotedSensors:
        return NotedSensors(tuple(self.q_actual))

    @property
    def q_target(self) -> Sequence[float]:
        return self.motion.setpoint.q

    @property
    def qd_target(self) -> Sequence[float]:
        return self.motion.setpoint.qd

    def set_watchdog(self, variable: str, frequency: float, action: str) -> None:
        self.watched.append((variable, frequency, action))

    def text_message(self, text: str) -> None:
        self.texts.append(text)

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"the program used {name}, which this bench does not have")

    def deliver(self, messages: bytes) -> None:
        """Deliver messages to the program's socket in this cycle."""
        for at in range(0, len(messages), MESSAGE_SIZE):
            self.sockets.waiting += dated(messages[at : at + MESSAGE_SIZE], self.cycle)

    def run(self, cycles: int = 1, each: Callable[[], object] = lambda: None) -> None:
        """Run `cycles` cycles and call `each` before each one; stop when the program ends."""
        for _ in range(cycles):
            if self.execution.is_over:
                return
            each()
            self.cycle += 1
            self.execution.advance()
            assert self.execution.error is None, self.execution.error
            self.path.append(list(self.motion.advance(self.period).q))

    def beside(self, text: str) -> None:
        """Run a `sec` program, which takes no time."""
        execution = Execution(compile_script(text, self.firmware), cast(ScriptWorld, self))
        execution.advance()
        assert execution.is_over
        assert execution.error is None, execution.error

    def watch_servoj(self, tell: Callable[[list[float]], object], is_followed: bool = True) -> None:
        """Call `tell` with the joints of each ``servoj`` call; with `is_followed=False` the arm does not move."""
        servoj = self.motion.servoj

        def watched(q: Sequence[float], t: float, lookahead_time: float, gain: float) -> object:
            tell(list(q))
            return servoj(q, t, lookahead_time, gain) if is_followed else SimpleNamespace(is_over=True)

        self.motion.servoj = watched  # type: ignore[method-assign,assignment]

    @property
    def said(self) -> list[str]:
        """Messages of the program, without the start and end messages."""
        return [text for text in self.texts if not text.startswith("tried ")]

    @property
    def has_finished(self) -> bool:
        """Whether the program has ended normally."""
        return self.execution.is_over and self.texts[-1] == "tried finished"


class Led:
    """Resampled set-points and the program that follows them, on an arm whose clock the test controls.

    The states start at `BEGIN` on the controller's clock. `sent` holds the set-points.
    """

    BEGIN = 50.0

    def __init__(self, firmware: Firmware, source: ResampledSource) -> None:
        arm = model("UR5e" if firmware.is_e_series else "UR5")
        servoing = Servoing(firmware, largest_speeds(arm), 0.1, 0.03, 300.0)
        self.resampled = ResampledSetpoints(servoing, source)
        self.bench = Bench(servoing.body(ReverseSocket("10.0.0.1", 50001, 7)), firmware)
        self.sent: list[list[float]] = []

    @property
    def time(self) -> float:
        """Controller time of the next state."""
        return self.BEGIN + self.bench.cycle * self.bench.period

    def state(self) -> RealtimeState:
        """Return a state with the fields that motions read."""
        at = self.bench.motion.setpoint
        q, qd = np.array(at.q), np.array(at.qd)
        seen = SimpleNamespace(time=self.time, q_target=q, q_actual=q, qd_target=qd, qd_actual=qd, **PLAYING)
        return cast(RealtimeState, seen)

    def run(self, cycles: int, missed: int = 0) -> None:
        """Run `cycles` cycles; the first `missed` cycles pass without a state."""
        for i in range(cycles):
            if i >= missed:
                message = self.resampled.answer(self.state(), 1000.0 + self.time)
                self.bench.deliver(message)
                if message and message != WAIT_MESSAGE:
                    self.sent.append(read_message(message)[0])
            self.bench.run()
