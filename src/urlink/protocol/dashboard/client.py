"""Client behind `robot.dashboard`: power, programs, popups and modes.

It connects to the dashboard server (port 29999). PolyScope X has no dashboard server, so there it uses the Robot API
(port 80).
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

from linkcore import clock
from linkcore.errors import BadValue, Closed, LinkTimeout, LocalError, PacketError
from linkcore.names import StrictAttributes
from linkcore.net.dialogue import Dialogue
from linkcore.net.http_client import HttpClient
from linkcore.net.transport import TcpTransport
from linkcore.net.undo import PendingUndos, Undo
from linkcore.threads import Closing
from linkcore.wire.fields import version_text

from ..enums import RobotMode, RobotModeCB2, SafetyMode
from ..firmware import Firmware
from ..ports import PORTS, refusal_hint, service_of
from .commands import COMMANDS, NOT_IN_REMOTE_CONTROL, DashboardRefused, FlightReport, OperationalMode, UserRole
from .protocol import (
    DashboardProtocol,
    ProgramStatus,
    SavedProgram,
    command_line,
    encode_line,
    parse_is_program_saved,
    parse_loaded_program,
    parse_operational_mode,
    parse_program_state,
    parse_robot_mode,
    parse_safety_mode,
    parse_text,
    parse_truth,
    parse_user_role,
)
from .robot_api import RobotApi
from .stored_programs import StoredProgram

#: Interval for polling the robot mode while the arm starts, in seconds.
_POLL = 0.2
#: Maximum time, in seconds, from the command to switch off until the arm is no longer reported as running.
_OFF_WITHIN = 5.0
#: Commands that do not wait while another thread is waiting for a reply.
_STOPS = ("stop", "pause", "power off")

# Beginning of the reply after which a new connection is necessary.
_NOT_ALLOWED = NOT_IN_REMOTE_CONTROL.partition(" due to ")[0].casefold()


class Dashboard(StrictAttributes, Closing):
    """Client of the dashboard server of one controller, or of the Robot API of PolyScope X.

    Both have the same methods, as far as the firmware supports them. The Robot API uses one connection for each
    request. The following paragraphs about connections apply to the dashboard server.

    The client connects when it is first used, and reconnects if the connection was lost between two commands. A command
    that might have reached the controller is never sent a second time. If the reply to a command does not arrive, the
    connection is closed, the call raises `LinkTimeout` or `ConnectionLost`, and the next command uses a new connection.
    The client also reconnects after a refusal in local mode, because the controller requires it. Threads may share the
    client; they take turns. If another thread is waiting for a reply, `stop`, `pause` and `power_off` use a second
    connection, and do not wait.

    **The controller might still execute a command that failed in this way**, for example when it resumes after a hang.
    The error message contains this warning. Of these commands, only `play` is undone: urlink sends `stop` at the next
    contact and before any other command, unless another program has been sent since. The undo remains pending for the
    life of the process: after `close`, the next `Dashboard` or robot of `connect` at this controller sends it. No other
    command is undone: power, brakes and the loaded program stay as the controller leaves them.

    All methods that contact the controller raise

    - `LocalError` if the firmware does not have the command, and `BadValue` if an argument cannot be sent; in both
      cases, nothing is sent;
    - `DashboardRefused` if the controller does not execute the command, for example an e-Series in local mode;
    - `LinkTimeout` if the controller does not answer in time, or if an abandoned `play` could not be undone yet;
    - `ConnectFailed` and `ConnectionLost` if the controller cannot be reached, `WrongPeer` if another service answers,
      and `PacketError` if a reply cannot be parsed;
    - `Closed` after `close`;
    - the errors that `firmware` raises.

    Args:
        host: Host name or address of the controller.
        port: Port of the dashboard server, 29999 on a real controller; None if it is not served.
        firmware: Function that returns the firmware of the controller. It is called before each command, because the
            firmware might have changed in between.
        api_port: Port of the Robot API, 80 on a real controller; None if it is not served.
        timeout: Maximum time to connect, and for the reply to a command, in seconds. Slow commands have more time; see
            `COMMANDS`.
        undos: Pending undos of the commands to this controller. If None, use the undos that all objects in this process
            share for the controller.
        on_stop: Function that is called before each command that stops or pauses the arm. Its argument is the reason,
            used in messages.
        allow: Function that is called before each command that might start a program. Its argument is the name of the
            method, such as "dashboard.play". If the function raises, nothing is sent.
        on_send: Function that is called with each command that was sent; None for none.

    Raises:
        BadValue: If the timeout is not positive.
    """

    def __init__(
        self,
        host: str,
        port: int | None,
        firmware: Callable[[], Firmware],
        *,
        api_port: int | None = PORTS["robot_api"],
        timeout: float = 5.0,
        undos: PendingUndos | None = None,
        on_stop: Callable[[str], object] = lambda why: None,
        allow: Callable[[str], object] = lambda kind: None,
        on_send: Callable[[bytes | memoryview], object] | None = None,
    ) -> None:
        self._allow = allow
        self._on_stop = on_stop
        self._on_send = on_send
        self._timeout = _positive(timeout)
        self._host = host
        self._firmware = firmware
        self._port = port
        self._api_port = api_port

        def refused() -> str:
            return refusal_hint(firmware())

        self._http = HttpClient(host, api_port or 0, refused=refused)
        self._api = RobotApi(self._http, timeout)
        self._transport = TcpTransport(host, port or 0, silence=timeout, refused=refused)
        self._transport.sent = on_send
        self._name = f"the dashboard server at {self._transport.name}"
        self._dialogue = Dialogue(self._transport, DashboardProtocol, self._name, timeout)
        # Second connection for commands that must not wait for the reply to another command; connects when needed.
        stopping = TcpTransport(host, port or 0, silence=timeout, refused=refused)
        stopping.sent = on_send
        self._stopping = Dialogue(stopping, DashboardProtocol, self._name, timeout)
        self._shares_undos = undos is None
        service = service_of(host, (api_port or 0) if port is None else port)
        self._undos = PendingUndos.of(service, self._name, self) if undos is None else undos
        self._switched_off = -math.inf

    # -- power ---------------------------------------------------------------------------------------

    def start(self, timeout: float = 30.0) -> None:
        """Power the arm on, release its brakes, and wait until it runs. **The arm might move** as the brakes release.

        This method does not unlock a stop: after a protective stop, the arm runs, but cannot move before
        `unlock_protective_stop`. On CB2, a person starts the arm at the pendant. Later controllers might require a
        person to confirm the safety settings first.

        Raises:
            LinkTimeout: If the arm does not run after `timeout` seconds. The error contains the robot mode and the
                safety mode.
            LocalError: If the controller is a CB2, which has no command to power the arm on.
            DashboardRefused: If the controller refuses, for example an e-Series in local mode.
        """
        until = clock.now() + _positive(timeout)
        if self._present().is_cb2:
            raise LocalError("a CB2 controller has no command to power the arm on; start the arm at the pendant")
        next_step = {RobotMode.POWER_OFF: "power on", RobotMode.IDLE: "brake release"}
        while True:
            mode = self.robot_mode()
            # After the command to switch off, the controller reports the arm as running until the arm is at rest.
            if mode == RobotMode.RUNNING and clock.now() - self._switched_off > _OFF_WITHIN:
                return
            if mode != RobotMode.RUNNING:
                self._switched_off = -math.inf
            left = until - clock.now()
            if left <= 0:
                raise LinkTimeout(
                    f"the arm is not running after {timeout:g} s: robot mode {mode.name}, "
                    f"safety mode {self.safety_mode().name}"
                )
            # Send each step once: if a person switches the arm off while it starts, it stays off.
            step = next_step.pop(RobotMode(mode), None)
            if step is not None:
                self._do(step)
            clock.sleep(min(_POLL, left))

    def power_on(self) -> None:
        """Begin to power the arm on, up to IDLE with locked brakes. `start` also releases the brakes, and waits."""
        self._do("power on")

    def power_off(self) -> None:
        """Begin to switch the arm off. The arm comes to rest first."""
        self._on_stop("the dashboard switched the arm off")
        self._do("power off")
        self._switched_off = clock.now()

    def brake_release(self) -> None:
        """Begin to release the brakes. **The arm might move.** An arm that is off is powered on first.

        If no reply arrives, the controller might still execute the command. It is not undone.
        """
        self._do("brake release")

    def shutdown(self) -> None:
        """Shut the controller down and switch it off."""
        self._on_stop("the dashboard shut the controller down")
        self._do("shutdown", is_last=True)

    # -- programs ------------------------------------------------------------------------------------

    def load(self, path: str) -> None:
        """Load a program that is stored on the controller, such as `"pick.urp"`.

        On firmware 3.2 or earlier, the controller replies before the program is loaded. On firmware 3.4 or later, it
        replies after the installation of the program is loaded, too.
        """
        self._do("load", path)

    def load_installation(self, path: str) -> None:
        """Load an installation that is stored on the controller, such as `"default.installation"`."""
        self._do("load installation", path)

    def play(self) -> None:
        """Run the loaded program, or resume it. **The arm moves.**

        If no reply arrives, the controller might still execute the command; see `Dashboard`.
        """
        self._allow("dashboard.play")
        self._do("play")

    def pause(self) -> None:
        """Pause the running program."""
        self._on_stop("the dashboard paused the program")
        self._do("pause")

    def stop(self) -> None:
        """Stop the running program."""
        self._on_stop("the dashboard stopped the program")
        self._do("stop")

    def running(self) -> bool:
        """Return whether a program is running."""
        return parse_truth("running", self._do("running"))

    def program_state(self) -> ProgramStatus:
        """Return whether the program is stopped, playing or paused, and its name."""
        return parse_program_state(self._do("programState"))

    def loaded_program(self) -> str | None:
        """Return the path of the loaded program; None if no program is loaded."""
        return parse_loaded_program(self._do("get loaded program"))

    def is_program_saved(self) -> SavedProgram:
        """Return whether the loaded program was saved after its last change, and its name."""
        return parse_is_program_saved(self._do("isProgramSaved"))

    def programs(self) -> tuple[StoredProgram, ...]:
        """Return the programs on the controller (PolyScope X 10.12 or later)."""
        return self._api.programs(self._with_programs())

    def upload_program(self, path: str | os.PathLike[str], *, replace: bool = False) -> str | None:
        """Store a program file (.urpx) of this computer on the controller (PolyScope X 10.12 or later).

        Args:
            path: Path of the file.
            replace: Whether to replace a program that exists on the controller. If False, the program must be new.

        Returns:
            Name that the controller reports for the program, used to load it; None if it reports no name.

        Raises:
            BadValue: If the file cannot be read.
        """
        firmware, file = self._with_programs(), Path(path)
        try:
            content = file.read_bytes()
        except OSError as error:
            raise BadValue(f"cannot read {file}: {error.strerror or error}") from error
        with self._command("upload") as given_up:
            return self._api.upload(file.name, content, bool(replace), firmware, given_up)

    def download_program(self, name: str) -> bytes:
        """Return the content of a program on the controller, as it is sent (PolyScope X 10.12 or later)."""
        return self._api.download(name, self._with_programs())

    # -- safety --------------------------------------------------------------------------------------

    def robot_mode(self) -> RobotMode | RobotModeCB2:
        """Return the robot mode. CB2 has its own list of modes."""
        return parse_robot_mode(self._do("robotmode"), self._present().is_cb2)

    def safety_mode(self) -> SafetyMode:
        """Return the safety mode."""
        return parse_safety_mode("safetymode", self._do("safetymode"))

    def safety_status(self) -> SafetyMode:
        """Return the safety mode like `safety_mode`, but distinguish more kinds of stops."""
        return parse_safety_mode("safetystatus", self._do("safetystatus"))

    def unlock_protective_stop(self) -> None:
        """Let the arm move again after a protective stop. **Find the cause of the stop first.**

        The controller refuses it in the first five seconds of the stop.
        """
        self._do("unlock protective stop")

    def restart_safety(self) -> None:
        """Restart the safety system after a fault or a violation. The arm is switched off afterwards."""
        self._do("restart safety")

    def is_in_remote_control(self) -> bool:
        """Return whether an e-Series accepts commands that move or power the arm."""
        return parse_truth("is in remote control", self._do("is in remote control"))

    def operational_mode(self) -> OperationalMode:
        """Return the operational mode; `"none"` if no password for the operational mode was set."""
        return parse_operational_mode(self._do("get operational mode"))

    def set_operational_mode(self, mode: Literal["manual", "automatic"]) -> None:
        """Set the operational mode, and block the pendant from changing it until `clear_operational_mode`."""
        self._do("set operational mode", mode)

    def clear_operational_mode(self) -> None:
        """Let the pendant control the operational mode again."""
        self._do("clear operational mode")

    def user_role(self) -> UserRole:
        """Return the user role, which sets the permissions of the user at the pendant of a CB3."""
        return parse_user_role(self._do("getUserRole"))

    def set_user_role(self, role: UserRole) -> None:
        """Set the user role, which sets the permissions of the user at the pendant of a CB3."""
        self._do("setUserRole", role)

    # -- pendant -------------------------------------------------------------------------------------

    def popup(self, text: str) -> None:
        """Show a message on the pendant."""
        self._do("popup", text)

    def close_popup(self) -> None:
        """Close the message on the pendant."""
        self._do("close popup")

    def close_safety_popup(self) -> None:
        """Close a message of the safety system."""
        self._do("close safety popup")

    def add_to_log(self, text: str) -> None:
        """Add a line to the controller's log."""
        self._do("addToLog", text)

    # -- identity ------------------------------------------------------------------------------------

    def polyscope_version(self) -> str:
        """Return the version and date of the software, such as `"5.4.0.76837 (Jul 30 2019)"`."""
        return parse_text("PolyscopeVersion", self._do("PolyscopeVersion"))

    def version(self) -> str:
        """Return the version of the software, four numbers."""
        return parse_text("version", self._do("version"))

    def serial_number(self) -> str:
        """Return the serial number of the robot."""
        return parse_text("get serial number", self._do("get serial number"))

    def robot_model(self) -> str:
        """Return the name of the arm without its generation, such as `"UR5"`."""
        return parse_text("get robot model", self._do("get robot model"))

    # -- reports -------------------------------------------------------------------------------------

    def generate_flight_report(self, kind: FlightReport = "system") -> str:
        """Write a flight report, and return its id. This takes up to three minutes.

        PolyScope X has no kinds of report, and its reply is not known. The id is empty then.
        """
        reply = self._do("generate flight report", kind)
        return parse_text("generate flight report", reply) if reply else ""

    def generate_support_file(self, directory: str) -> str:
        """Write a support file to a directory of the controller, and return its name. This takes up to ten minutes."""
        return parse_text("generate support file", self._do("generate support file", directory))

    def save_log(self) -> None:
        """Write the controller's log to its disk."""
        self._do("saveLog")

    # -- the connection --------------------------------------------------------------------------------

    def send(self, command: str, timeout: float | None = None) -> str:
        """Send any command and return the reply without checking it, for commands that have no method here.

        Args:
            command: One line of text, without a line end.
            timeout: Maximum time for the reply, in seconds; by default the timeout of the dashboard.
        """
        firmware = self._present()
        if firmware.is_polyscope_x:
            raise LocalError(f"firmware {firmware} is PolyScope X, which has no dashboard server for send()")
        self._check_served(self._port, "dashboard server")
        encode_line(command)
        self._check_allowed(command.strip().casefold())
        within = self._timeout if timeout is None else _positive(timeout)

        def stays(reply: str) -> bool:
            return not reply.casefold().startswith(_NOT_ALLOWED)

        with self._command(command.strip().casefold()) as given_up:
            return self._dialogue.ask(command, within, stays, given_up=given_up)

    def _check_allowed(self, command: str) -> None:
        """Ask whether a line may be sent. A known query and a stop need no permission."""
        known = COMMANDS.get(command)
        if command not in _STOPS and not (known is not None and known.only_asks):
            self._allow("dashboard.play" if command == "play" else "dashboard.send")

    def quit(self) -> None:
        """Send the command to quit, and disconnect. The next command connects again."""
        self._do("quit", is_last=True)

    def close(self) -> None:
        """Disconnect permanently. If another thread is waiting for a reply, its call raises `Closed`. Idempotent."""
        if self._shares_undos:
            self._undos.close(self)
        self._http.close()
        self._dialogue.close()
        self._stopping.close()

    def __repr__(self) -> str:
        return f"<Dashboard {self._transport.name}>"

    def _present(self) -> Firmware:
        """Return the current firmware of the controller; raise `Closed` after `close`."""
        if self._dialogue.is_closed:
            raise Closed(f"{self._name} was closed")
        return self._firmware()

    def _with_programs(self) -> Firmware:
        """Return the firmware if its Robot API has programs; raise `LocalError` otherwise."""
        firmware = self._present()
        if not firmware.is_polyscope_x:
            raise LocalError(
                f"firmware {firmware} has a dashboard server, which cannot list or store programs; the "
                "Robot API of PolyScope X is required"
            )
        self._check_served(self._api_port, "Robot API")
        return firmware

    def _check_served(self, port: int | None, what: str) -> None:
        if port is None:
            raise LocalError(f"the controller has no {what}")

    def _do(self, name: str, argument: str | None = None, *, is_last: bool = False) -> str:
        """Execute one command of `COMMANDS`, and return the reply."""
        command, firmware = COMMANDS[name], self._present()
        if firmware.is_polyscope_x:
            self._check_served(self._api_port, "Robot API")
            if self._on_send is not None:
                self._on_send(name.encode())
            with self._command(name, command.only_asks) as given_up:
                return self._api.do(name, argument, firmware, given_up)
        self._check_served(self._port, "dashboard server")
        if not command.is_on(firmware):
            first = command.first(firmware)
            generation = "e-Series" if firmware.is_e_series else "CB2 or CB3"
            which = f"{version_text(first)} or later is required" if first else f"no {generation} controller has it"
            raise LocalError(f"firmware {firmware} has no dashboard command {name!r}; {which}")
        line = command_line(command, argument)

        def stays(reply: str) -> bool:
            # In local mode, the controller requires a new connection. An unknown reply might belong to another command.
            return not is_last if command.match(reply) else command.is_refusal(reply)

        with self._command(name, command.only_asks) as given_up:
            dialogue = self._stopping if name in _STOPS and self._dialogue.is_busy else self._dialogue
            reply = dialogue.ask(line, max(self._timeout, command.slow), stays, given_up=given_up)
        if command.match(reply) is None:
            raise DashboardRefused(line, reply)
        return reply

    def _command(
        self, name: str, only_asks: bool = False
    ) -> contextlib.AbstractContextManager[Callable[[], None] | None]:
        """Surround a command. Yields a function to call if the command was sent and abandoned; None for a query."""
        if only_asks:
            return contextlib.nullcontext()
        undo = None
        if name == "play":
            undos = PendingUndos(self._name)  # a separate one, so that `stop` does not wait for a pending undo
            host, port, api = self._host, self._port, self._api_port
            another = partial(Dashboard, host, port, self._firmware, api_port=api, timeout=self._timeout, undos=undos)
            undo = Undo(another, _stop_what_plays)
        return self._undos.command(name, self._timeout, undo)


def _stop_what_plays(dashboard: Dashboard, is_wanted: Callable[[], bool]) -> None:
    """Undo `play`."""
    if not is_wanted():
        return
    # Any reply counts as contact.
    with contextlib.suppress(DashboardRefused, PacketError):
        if dashboard._present().is_polyscope_x:
            dashboard.program_state()
        else:
            dashboard.robot_mode()
    if is_wanted():
        with contextlib.suppress(DashboardRefused):  # no program runs
            dashboard.stop()


def _positive(timeout: float) -> float:
    if not 0 < timeout < threading.TIMEOUT_MAX:
        raise BadValue(f"timeout={timeout!r}; expected a positive number of seconds")
    return timeout
