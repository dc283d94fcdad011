"""Construction of the parts that command one robot: the interlock, the command channel, and the senders."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from linkcore import clock
from linkcore.errors import Closed, LocalError
from linkcore.net.undo import PendingUndos
from linkcore.streaming.flight_record import SentRecord
from linkcore.streaming.stream import Stream
from linkcore.threads import CallbackThread, MadeOnce
from linkcore.wire.fields import Since

from ..command.channel import CommandChannel
from ..command.flight_recorder import FlightRecorder
from ..command.interlock import Interlock
from ..command.interpreter import Interpreters
from ..command.io import IO
from ..command.programs import Programs
from ..command.safety import Safety
from ..command.safety_monitor import SafetyMonitor
from ..command.scripts import Scripts
from ..command.section import Section
from ..command.settings import SettingChannel, Settings
from ..protocol.dashboard.client import Dashboard
from ..protocol.gripper.client import Gripper
from ..protocol.ports import PORTS
from ..protocol.primary.robot_state import RobotState
from ..protocol.realtime.packets import RealtimeState
from ..protocol.tool_serial import ToolSerial
from ..script.wrapping import StartPlace
from ..session.address import RobotAddress
from ..session.connect_options import ConnectOptions
from ..session.identity import KnownIdentity
from .context import MotionContext
from .links.register_link import POINT_INPUTS, SETPOINT_INPUTS, PointLinks, RegisterLink, RegisterPort
from .links.reverse import ReversePort
from .motions import Motions

if TYPE_CHECKING:
    from ..rtde import Rtde

T = TypeVar("T")

#: Longest time in s to wait for the dashboard's reply whether the robot is in remote control. urlink asks this if a
#: setting was not confirmed.
_ASK_TIMEOUT = 0.5
#: First firmware of the e-Series and of PolyScope X that can report remote control.
_TELLS_CONTROL = Since("5.6/10.12")


class Control:
    """All parts of a robot object that send commands. Each connection is opened at its first use.

    Args:
        options: Options of the user. The timeout in these options also applies to the dashboard connection.
        place: Address of the controller, and the ports that the controller serves.
        peers: Keys that identify the controller and each of its services. With these keys, this process recognizes the
            controller again after the robot object was closed. Empty for a simulated controller that ends with the
            robot object.
        primary, realtime: Streams of the robot. The callbacks of the reader threads refer to the connections instead of
            the streams. Therefore a robot object without other references can be garbage-collected.
        who: Identity of the controller.
        rtde: Function that returns the RTDE object of the robot.
        sent: Record of the bytes that were sent to the robot; None for none.

    Attributes:
        safety, script, interpreters, io, motion, settings: Parts that users can access.
    """

    def __init__(
        self,
        options: ConnectOptions,
        place: RobotAddress,
        peers: Sequence[Hashable],
        primary: Stream[RobotState],
        realtime: Stream[RealtimeState],
        who: KnownIdentity,
        rtde: Callable[[], Rtde],
        sent: SentRecord | None = None,
    ) -> None:
        self._host = host = place.host
        self._ports = ports = place.ports
        self._timeout = timeout = options.timeout
        self._is_closed = False
        self._dashboard: MadeOnce[Dashboard] = MadeOnce()
        self._gripper: MadeOnce[Gripper] = MadeOnce()
        self._serial: MadeOnce[ToolSerial] = MadeOnce()
        self._callbacks = callbacks = CallbackThread(f"{options.name} callbacks")
        # Use the connections of the streams. Users have no references to the connections.
        slow, fast = primary._connection, realtime._connection
        section = Section(slow.reads_here, fast.reads_here)
        interlock = Interlock(options.require_enable, options.stale_after)
        # A person can ask for an explanation of a stop at any time, so the last seconds are always recorded.
        flight = FlightRecorder(slow.flight, fast.flight, sent, lambda: who.last)
        self._monitor = monitor = SafetyMonitor(slow, fast, interlock, section, callbacks, flight=flight)

        def keeper(channel: str) -> Callable[[bytes | memoryview], object] | None:
            return None if sent is None else partial(sent.keep, channel)

        self._undos = undos = PendingUndos.of(peers[0], host, self, *peers[1:]) if peers else PendingUndos(host)
        channel = CommandChannel(slow, monitor, section, undos=undos)
        limits = options.limits
        start_place = StartPlace(options.start_register, tuple(options.start_flags))
        self._programs = programs = Programs(
            slow,
            channel,
            monitor,
            section,
            callbacks,
            start_timeout=options.start_timeout,
            start_place=start_place,
            who=who,
            limits=limits,
        )

        def dashboard(timeout: float) -> Dashboard:
            known, api_port = lambda: who.identity.firmware, ports.get("robot_api")
            dashboard_port, on_stop = ports.get("dashboard"), monitor.overtake
            return Dashboard(
                host,
                dashboard_port,
                known,
                api_port=api_port,
                timeout=timeout,
                undos=undos,
                on_stop=on_stop,
                allow=programs.allow,
                on_send=keeper("dashboard"),
            )

        def is_remote() -> bool | None:
            """Ask over a separate connection whether the robot is in remote control; return None if unknown."""
            firmware = who.identity.firmware
            port = "robot_api" if firmware.is_polyscope_x else "dashboard"
            if port not in ports or firmware not in _TELLS_CONTROL:
                return None
            with dashboard(_ASK_TIMEOUT) as asked:
                return asked.is_in_remote_control()

        self._make_dashboard = dashboard
        self.safety = Safety(monitor)
        self.script = Scripts(programs, channel, callbacks)
        inputs = (lambda: rtde()._brief_claims()) if options.commands_via == "auto" else None

        def is_moving() -> bool:
            return programs.current is not None

        setting_channel = SettingChannel(channel, slow, section, inputs)
        self.settings = Settings(setting_channel, slow, fast, who, section, is_remote, start_place, limits, is_moving)
        self.interpreters = Interpreters(
            host,
            ports.get("interpreter"),
            programs,
            channel,
            callbacks,
            lambda: who.identity.firmware,
            undos,
            timeout,
            keeper("interpreter"),
        )
        self.io = IO(self.settings, primary, realtime)
        reverse = ReversePort(
            host, options.reverse_host, options.reverse_port, options.reverse_peer, sent=keeper("program")
        )
        registers = RegisterPort(lambda names: rtde().inputs(*names), timeout, SETPOINT_INPUTS, RegisterLink)
        links = PointLinks(lambda *names: rtde().outputs(*names))
        points = RegisterPort(lambda names: rtde().inputs(*names), timeout, POINT_INPUTS, links)
        context = MotionContext(programs, channel, realtime, who, reverse, registers, points, section, limits=limits)
        self.motion = Motions(context)

    @property
    def dashboard(self) -> Dashboard:
        """Dashboard server, or the Robot API of PolyScope X.

        Raises:
            LocalError: If a simulated controller serves neither of them.
            Closed: If the robot was closed before the first use.
        """
        if not self._ports.keys() & {"dashboard", "robot_api"}:
            raise LocalError("the controller does not serve a dashboard")
        return self._once(self._dashboard, lambda: self._make_dashboard(self._timeout))

    @property
    def gripper(self) -> Gripper:
        """Gripper on the flange.

        Raises:
            LocalError: If a simulated controller does not serve the port of a gripper.
            Closed: If the robot was closed before the first use.
        """
        if "gripper" not in self._ports:
            raise LocalError("the controller does not serve a gripper")
        hint = "a Robotiq gripper needs its URCap, which serves this port, on the controller"
        host, port = self._host, self._ports["gripper"]
        box = self._ports.get("onrobot")
        # Port 502 of a real controller is its own Modbus server, so only another port is that of a simulated gripper.
        own_box = None if box == PORTS["onrobot"] else box
        make = partial(
            Gripper, host, port, timeout=self._timeout, refused=lambda: hint, undos=self._undos, onrobot_port=own_box
        )
        return self._once(self._gripper, make)

    @property
    def tool_serial(self) -> ToolSerial:
        """Serial line in the tool connector.

        Raises:
            LocalError: If the controller has no such serial line, or if a simulated controller does not serve the port.
            Closed: If the robot was closed before the first use.
        """
        if self._serial.made is None:
            firmware = self.settings.firmware
            if not firmware.is_e_series or "tool_serial" not in self._ports:
                raise LocalError(
                    f"firmware {firmware} has no serial line in the tool connector; an e-Series 5.0 or later has one"
                )
        make = partial(ToolSerial, self._host, self._ports["tool_serial"], timeout=self._timeout)
        return self._once(self._serial, make)

    def _once(self, part: MadeOnce[T], make: Callable[[], T]) -> T:
        """Return a part of the robot, and create this part at its first use.

        Raises:
            Closed: If the robot was closed before the first use.
        """
        known = part.made
        if known is not None:
            return known
        if self._is_closed:
            raise Closed("the robot was closed")
        return part.keep(make())

    def settle(self, timeout: float) -> None:
        """Wait until all abandoned commands have been undone, for at most `timeout` seconds."""
        self._undos.settle(timeout)

    def close(self, timeout: float) -> None:
        """End motions, programs and callbacks within `timeout` seconds, and close all connections for commands."""
        until = clock.now() + timeout
        self._is_closed = True
        self._undos.close(self)
        self._programs.close(timeout)
        self._monitor.close()
        if (dashboard := self._dashboard.made) is not None:
            dashboard.close()
        self.interpreters.close()
        if (gripper := self._gripper.made) is not None:
            gripper._disconnect()
        if (serial := self._serial.made) is not None:
            serial.close()
        self._callbacks.close(clock.left(until))
