"""The controller: clock, arm, modes, signals, programs, and what it sends."""

from __future__ import annotations

import ipaddress
import logging
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING, Literal

from linkcore.errors import BadValue, LocalError
from urlink import models
from urlink.address import RobotAddress
from urlink.firmware import NEWEST, RELEASES, Firmware, release_of

from ..interfaces.dashboard.commands import GREETING
from ..ports import PORTS, interface
from .arm import Arm
from .assembly import Assembler
from .counters import Counters
from .dashboard import Responder
from .faults import FAULTS, Faults, ScheduledFault, parse_fault
from .messages import greeting, safety_messages
from .modes import Modes, Stop
from .motion import Demonstration, Motion
from .packets import Packets
from .pendant import Pendant
from .programs import Programs
from .signals import Signals

if TYPE_CHECKING:
    from typing_extensions import Self

    from .server import Server

__all__ = ["Controller"]

_log = logging.getLogger("urlink.simulator")

_NEWEST_CB3 = [row.since for row in RELEASES if row.since.major == 3][-1]

#: States a second on the primary and secondary interface.
STATE_RATE = 10
#: Bytes of messages in one cycle after which texts and popups are lost; a program could make thousands of them.
MOST_MESSAGES = 1 << 14
#: Lines from clients that are kept.
RECEIVED = 1000


