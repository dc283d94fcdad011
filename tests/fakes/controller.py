"""Scripted controller that sends the packets of the test, and the objects that command it."""

from __future__ import annotations

from typing import Any

from linkcore.handle import Handle
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.stream import Stream
from linkcore.threads import CallbackThread
from tests.fakes.line import START_PLACE
from tests.fakes.link import ScriptedTransport
from tests.fakes.packets import packet
from tests.waiting import until
from urlink.command.channel import CommandChannel
from urlink.command.interlock import Interlock
from urlink.command.io import IO
from urlink.command.programs import Programs
from urlink.command.safety import Safety
from urlink.command.safety_monitor import SafetyMonitor
from urlink.command.scripts import Scripts
from urlink.command.section import Section
from urlink.command.settings import BriefInputs, SettingChannel, Settings
from urlink.protocol.enums import MasterSafetyState, RobotMode, RobotModeCB2, SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.primary.robot_message import KeyMessage, RuntimeExceptionMessage, SafetyModeMessage, TextMessage
from urlink.protocol.primary.robot_state import MasterboardData, RobotModeData, RobotState, ToolData
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.wrapping import StartPlace, finish_marker, start_marker
from urlink.session.connect_options import Policy
from urlink.session.identity import Identity, KnownIdentity
from urlink.session.source import Source

AT_ONCE = Backoff(first=0, most=0)


class ScriptedController:
    """Controller that sends a packet in `state`, `key`, `text` and `exception`; `sent` holds the received commands."""

    def __init__(
        self,
        firmware: str = "5.11",
        policy: Policy = "never",
        backoff: Backoff = AT_ONCE,
        *,
        model: str | None = None,
        stale_after: float = 60.0,  # longer than on a robot, because a busy computer may delay a test
        start_timeout: float = 5.0,
        start_place: StartPlace = START_PLACE,
        is_remote: bool | None = None,
        inputs: BriefInputs | None = None,
        fast: ScriptedTransport | None = None,
    ) -> None:
        self.firmware = Firmware.parse(firmware)
        self.slow, self.fast = ScriptedTransport(), fast or ScriptedTransport()
        transports = {"primary": self.slow, "realtime": self.fast}
        identity = Identity(self.firmware, True, model)
        self.who = KnownIdentity(lambda: identity)
        connections: list[Connection] = []

        def connection(*arguments: Any, **options: Any) -> Connection:
            connections.append(Connection(*arguments, **options))
            return connections[-1]

        source = Source(lambda: identity, transports.__getitem__, backoff, 5.0, None, False, connection=connection)
        self.primary: Stream[RobotState] = source.stream("primary", "stand-in primary", lambda: None)
        self.realtime: Stream[RealtimeState] = source.stream("realtime", "stand-in realtime", lambda: None)
        self.callbacks = CallbackThread("stand-in callbacks")
        slow, quick = connections
        self.section = Section(slow.reads_here, quick.reads_here)
        self.monitor = SafetyMonitor(slow, quick, Interlock(policy, stale_after), self.section, self.callbacks)
        self.channel = CommandChannel(slow, self.monitor, self.section)
        self.programs = Programs(
            slow,
            self.channel,
            self.monitor,
            self.section,
            self.callbacks,
            start_timeout=start_timeout,
            start_place=start_place,
            who=self.who,
        )
        self.safety = Safety(self.monitor)
        self.script = Scripts(self.programs, self.channel, self.callbacks)
        self.settings = Settings(
            SettingChannel(self.channel, slow, self.section, None if inputs is None else lambda: inputs),
            slow,
            quick,
            self.who,
            self.section,
            lambda: is_remote,
            start_place,
        )
        self.io = IO(self.settings, self.primary, self.realtime)

    def close(self) -> None:
        self.programs.close(0.0)
        self.monitor.close()
        self.callbacks.close(1.0)
        self.primary.close()
        self.realtime.close()

    def __enter__(self) -> ScriptedController:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    @property
    def sent(self) -> list[str]:
        return [data.decode() for data in self.slow.sent]

    # -- packets to the library ----------------------------------------------------------------------

    def state(
        self,
        mode: RobotMode | RobotModeCB2 | None = None,
        safety: SafetyMode = SafetyMode.NORMAL,
        *,
        runs: bool = False,
        emergency: bool = False,
        protective: bool = False,
        master: MasterSafetyState = MasterSafetyState.OK,
        board: dict[str, Any] | None = None,
        tool: dict[str, Any] | None = None,
        fast: bool = True,
    ) -> None:
        """Send one state on both interfaces, or only on the primary interface if `fast` is False."""
        if mode is None:
            mode = RobotModeCB2.RUNNING if self.firmware.is_cb2 else RobotMode.RUNNING
        modes = packet(
            RobotModeData,
            self.firmware,
            robot_mode=mode,
            is_program_running=runs,
            is_emergency_stopped=emergency,
            is_protective_stopped=protective,
        )
        safe = {"master_safety_state": master} if self.firmware.is_cb2 else {"safety_mode": safety}
        masterboard = packet(MasterboardData, self.firmware, **safe, **(board or {}))
        self.slow.put(bytes(RobotState(modes, masterboard, packet(ToolData, self.firmware, **(tool or {})))))
        if fast:
            fields = {"robot_mode": mode} if self.firmware.is_cb2 else {"robot_mode": mode, "safety_mode": safety}
            self.fast.put(bytes(packet(RealtimeState, self.firmware, **fields)))

    def clear(self, **options: Any) -> None:
        """Send a state that permits motions, and wait until the interlock has received it on both interfaces."""
        self.state(**options)
        self.monitor.listen(closely=True)
        until(lambda: self.monitor.refusal_to_stop() is None)

    def safety_message(self, mode: SafetyMode) -> None:
        self.slow.put(bytes(SafetyModeMessage(self.firmware, safety_mode=mode)))

    def key(self, title: str, name: str) -> None:
        self.slow.put(bytes(KeyMessage(self.firmware, title=title, text=name)))

    def text(self, text: str) -> None:
        self.slow.put(bytes(TextMessage(self.firmware, text=text)))

    def exception(self, line: int, column: int, text: str) -> None:
        self.slow.put(bytes(RuntimeExceptionMessage(self.firmware, line=line, column=column, text=text)))

    # -- events of a program -------------------------------------------------------------------------

    def begins(self, program: Handle) -> None:
        self.key("PROGRAM_XXX_STARTED", program.name)
        self.text(start_marker(program.name))

    def comes_to_its_end(self, program: Handle) -> None:
        self.text(finish_marker(program.name))
        self.key("PROGRAM_XXX_STOPPED", program.name)

    def is_stopped(self, program: Handle) -> None:
        self.key("PROGRAM_XXX_STOPPED", program.name)
