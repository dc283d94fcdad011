"""Dashboard server of a simulated controller, which replies to each line with one line.

For facts and their evidence, see docs/protocols/dashboard.md. `urlink.protocol.dashboard.commands` contains the
commands of each firmware, and the form of the replies. The commands change the state of the controller, or use its
pendant. The following behaviour is assumed:

- The replies to an unknown command, to a command that this firmware lacks, and to a command with an unexpected
  argument.
- The reply to a command whose required text is missing, except the replies to `addToLog` and `setUserRole`.
- A command that has nothing to do gets the usual reply. Examples are `power on` while the power is on, `close popup`
  without a popup, and `unlock protective stop` without a stop.
- During an emergency stop, `power on` and `brake release` get a positive reply, although they have no effect.
- If `power on` or `brake release` arrives before `power off` is complete, the command is executed after `power off`.
- A paused program does not count as running, and a program that is being stopped counts as stopped.
- A CB2 controller sends `Robotmode: ` before the number of the mode.
- The date of the software, and the ids and file names of reports. Reports are complete immediately.
- `shutdown` only stops the program and switches the arm off. The simulated controller keeps running.
"""

from __future__ import annotations

from collections.abc import Callable

from urlink.protocol.dashboard.commands import (
    COMMANDS,
    COULD_NOT_UNDERSTAND,
    GREETING,
    NOT_IN_REMOTE_CONTROL,
    DashboardCommand,
)
from urlink.protocol.enums import ProgramState

from ..programs.pendant import Pendant
from ..robot.modes import StopState
from ..state import ControllerState
from .interface import Interface, InterfaceClient, LineReceiver

#: Time after which a protective stop can be unlocked, in seconds.
UNLOCK_AFTER = 5.0
#: Maximum number of lines in the log.
LOG_LINES = 1000

_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking"
)
_STATES = {
    ProgramState.PLAYING: "PLAYING",
    ProgramState.RESUMING: "PLAYING",
    ProgramState.PAUSING: "PAUSED",
    ProgramState.PAUSED: "PAUSED",
}
_UNNAMED = "<unnamed>"

# The longest names come first, so that `load installation` is not read as `load` with an argument.
_BY_LENGTH = sorted(COMMANDS.values(), key=lambda command: -len(command.name))


