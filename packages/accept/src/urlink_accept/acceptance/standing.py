"""Stage 1: settings, programs and connections, while the arm is at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from linkcore import clock
from urlink import Cancelled, CompileError, Firmware, InputInUse, LinkError, Robot, RobotModeData
from urlink.packets import CartesianInfo, TextMessage
from urlink.rtde import INPUTS, OUTPUTS
from urlink.tools import RobotAddress, TcpTransport, tool_offset

from ..identification.exercise import SHOWS_SLIDER, slider_of
from .dashboards import answers
from .logbook import Logbook
from .person import Person

#: Texts of the programs of this stage, and sleep time of one program in s.
BEGIN, END, SLEEP = "urlink accept: begins", "urlink accept: ends", 1.0
#: Registers to write. Other clients might use the lower half, and this library uses the last registers.
_REGISTER = "input_int_register_46", "input_int_register_22"
_ECHOES = 10
#: Maximum time in s for an immediate reaction of the controller; maximum time in s for any reaction.
_SOON, _LONG = 5.0, 20.0
#: Number of packets that a client does not read from its connection. They must not fit in the buffers of the operating
#: systems, otherwise the controller does not notice the client: 2 s at 500 Hz, and 8 s at 125 Hz.
_SILENT = 1000
#: Changes of the slider, the tool and the payload, which are restored later.
_SLIDER, _TOOL, _PAYLOAD = 0.05, 0.001, 0.1
_SHOWS_PAYLOAD, _SHOWS_TCP = Firmware(5, 10), Firmware(3, 2)
#: Pause between two connections to one interface, in s; number of measured latencies; time for which a signal is kept,
#: in s.
PAUSE, _LATENCIES, _SWITCHED = 0.5, 5, 0.5
#: Queries about modes.
_MODES = ("robotmode", "safetymode", "running")

Told = Mapping[str, Any]


def stand(robot: Robot, place: RobotAddress, book: Logbook, person: Person) -> None:
    """Try all steps that move nothing. Each step notes its result. A failed step does not prevent later steps.

    Args:
        robot: Robot that was connected while the logbook was open, in remote control if it has this mode.
        place: Address with its ports.
        book: Logbook to write to.
        person: Person who switches to local control.
    """
    robot.realtime.wait(_SOON)
    robot.primary.wait(_SOON)
    steps: dict[str, Callable[[], Told]] = {
        "slider-echo": lambda: _slider(robot),
        "tcp-echo": lambda: _tcp(robot),
        "payload-echo": lambda: _payload(robot),
        "register-echo": lambda: _registers(robot),
        "claims": lambda: _claims(robot),
        "compile-error": lambda: _compile_error(robot),
        "sleep": lambda: _sleep(robot),
        "stop-program": lambda: _stop(robot),
        "reset": lambda: _reset(robot, place),
        "silent-client": lambda: _silent(robot, place),
        "latency": lambda: _latency(robot),
        "reconnect": lambda: _reconnect(robot, place),
        "connects-back": lambda: _connects_back(robot),
        "outputs": lambda: _outputs(robot, book, person),
        "inputs": lambda: _inputs(robot, book, person),
        "weight": lambda: _weight(book, person),
        "local": lambda: _local(robot, person),
        "stop-at-rest": lambda: _stop_at_rest(robot, place, book, person),
        "power-off": lambda: _power_off(robot, place, book, person),
    }
    try_each(book, steps)


def try_each(book: Logbook, steps: Mapping[str, Callable[[], Told]], between: Callable[[], object] = list) -> None:
    """Run each step, and note its result or error.

    The function `between` runs after each step. An error of `between` ends all steps.
    """
    for name, step in steps.items():
        book.note(name, event="begin")
        try:
            said = step()
        except LinkError as error:
            book.note(name, event="end", error=f"{type(error).__name__}: {error}")
        else:
            book.note(name, event="end", error=None, **said)
        between()


# -- settings --------------------------------------------------------------------------------------


def _slider(robot: Robot) -> Told:
    if robot.firmware < SHOWS_SLIDER:
        return {"skipped": "this firmware does not report its slider"}
    before = slider_of(robot)
    wanted = before - _SLIDER if before > 2 * _SLIDER else before + _SLIDER
    began = clock.now()
    try:
        robot.set_speed_slider(wanted, confirm=_SOON)
        took = clock.now() - began
        shown = slider_of(robot)
    finally:
        robot.set_speed_slider(before, confirm=_SOON)
    return {"wanted": wanted, "shown": shown, "took": took}


def _tcp(robot: Robot) -> Told:
    if robot.firmware < _SHOWS_TCP:
        return {"skipped": "this firmware does not report the TCP"}

    def tool() -> list[float]:
        offset = tool_offset(robot.primary.of(CartesianInfo).wait(_SOON))
        assert offset is not None
        return offset

    before = tool()
    wanted = [*before[:2], before[2] + _TOOL, *before[3:]]
    try:
        robot.set_tcp(wanted, confirm=_SOON)
        shown = tool()
    finally:
        robot.set_tcp(before, confirm=_SOON)
    return {"wanted": wanted, "shown": shown}


def _payload(robot: Robot) -> Told:
    if robot.firmware < _SHOWS_PAYLOAD:
        return {"skipped": "this firmware does not report the payload"}
    state = robot.realtime.wait(_SOON)
    assert state.payload_mass is not None
    assert state.payload_cog is not None
    before, cog = float(state.payload_mass), state.payload_cog.tolist()
    try:
        robot.set_payload(before + _PAYLOAD, cog, confirm=_SOON)
        shown = robot.realtime.wait(_SOON).payload_mass
    finally:
        robot.set_payload(before, cog, confirm=_SOON)
    return {"wanted": before + _PAYLOAD, "shown": shown}


# -- RTDE ------------------------------------------------------------------------------------------


def _register(robot: Robot) -> str | None:
    return next((name for name in _REGISTER if INPUTS[name].is_in(robot.firmware)), None)


def _registers(robot: Robot) -> Told:
    name = _register(robot)
    if name is None or name not in OUTPUTS:
        return {"skipped": "this firmware has no registers"}
    delays, wrong = [], []
    with robot.rtde.outputs(name) as stream, robot.rtde.inputs(name) as inputs:
        stream.start()
        for number in range(1, _ECHOES + 1):
            value = 1000 + number
            began = clock.now()
            inputs.send(**{name: value})
            try:
                stream.wait_until(lambda state, value=value: getattr(state, name) == value, 1.0)  # type: ignore[misc]
            except LinkError as error:
                wrong.append(f"{value}: {error}")
            else:
                delays.append(clock.now() - began)
    return {"register": name, "delays": delays, "wrong": wrong}


def _claims(robot: Robot) -> Told:
    name = _register(robot)
    if name is None:
        return {"skipped": "this firmware has no registers"}
    with robot.rtde.inputs(name):
        try:
            robot.rtde.inputs(name).close()
            refused = ""
        except InputInUse as error:
            refused = str(error)
    began = clock.now()
    freed = None
    while freed is None and clock.now() < began + _SOON:
        try:
            robot.rtde.inputs(name).close()
            freed = clock.now() - began
        except InputInUse:
            clock.sleep(0.02)
    held = sorted(each for each, why in robot.rtde.who_holds().items() if why == "in use")
    return {"register": name, "refused": refused, "freed": freed, "held": held}


# -- programs --------------------------------------------------------------------------------------


def _compile_error(robot: Robot) -> Told:
    began, told = clock.now(), ""
    try:
        robot.script.run("def broken():\n  x = = 1\nend").wait(_LONG)
    except CompileError as error:
        told = str(error)
    return {"told": told, "took": clock.now() - began}


def _sleep(robot: Robot) -> Told:
    source = f'def sleeps():\n  textmsg("{BEGIN} sleep")\n  sleep({SLEEP})\n  textmsg("{END} sleep")\nend'
    began = clock.now()
    program = robot.script.run(source)
    program.wait(SLEEP + _LONG)
    return {"took": clock.now() - began, "texts": program.texts}


def _stop(robot: Robot) -> Told:
    program = robot.script.run(f'def sleeps_long():\n  textmsg("{BEGIN} stop")\n  sleep(60)\nend')
    _until(lambda: f"{BEGIN} stop" in program.texts, _SOON)
    began = clock.now()
    program.cancel()
    ended = _until(lambda: not robot.primary.of(RobotModeData).wait(_SOON).is_program_running, _SOON)
    return {"took": clock.now() - began if ended else None}


def _until(condition: Callable[[], bool], seconds: float) -> bool:
    until = clock.now() + seconds
    while not condition():
        if clock.now() > until:
            return False
        clock.sleep(0.005)
    return True


# -- connections -----------------------------------------------------------------------------------


def _reset(robot: Robot, place: RobotAddress) -> Told:
    """Send a program on another connection, reset this connection, and check whether the program continues."""
    texts: list[str] = []
    with robot.primary.subscribe(lambda message: texts.append(message.text), TextMessage):
        transport = TcpTransport(place.host, place.ports["primary"], silence=_SOON)
        transport.open(_SOON)
        source = f'def goes_on():\n  textmsg("{BEGIN} reset")\n  sleep(0.5)\n  textmsg("{END} reset")\nend\n'
        transport.send(source.encode(), _SOON)
        began = _until(lambda: any(text == f"{BEGIN} reset" for text in texts), _SOON)
        transport.abort()
        ended = _until(lambda: any(text == f"{END} reset" for text in texts), _SOON)
        at = clock.now()
        transport.open(_SOON)
        transport.receive(_SOON)
        again = clock.now() - at
        transport.abort()
    return {"began": began, "ended": ended, "again": again}


def _silent(robot: Robot, place: RobotAddress) -> Told:
    """Connect to the real-time interface, and do not read from the connection for a time."""
    transport = TcpTransport(place.host, place.ports["realtime"], silence=_SOON)
    transport.open(_SOON)
    try:
        clock.sleep(_SILENT / robot.firmware.rate)
        data, _ = transport.receive(_SOON)
        return {"received": len(data), "closed": None}
    except LinkError as error:
        return {"received": 0, "closed": str(error)}
    finally:
        transport.abort()


def _reconnect(robot: Robot, place: RobotAddress) -> Told:
    """Connect to each interface twice, with a pause in between. The bytes show whether the first state is fresh."""
    for name in ("realtime", "primary", "secondary"):
        for _ in range(2):
            transport = TcpTransport(place.host, place.ports[name], silence=_SOON)
            transport.open(_SOON)
            until = clock.now() + 0.3
            while clock.now() < until:
                transport.receive(_SOON)
            transport.abort()
            clock.sleep(PAUSE)
    if OUTPUTS["timestamp"].is_in(robot.firmware):
        for _ in range(2):
            with robot.rtde.outputs("timestamp") as stream:
                stream.start()
                stream.wait(_SOON)
                clock.sleep(0.3)
            clock.sleep(PAUSE)
    return {}


def _connects_back(robot: Robot) -> Told:
    """Start a program that connects to this computer. The program gets no set-points, so it moves nothing."""
    with robot.motion.servo():
        return {}


def _latency(robot: Robot) -> Told:
    """Measure the time from sending a program to the arrival of the message that its first line sends."""
    delays = []
    for number in range(_LATENCIES):
        heard: list[float] = []
        text = f"{BEGIN} latency {number}"

        def note(message: TextMessage, text: str = text, heard: list[float] = heard) -> None:
            if message.text == text:
                heard.append(clock.now())

        with robot.primary.subscribe(note, TextMessage):
            began = clock.now()
            robot.script.run(f'def latency():\n  textmsg("{text}")\nend').wait(_LONG)
            if _until(lambda heard=heard: bool(heard), _SOON):  # type: ignore[misc]
                delays.append(heard[0] - began)
    return {"delays": delays, "tried": _LATENCIES}


# -- with a person -------------------------------------------------------------------------------------


def _outputs(robot: Robot, book: Logbook, person: Person) -> Told:
    if not person.does("outputs"):
        return {"skipped": "no person has allowed that the outputs switch"}
    for number in range(8):
        before = robot.io.digital_out(number)
        try:
            for on in (not before, before):
                robot.io.set_digital_out(number, on, confirm=None)
                clock.sleep(_SWITCHED)
                book.note("outputs", event="set", number=number, on=on)
        finally:
            robot.io.set_digital_out(number, before, confirm=None)
    return {}


def _inputs(robot: Robot, book: Logbook, person: Person) -> Told:
    if not person.does("inputs"):
        return {"skipped": "no person was there to switch the inputs"}
    for number in range(8):
        book.note("inputs", event="press", number=number)
        if not person.does("press"):
            return {"skipped": f"the person did not switch input {number}"}
        clock.sleep(_SWITCHED)
        book.note("inputs", event="pressed", number=number)
    return {}


def _weight(book: Logbook, person: Person) -> Told:
    clock.sleep(_SWITCHED)
    book.note("weight", event="told")
    if not person.does("weight"):
        return {"skipped": "no person was there to put a weight on the tool"}
    book.note("weight", event="hangs")
    clock.sleep(2.0 * _SWITCHED)
    book.note("weight", event="hung")
    person.does("no-weight")
    return {}


def _stop_at_rest(robot: Robot, place: RobotAddress, book: Logbook, person: Person) -> Told:
    if not person.does("stop-at-rest"):
        return {"skipped": "no person has caused a stop"}
    clock.sleep(_SWITCHED)
    _ask_during(robot, place, book, "stop-at-rest")
    if not person.does("unlock"):
        raise Cancelled("no person has unlocked the protective stop")
    robot.safety.wait_until_clear(_LONG)
    return {}


def _power_off(robot: Robot, place: RobotAddress, book: Logbook, person: Person) -> Told:
    if robot.firmware < SHOWS_SLIDER or not person.does("power-off"):
        return {"skipped": "no person has allowed that the arm is powered off"}
    robot.dashboard.power_off()
    try:
        _until(lambda: not robot.primary.of(RobotModeData).wait(_SOON).is_power_on, _SOON)
        clock.sleep(_SWITCHED)
        _ask_during(robot, place, book, "power-off")
    finally:
        robot.dashboard.start(_LONG + _LONG)
    return {}


def _ask_during(robot: Robot, place: RobotAddress, book: Logbook, step: str) -> None:
    """Ask the dashboard for the modes, and note the answers together with the time for which the modes are steady."""
    book.note(step, event="asks")
    for asked, reply, error in answers(robot, place, _MODES):
        book.note(step, event="answer", asked=asked, reply=reply, problem=error)
    clock.sleep(0.2)
    book.note(step, event="asked")


def _local(robot: Robot, person: Person) -> Told:
    if not robot.firmware.is_e_series:
        return {"skipped": "this generation has no local control that refuses programs"}
    if not person.does("local"):
        return {"skipped": "no person has switched to local control"}
    began = clock.now()
    try:
        robot.script.run(f'def in_local():\n  textmsg("{BEGIN} local")\nend').wait(_LONG)
        return {"refused": ""}
    except LinkError as error:
        return {"refused": str(error), "took": clock.now() - began}
    finally:
        person.does("remote")
