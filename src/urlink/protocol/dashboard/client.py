"""`robot.dashboard`: power, programs, popups and modes.

It speaks to the dashboard server (port 29999), and on PolyScope X, which has none, to the Robot API (port 80).
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

#: Seconds between two looks at the robot mode while it starts.
_POLL = 0.2
#: Seconds within which an arm no longer runs after the command to switch off.
_OFF_WITHIN = 5.0
#: Commands that do not wait while another thread waits for its reply.
_STOPS = ("stop", "pause", "power off")

# The beginning of the reply after which a controller wants to be connected to anew.
_NOT_ALLOWED = NOT_IN_REMOTE_CONTROL.partition(" due to ")[0].casefold()


class Dashboard(StrictAttributes, Closing):
    """A client of the dashboard server of one controller, or of the Robot API of PolyScope X.

    Both have the same methods, as far as the firmware supports them. The Robot API has a connection for each request;
    the following about connections holds for the dashboard server.

    Connects at first use, and again where a connection was lost between two commands. A command that may have reached
    the controller is never sent a second time: where the reply does not come, the connection is closed, a
    `LinkTimeout` or `ConnectionLost` is raised, and the next command begins on a new connection. A new one is also made
    after the refusal in local mode, since the controller requires it. Threads may share it; they take turns. If another
    thread waits for its reply, `stop`, `pause` and `power_off` use a second connection, and do not wait.

    **A command that failed so may still be carried out**, when a controller that hung goes on; the error says so. Of
    these, `play` is undone, by `stop`, at the first contact and before another command is sent, unless another
    program has been sent since. That is owed for the life of the process: after `close` the next `Dashboard` or robot
    of `connect` at this controller undoes it. Nothing else is: power, brakes and what was loaded are as the
    controller leaves them.

    All methods that talk to the controller raise

    - `LocalError` where the firmware does not have the command, and `BadValue` for an argument that cannot be sent;
      nothing has been sent then;
    - `DashboardRefused` where the controller does not carry it out, as an e-Series does in local mode;
    - `LinkTimeout` where it does not answer in time, or where a `play` that was given up could not be undone yet;
      `ConnectFailed` and `ConnectionLost` where it is not there,
      `WrongPeer` where another service is, and `PacketError` where an answer cannot be read;
    - `Closed` after `close`;
    - what `firmware` raises.

    Args:
        host: name or address.
        port: of the dashboard server, 29999 on a real controller; None where it is not served.
        firmware: returns the controller's firmware; called before each command, since it may have changed in between.
        api_port: of the Robot API, 80 on a real controller; None where it is not served.
        timeout: seconds to connect, and for the reply to a command. Those that take longer have more: `COMMANDS` says
            how much.
        undos: of the commands to this controller; None to share that of everything in this process that commands it.
        on_stop: Called before each command that stops or pauses the arm, with the reason, for messages.

    Raises:
        BadValue: the timeout is not positive.
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
    ) -> None:
        self._on_stop = on_stop
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
        self._name = f"the dashboard server at {self._transport.name}"
        self._dialogue = Dialogue(self._transport, DashboardProtocol, self._name, timeout)
        # Another connection for what must not wait for the reply to another command; made if it is needed.
        stopping = TcpTransport(host, port or 0, silence=timeout, refused=refused)
        self._stopping = Dialogue(stopping, DashboardProtocol, self._name, timeout)
        self._shares_undos = undos is None
        service = service_of(host, (api_port or 0) if port is None else port)
        self._undos = PendingUndos.of(service, self._name, self) if undos is None else undos
        self._switched_off = -math.inf

    # -- power ---------------------------------------------------------------------------------------

    def start(self, timeout: float = 30.0) -> None:
        """Power the arm on and release its brakes; returns when it runs. **The arm may move** as the brakes release.

        It does not unlock a stop: an arm in a protective stop runs, and does not move before `unlock_protective_stop`.
        On CB2 the arm is started by a person at the pendant; later controllers may want one to confirm the safety
        settings first.

        Raises:
            LinkTimeout: it does not run after `timeout` seconds; says how far it got.
            LocalError: CB2 has no command for it.
            DashboardRefused: the controller does not want to, as an e-Series in local mode.
        """
        until = clock.now() + _positive(timeout)
        if self._present().is_cb2:
            raise LocalError("a CB2 controller cannot be told to power the arm on; start the arm at the pendant")
        next_step = {RobotMode.POWER_OFF: "power on", RobotMode.IDLE: "brake release"}
        while True:
            mode = self.robot_mode()
            # After the command to switch off, the arm is still reported as running while it comes to rest.
            if mode == RobotMode.RUNNING and clock.now() - self._switched_off > _OFF_WITHIN:
                return
            if mode != RobotMode.RUNNING:
                self._switched_off = -math.inf
            left = until - clock.now()
            if left <= 0:
                raise LinkTimeout(
                    f"the arm does not run after {timeout:g} s: robot mode {mode.name}, "
                    f"safety mode {self.safety_mode().name}"
                )
            # Each step once: if a person switches the arm off while it starts, it stays off.
            step = next_step.pop(RobotMode(mode), None)
            if step is not None:
                self._do(step)
            clock.sleep(min(_POLL, left))

    def power_on(self) -> None:
        """Begin to power the arm on; it arrives in IDLE with its brakes locked. `start` does all of it, and waits."""
        self._do("power on")

    def power_off(self) -> None:
        """Begin to switch the arm off; it comes to rest first."""
        self._on_stop("the dashboard switched the arm off")
        self._do("power off")
        self._switched_off = clock.now()

    def brake_release(self) -> None:
        """Begin to release the brakes. **The arm may move.** Powers it on first if it is off.

        If no answer comes, it may still be carried out, and is not undone.
        """
        self._do("brake release")

    def shutdown(self) -> None:
        """Shut the controller down and switch it off."""
        self._on_stop("the dashboard shut the controller down")
        self._do("shutdown", is_last=True)

    # -- programs ------------------------------------------------------------------------------------

    def load(self, path: str) -> None:
        """Load a program of the controller's, such as `"pick.urp"`.

        Up to 3.2 the controller answers before it has been loaded, and from 3.4 on after its installation is too.
        """
        self._do("load", path)

    def load_installation(self, path: str) -> None:
        """Load an installation of the controller's, such as `"default.installation"`."""
        self._do("load installation", path)

    def play(self) -> None:
        """Run the loaded program, or go on with it. **The arm moves.**

        If no answer comes, it may still be carried out; see `Dashboard`.
        """
        self._do("play")

    def pause(self) -> None:
        """Pause the program that runs."""
        self._on_stop("the dashboard paused the program")
        self._do("pause")

    def stop(self) -> None:
        """Stop the program that runs."""
        self._on_stop("the dashboard stopped the program")
        self._do("stop")

    def running(self) -> bool:
        """Whether a program runs."""
        return parse_truth("running", self._do("running"))

    def program_state(self) -> ProgramStatus:
        """Whether the program is stopped, plays or is paused, and its name."""
        return parse_program_state(self._do("programState"))

    def loaded_program(self) -> str | None:
        """Path of the loaded program; None if there is none."""
        return parse_loaded_program(self._do("get loaded program"))

    def is_program_saved(self) -> SavedProgram:
        """Whether the loaded program has been saved since it was changed, and its name."""
        return parse_is_program_saved(self._do("isProgramSaved"))

    def programs(self) -> tuple[StoredProgram, ...]:
        """The programs on the controller; from 10.12 on (PolyScope X)."""
        return self._api.programs(self._with_programs())

    def upload_program(self, path: str | os.PathLike[str], *, replace: bool = False) -> str | None:
        """Store a program of this computer's, a file of PolyScope X (.urpx), on the controller; from 10.12 on.

        Args:
            path: of the file.
            replace: the program is there, and is replaced; otherwise it is a new one.

        Returns:
            the name that the controller says it has, by which it is loaded; None where it does not say so.

        Raises:
            BadValue: the file cannot be read.
        """
        firmware, file = self._with_programs(), Path(path)
        try:
            content = file.read_bytes()
        except OSError as error:
            raise BadValue(f"cannot read {file}: {error.strerror or error}") from error
        with self._command("upload") as given_up:
            return self._api.upload(file.name, content, bool(replace), firmware, given_up)

    def download_program(self, name: str) -> bytes:
        """A program on the controller, as the controller sends it; from 10.12 on (PolyScope X)."""
        return self._api.download(name, self._with_programs())

    # -- safety --------------------------------------------------------------------------------------

    def robot_mode(self) -> RobotMode | RobotModeCB2:
        """The robot mode; CB2 has a list of its own."""
        return parse_robot_mode(self._do("robotmode"), self._present().is_cb2)

    def safety_mode(self) -> SafetyMode:
        """The safety mode."""
        return parse_safety_mode("safetymode", self._do("safetymode"))

    def safety_status(self) -> SafetyMode:
        """As `safety_mode`, with finer names for the stops."""
        return parse_safety_mode("safetystatus", self._do("safetystatus"))

    def unlock_protective_stop(self) -> None:
        """Let the arm move again after a protective stop. **Look what caused the stop first.**

        Refused in the first five seconds of the stop.
        """
        self._do("unlock protective stop")

    def restart_safety(self) -> None:
        """Restart the safety system after a fault or violation, which leaves the arm switched off."""
        self._do("restart safety")

    def is_in_remote_control(self) -> bool:
        """Whether an e-Series takes commands that move or power the arm."""
        return parse_truth("is in remote control", self._do("is in remote control"))

    def operational_mode(self) -> OperationalMode:
        """The operational mode; `"none"` where no password for it was set."""
        return parse_operational_mode(self._do("get operational mode"))

    def set_operational_mode(self, mode: Literal["manual", "automatic"]) -> None:
        """Set the operational mode, and keep the pendant from changing it until `clear_operational_mode`."""
        self._do("set operational mode", mode)

    def clear_operational_mode(self) -> None:
        """Leave the operational mode to the pendant again."""
        self._do("clear operational mode")

    def user_role(self) -> UserRole:
        """What the pendant of a CB3 lets its user do."""
        return parse_user_role(self._do("getUserRole"))

    def set_user_role(self, role: UserRole) -> None:
        """Set what the pendant of a CB3 lets its user do."""
        self._do("setUserRole", role)

    # -- pendant -------------------------------------------------------------------------------------

    def popup(self, text: str) -> None:
        """Show a message on the pendant."""
        self._do("popup", text)

    def close_popup(self) -> None:
        """Close the message."""
        self._do("close popup")

    def close_safety_popup(self) -> None:
        """Close a message of the safety system."""
        self._do("close safety popup")

    def add_to_log(self, text: str) -> None:
        """Add a line to the controller's log."""
        self._do("addToLog", text)

    # -- who it is -----------------------------------------------------------------------------------

    def polyscope_version(self) -> str:
        """Version and date of the software, such as `"5.4.0.76837 (Jul 30 2019)"`."""
        return parse_text("PolyscopeVersion", self._do("PolyscopeVersion"))

    def version(self) -> str:
        """Version of the software, four numbers."""
        return parse_text("version", self._do("version"))

    def serial_number(self) -> str:
        """Serial number of the robot."""
        return parse_text("get serial number", self._do("get serial number"))

    def robot_model(self) -> str:
        """Name of the arm without its generation, such as `"UR5"`."""
        return parse_text("get robot model", self._do("get robot model"))

    # -- reports -------------------------------------------------------------------------------------

    def generate_flight_report(self, kind: FlightReport = "system") -> str:
        """Write a flight report, which takes up to three minutes; returns its id.

        PolyScope X knows no kinds, and what it answers is not known here: the id is empty then.
        """
        reply = self._do("generate flight report", kind)
        return parse_text("generate flight report", reply) if reply else ""

    def generate_support_file(self, directory: str) -> str:
        """Write a support file to a directory of the controller's, which takes up to ten minutes; returns its name."""
        return parse_text("generate support file", self._do("generate support file", directory))

    def save_log(self) -> None:
        """Write the controller's log to its disk."""
        self._do("saveLog")

    # -- the connection --------------------------------------------------------------------------------

    def send(self, command: str, timeout: float | None = None) -> str:
        """Send any command and return the reply, whatever it says; for what has no method here.

        Args:
            command: one line of text, without its end.
            timeout: seconds for the reply; by default that of the dashboard.
        """
        firmware = self._present()
        if firmware.is_polyscope_x:
            raise LocalError(f"firmware {firmware} is PolyScope X, which has no dashboard server that takes lines")
        self._check_served(self._port, "dashboard server")
        encode_line(command)
        within = self._timeout if timeout is None else _positive(timeout)

        def stays(reply: str) -> bool:
            return not reply.casefold().startswith(_NOT_ALLOWED)

        with self._command(command.strip().casefold()) as given_up:
            return self._dialogue.ask(command, within, stays, given_up=given_up)

    def quit(self) -> None:
        """Take leave of the controller and disconnect; the next command connects again."""
        self._do("quit", is_last=True)

    def close(self) -> None:
        """Disconnect for good; a command of another thread that waits for its reply ends with `Closed`. Idempotent."""
        if self._shares_undos:
            self._undos.close(self)
        self._http.close()
        self._dialogue.close()
        self._stopping.close()

    def __repr__(self) -> str:
        return f"<Dashboard {self._transport.name}>"

    def _present(self) -> Firmware:
        """What runs on the controller at present; raises `Closed` after `close`."""
        if self._dialogue.is_closed:
            raise Closed(f"{self._name} was closed")
        return self._firmware()

    def _with_programs(self) -> Firmware:
        """What runs there, if it is asked for its programs over the Robot API."""
        firmware = self._present()
        if not firmware.is_polyscope_x:
            raise LocalError(
                f"firmware {firmware} has a dashboard server, which neither lists nor takes programs; the Robot API of "
                "PolyScope X does"
            )
        self._check_served(self._api_port, "Robot API")
        return firmware

    def _check_served(self, port: int | None, what: str) -> None:
        if port is None:
            raise LocalError(f"the controller serves no {what}")

    def _do(self, name: str, argument: str | None = None, *, is_last: bool = False) -> str:
        """Have one command of the table carried out; returns the reply."""
        command, firmware = COMMANDS[name], self._present()
        if firmware.is_polyscope_x:
            self._check_served(self._api_port, "Robot API")
            with self._command(name, command.only_asks) as given_up:
                return self._api.do(name, argument, firmware, given_up)
        self._check_served(self._port, "dashboard server")
        if not command.is_on(firmware):
            first = command.first(firmware)
            generation = "e-Series" if firmware.is_e_series else "CB2 or CB3"
            which = f"the first that has it is {version_text(first)}" if first else f"no {generation} controller has it"
            raise LocalError(f"firmware {firmware} has no dashboard command {name!r}; {which}")
        line = command_line(command, argument)

        def stays(reply: str) -> bool:
            # In local mode the controller wants to be connected to anew; and what is not a known reply may be the
            # reply to something else.
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
        """Around a command; the context is what to call if it was sent and given up, None for a question."""
        if only_asks:
            return contextlib.nullcontext()
        undo = None
        if name == "play":
            undos = PendingUndos(self._name)  # with it, `stop` waits for nothing that is to be undone
            host, port, api = self._host, self._port, self._api_port
            another = partial(Dashboard, host, port, self._firmware, api_port=api, timeout=self._timeout, undos=undos)
            undo = Undo(another, _stop_what_plays)
        return self._undos.command(name, self._timeout, undo)


def _stop_what_plays(dashboard: Dashboard, is_wanted: Callable[[], bool]) -> None:
    """Take `play` back."""
    if not is_wanted():
        return
    # Any answer is the contact.
    with contextlib.suppress(DashboardRefused, PacketError):
        if dashboard._present().is_polyscope_x:
            dashboard.program_state()
        else:
            dashboard.robot_mode()
    if is_wanted():
        with contextlib.suppress(DashboardRefused):  # nothing runs
            dashboard.stop()


def _positive(timeout: float) -> float:
    if not 0 < timeout < threading.TIMEOUT_MAX:
        raise BadValue(f"a timeout is a positive number of seconds, not {timeout!r}")
    return timeout