class DashboardInterface(Interface):
    """Dashboard server of one controller, which replies to the lines of all clients.

    Args:
        state: State of the controller.
        pendant: Teach pendant of the controller, which loads, plays, pauses and stops programs.

    Attributes:
        user_role: Role of the user on the pendant of a CB3, in lower case.
        operational_mode: Operational mode of an e-Series, in lower case.
        installation: Path of the installation that was loaded last, or None.
    """

    def __init__(self, state: ControllerState, pendant: Pendant) -> None:
        self._state = state
        self._pendant = pendant
        self._reports = 0
        self.user_role = "none"
        self.operational_mode = "none"
        self.installation: str | None = None
        # Each command has a method with the same name. If a method is missing, fail here rather than when the command
        # arrives.
        self._actions: dict[str, Callable[[str], str | None]] = {
            name: getattr(self, f"_{name.replace(' ', '_').lower()}") for name in COMMANDS
        }

    def is_offered(self) -> bool:
        return not self._state.firmware.is_polyscope_x

    def greeting(self) -> list[bytes]:
        return [f"{GREETING}\n".encode()]

    def receiver(self, client: InterfaceClient) -> LineReceiver:
        def answer(line: str) -> None:
            reply = self.reply(line)
            client.send(b"Disconnected\n" if reply is None else f"{reply}\n".encode())
            if reply is None:
                client.finish()

        return LineReceiver(client, self._state.counters, answer)

    def reply(self, line: str) -> str | None:
        """Return the reply to a line, without its line ending.

        None means that the caller must send `Disconnected` and close the connection. According to the vendor, upper and
        lower case are equivalent.
        """
        # Only a newline ends a line on the wire. Replace all other line separators, so that the reply is one line.
        text = " ".join(line.splitlines()).strip()
        found = _find(text)
        if found is None or not found[0].is_on(self._state.firmware):
            return _not_understood(text)
        command, argument = found
        return self.carry_out(command.name, argument)

    def carry_out(self, name: str, argument: str) -> str | None:
        """Execute a command of `COMMANDS` by its name, and return the reply; see `reply`.

        It is not checked whether the current firmware has this command.
        """
        if COMMANDS[name].needs_remote_control and self._state.is_local:
            return NOT_IN_REMOTE_CONTROL
        return self._actions[name](argument)

    # -- power ---------------------------------------------------------------------------------------

    def _power_on(self, _: str) -> str:
        self._state.modes.power_on(release_brakes=False)
        return "Powering on"

    def _power_off(self, _: str) -> str:
        self._state.modes.power_off()
        return "Powering off"

    def _brake_release(self, _: str) -> str:
        self._state.modes.power_on(release_brakes=True)
        return "Brake releasing"

    def _shutdown(self, _: str) -> str:
        self._pendant.stop()
        self._state.modes.power_off()
        return "Shutting down"

    def _quit(self, _: str) -> None:
        return None

    # -- programs ------------------------------------------------------------------------------------

    def _load(self, path: str) -> str:
        return f"Loading program: {path}" if path and self._pendant.load(path) else f"File not found: {path}"

    def _load_installation(self, path: str) -> str:
        if not path:
            return "File not found: "
        self.installation = path
        return f"Loading installation: {path}"

    def _play(self, _: str) -> str:
        return "Starting program" if self._pendant.play() else "Failed to execute: play"

    def _pause(self, _: str) -> str:
        return "Pausing program" if self._pendant.pause() else "Failed to execute: pause"

    def _stop(self, _: str) -> str:
        # Reply "Stopped" even if no program runs: two public clients send `stop` in this case, and treat any other
        # reply as a failure.
        self._pendant.stop()
        return "Stopped"

    def _running(self, _: str) -> str:
        return f"Program running: {_truth(self._program_state == 'PLAYING')}"

    def _programstate(self, _: str) -> str:
        return f"{self._program_state} {self._program}"

    def _isprogramsaved(self, _: str) -> str:
        return f"{_truth(self._state.loaded is not None)} {self._program}"

    def _get_loaded_program(self, _: str) -> str:
        path = self._state.loaded
        return "No program loaded" if path is None else f"Loaded program: {path}"

    @property
    def _program_state(self) -> str:
        return _STATES.get(self._state.modes.program_state, "STOPPED")

    @property
    def _program(self) -> str:
        path = self._state.loaded
        return _UNNAMED if path is None else path.rpartition("/")[2]

    # -- safety --------------------------------------------------------------------------------------

    def _robotmode(self, _: str) -> str:
        mode = self._state.modes.robot_mode
        return f"Robotmode: {int(mode) if self._state.firmware.is_cb2 else mode.name}"

    def _safetymode(self, _: str) -> str:
        return f"Safetymode: {self._state.modes.safety_mode.name}"

    def _safetystatus(self, _: str) -> str:
        return f"Safetystatus: {self._state.modes.safety_mode.name}"

    def _unlock_protective_stop(self, _: str) -> str:
        state = self._state
        if state.modes.stop is StopState.PROTECTIVE:
            since = state.stopped_since
            # If `since` is None, the stop has just begun, and no cycle has processed it yet. On PolyScope X, clients do
            # not have to wait.
            is_early = since is None or state.time - since < UNLOCK_AFTER
            if is_early and not state.firmware.is_polyscope_x:
                return _TOO_EARLY
            state.modes.clear()
        state.popup = None
        return "Protective stop releasing"

    def _restart_safety(self, _: str) -> str:
        modes = self._state.modes
        if modes.stop is StopState.PROTECTIVE:
            modes.clear()
        modes.power_off()
        return "Restarting safety"

    def _is_in_remote_control(self, _: str) -> str:
        return _truth(self._state.remote_control)

    def _get_operational_mode(self, _: str) -> str:
        return self.operational_mode.upper()

    def _set_operational_mode(self, mode: str) -> str:
        if mode.lower() not in COMMANDS["set operational mode"].choices:
            return _not_understood(f"set operational mode {mode}")
        self.operational_mode = mode.lower()
        return f"Operational mode {mode.upper()} is set"

    def _clear_operational_mode(self, _: str) -> str:
        self.operational_mode = "none"
        return "No longer controlling the operational mode. Current operational mode: 'NONE'."

    def _getuserrole(self, _: str) -> str:
        return self.user_role.upper()

    def _setuserrole(self, role: str) -> str:
        role = role or "none"
        if role.lower() not in COMMANDS["setUserRole"].choices:
            return f"Failed setting user role: {role}"
        self.user_role = role.lower()
        return f"Setting user role: {role}"

    # -- pendant -------------------------------------------------------------------------------------

    def _popup(self, text: str) -> str:
        self._state.popup = text
        return "showing popup"

    def _close_popup(self, _: str) -> str:
        self._state.popup = None
        return "closing popup"

    def _close_safety_popup(self, _: str) -> str:
        return "closing safety popup"

    def _addtolog(self, text: str) -> str:
        if not text:
            return "No log message to add"
        log = self._state.log
        log.append(text)
        del log[:-LOG_LINES]
        return "Added log message"

    # -- identity, and reports -------------------------------------------------------------------------

    def _polyscopeversion(self, _: str) -> str:
        return f"URSoftware {self._version('')} (Jan 01 2024)"

    def _version(self, _: str) -> str:
        return ".".join(map(str, self._state.firmware))

    def _get_serial_number(self, _: str) -> str:
        return self._state.serial

    def _get_robot_model(self, _: str) -> str:
        return self._state.model.name.removesuffix("e")

    def _generate_flight_report(self, kind: str) -> str:
        # The vendor's own client sends no kind of report. It is assumed that the controller then makes a report of the
        # system.
        if kind and kind.lower() not in COMMANDS["generate flight report"].choices:
            return _not_understood(f"generate flight report {kind}")
        self._reports += 1
        return f"Flight Report generated with id: {self._reports}"

    def _generate_support_file(self, directory: str) -> str:
        self._reports += 1
        return f"Completed successfully: {directory.rstrip('/')}/ur_{self._state.serial}_{self._reports}.zip"

    def _savelog(self, _: str) -> str:
        return "Log saved to disk"


def _find(text: str) -> tuple[DashboardCommand, str] | None:
    """Return the command at the beginning of a line, and its argument.

    Return None if the line begins with no command, or if the line has an argument that the command does not take.
    """
    for command in _BY_LENGTH:
        name, rest = text[: len(command.name)], text[len(command.name) :]
        if name.lower() == command.name.lower() and (not rest or rest.startswith(" ")):
            argument = rest.strip()
            return None if argument and not command.argument else (command, argument)
    return None


def _not_understood(text: str) -> str:
    # Shorten the text, so that the reply is a short line even if the client has sent a long one.
    return f"{COULD_NOT_UNDERSTAND}: '{text[:200]}'"


def _truth(is_true: bool) -> str:
    return "true" if is_true else "false"