class Controller:
    """A robot controller in software: it serves the primary, secondary and real-time interfaces and the dashboard, and
    runs the URScript that is sent to it.

    As a context manager it serves its ports from one thread of its own::

        with Controller("UR5e", "5.11") as controller:
            print(controller.host, controller.ports["realtime"])

    Without being started it has no thread and no socket, and `step` advances it cycle by cycle: everything then is
    the same for the same seed, to the last byte.

    Args:
        model: name of the arm, such as `"UR10"`; None for a UR5e, or a UR5 where the firmware is older than 5.0.
        firmware: None for the newest that suits the model.
        host: address to listen on.
        ports: `"free"` for any that are free, `"standard"` for those of a real controller, or a mapping from names in
            `PORTS` to numbers, 0 for a free one; ports that it leaves out are not served.
        seed: of the noise on the sensors and of random garbage.
        serial: serial number of the arm.
        motion: what the arm follows; None for the gentle demonstration.
        output_limit: bytes that may wait for one client before it is dropped, beside what the network holds.
        files: path -> URScript of the programs that are saved at the pendant.
        reachable: numeric addresses beyond this computer that programs may open sockets to. Those of connected
            clients always are.

    Attributes:
        model: the `urlink.models.Model`.
        firmware: what the controller runs at present.
        arm: its joints: motion, TCP, payload.
        modes: of robot, safety and program.
        signals: its inputs and outputs.
        faults: what can go wrong, on demand.
        programs: that run on it.
        pendant: what is saved, loaded and shown at it; its buttons.
        dashboard: answers the lines of dashboard clients.
        remote_control: on an e-Series, whether it takes commands from others than the pendant.
        speed_fraction: of the speed slider, 0 to 1.
        flags: 64, of `set_flag`.
        stopped_since: `time` at which the present stop began; None without one.
        received: (name of the port, line of text) of the latest lines that clients sent.
        counters: what has happened on the ports.
        cycle: number of the cycle since the controller was made, reboots included.

    Raises:
        UnknownModel: no such arm.
        BadVersion: no such firmware.
        BadValue: the firmware does not go with the model, `ports` is none of the above, or an address in `reachable`
            is not numeric.
    """

    arm: Arm
    modes: Modes

    def __init__(
        self,
        model: str | None = None,
        firmware: str | Firmware | None = None,
        *,
        host: str = "127.0.0.1",
        ports: Literal["free", "standard"] | Mapping[str, int] = "free",
        seed: int = 0,
        serial: str = "20230000001",
        motion: Motion | None = None,
        output_limit: int = 1 << 20,
        files: Mapping[str, str] | None = None,
        reachable: Iterable[str] = (),
    ) -> None:
        if model is None:
            model = "UR5" if firmware is not None and not Firmware.parse(firmware).is_e_series else "UR5e"
        self.model = models.model(model)
        newest = NEWEST if self.model.generation == "e" else _NEWEST_CB3
        self.firmware = self.suited(newest if firmware is None else firmware)
        self.host = host
        self.seed = seed
        self.serial = serial
        self.output_limit = output_limit
        self.cycle = 0
        self.signals = Signals()
        self.pendant = Pendant(self, files or {})
        self.reachable = frozenset(map(_numeric, reachable))
        self.remote_control = True
        self.received: deque[tuple[str, str]] = deque(maxlen=RECEIVED)
        self.counters = Counters()
        self._wanted_ports = _wanted(ports)
        self._motion = motion
        self._server: Server | None = None
        self._schedule: list[ScheduledFault] = []
        self._outbox: list[bytes] = []
        self._outbox_size = 0
        self._cycles_down = 0
        self._next_firmware = self.firmware
        self._boot()
        self.dashboard = Responder(self)
        self.faults = Faults(self, seed)

    def suited(self, firmware: str | Firmware) -> Firmware:
        """The firmware, if it goes with the model.

        UR3, UR5 and UR10 run 1.x (not the UR3, which came with CB3) and 3.x, all others 5.0 and later. In which later
        release the younger arms arrived is not looked at.

        Raises:
            BadVersion: no such firmware.
            BadValue: it does not go with the model.
        """
        parsed = Firmware.parse(firmware)
        release_of(parsed)
        if self.model.generation == "e":
            suits, needs = parsed.is_e_series, "5.0 or later"
        elif self.model.name == "UR3":
            suits, needs = not parsed.is_e_series and not parsed.is_cb2, "3.x"
        else:
            suits, needs = not parsed.is_e_series, "1.x or 3.x"
        if not suits:
            raise BadValue(f"a {self.model.name} does not run firmware {parsed}; it needs {needs}")
        return parsed

    def _boot(self) -> None:
        self.firmware = self._next_firmware
        self._uptime = 0
        self._period = 1.0 / self.firmware.rate
        self.modes = Modes(self.firmware)
        motion = self._motion or Demonstration()
        if self.cycle:
            # The arm has not moved while the controller was down, and its tool and payload are in the installation.
            before = self.arm
            motion.start(before.setpoint.q)
            self.arm = Arm(self.model, motion, self.seed)
            self.arm.tcp = before.tcp
            self.arm.payload = before.payload
            self.arm.payload_cog = before.payload_cog
            self.arm.payload_inertia = before.payload_inertia
        else:
            self.arm = Arm(self.model, motion, self.seed)
        self.programs = Programs(self)
        self.speed_fraction = 1.0
        self.flags = [False] * 64
        self.pendant.restart()
        self.stopped_since: float | None = None
        self._stop_reason = ""
        self._packets = Packets(self)
        self._announced = self.modes.safety_mode
        self.show_modes()

    # -- clock -------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Seconds since the controller started or came back from a reboot: whole cycles."""
        return self._uptime / self.firmware.rate

    @property
    def is_up(self) -> bool:
        """False while it reboots."""
        return self._cycles_down == 0

    def step(self, cycles: int = 1) -> None:
        """Advance so many controller cycles of 8 ms (CB) or 2 ms (e-Series), without thread or socket.

        Raises:
            LocalError: the controller has been started, so its own thread steps it.
        """
        if self._server is not None:
            raise LocalError("a controller that serves its ports cannot be stepped as well")
        for _ in range(cycles):
            self.advance()
            self.take_messages()

    def advance(self) -> None:
        """One cycle later. Only for the thread that owns the controller; others use `step`."""
        self.cycle += 1
        if self._schedule:
            self._happen()
        if self._cycles_down:
            self._cycles_down -= 1
            if self._cycles_down == 0:
                self._boot()
            return
        self._uptime += 1
        arm, modes, programs = self.arm, self.modes, self.programs
        programs.advance()
        arm.advance(self._period, modes.may_move and not programs.is_paused)
        self.show_modes(self._period)
        arm.is_powered = modes.is_powered
        if modes.safety_mode is not self._announced:
            self._announced = modes.safety_mode
            self.stopped_since = None if modes.stop is Stop.NONE else self.time
            reason = self._stop_reason if modes.stop is Stop.PROTECTIVE else ""
            for message in safety_messages(self, reason):
                self.say(message)
        self._stop_reason = ""

    def show_modes(self, seconds: float = 0.0) -> None:
        """Let the modes show what the arm and its program do, so many seconds after they last did."""
        self.modes.advance(seconds, self.arm.is_standing, self.arm.motion.is_program, self.programs.is_paused)

    def take_messages(self) -> list[bytes]:
        """Packages that the primary interface is to send beside its states, once each."""
        messages, self._outbox, self._outbox_size = self._outbox, [], 0
        return messages

    def go_down(self, firmware: Firmware | None, seconds: float) -> None:
        """Reboot; see `Faults.reboot`. Only for the thread that owns the controller."""
        self.programs.close()
        self._next_firmware = firmware or self.firmware
        self._cycles_down = max(1, math.ceil(seconds * self.firmware.rate))
        self.take_messages()

    # -- programs: but for `take`, only for the thread that owns the controller -----------------------

    def take(self, text: str) -> None:
        """Text that a client has sent: the lines of one or more programs, or of commands.

        From any thread. What has no `end` is thrown away, as that of a client that disconnects.
        """
        assembler = Assembler()
        programs = [program for program in map(assembler.feed, _lines(text)) if program is not None]

        def take() -> None:
            for program in programs:
                self.programs.take(program)

        self.call(take)

    def say(self, message: bytes) -> None:
        """Send a robot message to the clients of the primary interface, in this cycle."""
        self._outbox.append(message)
        self._outbox_size += len(message)

    def mention(self, make: Callable[[], bytes]) -> None:
        """Say something that is lost where this cycle has too much of it, before it is made."""
        if self._outbox_size > MOST_MESSAGES:
            self.counters.lost_messages += 1
        else:
            self.say(make())

    def stop_for(self, reason: str) -> None:
        """A protective stop, and why. Only for the thread that owns the controller."""
        self._stop_reason = reason
        self.modes.protective_stop()

    def allows(self, host: str) -> bool:
        """Whether programs may open sockets to this numeric address; those of this computer they always may."""
        return host in self.reachable or (self._server is not None and host in self._server.peers)

    @property
    def program_name(self) -> str | None:
        """Name of the program that runs or is paused, or None."""
        main = self.programs.main
        return main.name if main is not None and main.is_program else None

    # -- faults by the clock -------------------------------------------------------------------------

    def schedule(self, *faults: str | ScheduledFault) -> None:
        """Let faults happen at their times, in seconds since the controller was made: `schedule("protective_stop@5")`.

        Raises:
            BadValue: a text that `parse_fault` cannot read, or a reboot into firmware that does not go with the model.
        """
        parsed = [parse_fault(fault) if isinstance(fault, str) else fault for fault in faults]
        for fault in parsed:
            if fault.name not in FAULTS:
                raise BadValue(f"no fault is called {fault.name!r}; there are {', '.join(FAULTS)}")
            if fault.name == "reboot" and fault.arguments and fault.arguments[0] is not None:
                self.suited(fault.arguments[0])

        def schedule() -> None:
            self._schedule = sorted([*self._schedule, *parsed], key=lambda fault: fault.at)

        self.call(schedule)

    def _happen(self) -> None:
        while self._schedule and self._cycle_of(self._schedule[0]) <= self.cycle:
            fault = self._schedule.pop(0)
            try:
                fault.happen(self.faults)
            except LocalError as error:
                # Made by hand, with arguments that its method does not take; the controller goes on without it.
                _log.warning("%s did not happen: %s", fault, error)

    def _cycle_of(self, fault: ScheduledFault) -> int:
        return math.ceil(fault.at * self.firmware.rate)

    @property
    def next_fault(self) -> int | None:
        """The cycle in which the next scheduled fault happens."""
        return self._cycle_of(self._schedule[0]) if self._schedule else None

    # -- packets -------------------------------------------------------------------------------------

    def realtime_packet(self) -> bytes:
        """The real-time packet of this cycle."""
        return self._packets.realtime()

    def state_package(self, first: bool = False) -> bytes:
        """The robot state of this cycle; with `first` as a connection begins, with kinematics and configuration."""
        return self._packets.state(first)

    def greeting(self, port: str) -> list[bytes]:
        """What a connection to this port begins with, package by package: nothing on the real-time ports."""
        if interface(port) == "realtime":
            return []
        if port == "dashboard":
            return [f"{GREETING}\n".encode()]
        return [*greeting(self, interface(port)), self._packets.state(first=True)]

    # -- serving -------------------------------------------------------------------------------------

    @property
    def ports(self) -> dict[str, int]:
        """Name of each port that is served -> its number; empty until started."""
        return {} if self._server is None else dict(self._server.ports)

    @property
    def address(self) -> str:
        """What `urlink.connect` takes to reach it.

        Raises:
            LocalError: it has not been started.
        """
        if self._server is None:
            raise LocalError("a controller that has not been started has no address")
        return str(RobotAddress(self.host, self.ports))

    @property
    def is_serving(self) -> bool:
        """Started and not closed."""
        return self._server is not None

    def call(self, change: Callable[[], object]) -> None:
        """Do something to the controller between two cycles, in whichever thread owns it, and wait until it is done.

        For changes that must not fall into the middle of a cycle; from any thread.
        """
        server = self._server
        if server is None:
            change()
        else:
            server.call(change)

    def start(self) -> Self:
        """Listen on the ports and serve them from a thread. Without effect if that is so already.

        Raises:
            BadAddress: the ports cannot be listened on.
        """
        if self._server is None:
            # The one module that has sockets is imported by those who want them.
            from .server import Server

            server = Server(self, self.host, self._wanted_ports)
            server.start()
            self._server = server
        return self

    def close(self) -> None:
        """End all connections and the thread, within a second or so. Without effect if it is not started."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
            self.programs.close()
            self.take_messages()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Controller {self.model.name}, firmware {self.firmware}>"


def _lines(text: str) -> list[str]:
    return [line.removesuffix("\r") for line in text.split("\n")]


def _numeric(address: str) -> str:
    try:
        return str(ipaddress.ip_address(address))
    except ValueError:
        raise BadValue(f"a reachable address is numeric, such as 192.168.1.2, not {address!r}") from None


def _wanted(ports: str | Mapping[str, int]) -> dict[str, int]:
    if ports == "standard":
        return dict(PORTS)
    if ports == "free":
        return dict.fromkeys(PORTS, 0)
    if isinstance(ports, str) or not ports or not ports.keys() <= PORTS.keys():
        raise BadValue(f"ports are 'free', 'standard' or a mapping from {', '.join(PORTS)}; not {ports!r}")
    return dict(ports)
