"""`urlink doctor`: checks a controller, the network and this computer, and suggests how to fix problems."""

from __future__ import annotations

import argparse
import itertools
import math
import statistics
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

from linkcore import clock
from linkcore.cli.options import argument, command, seconds
from linkcore.cli.progress import ProgressBar
from linkcore.errors import BadValue, ConnectFailed, LinkError, LinkTimeout, RemoteError
from linkcore.net.transport import TcpTransport, is_unknown_host
from linkcore.streaming.stream import Stream
from linkcore.text import printable, strict_json
from linkcore.wire.cycles import Missing

from ..protocol.enums import RobotMode, RobotModeCB2, SafetyMode
from ..protocol.firmware import RELEASES, Firmware
from ..protocol.primary.robot_state import RobotModeData, RobotState
from ..protocol.realtime.packets import RealtimeState
from ..robot import Robot, connect
from ..rtde import OUTPUTS
from ..session.address import RecordingAddress, RobotAddress, SimulatorAddress, parse_address
from .options import ADDRESS
from .packet_stream import Tap

#: Purpose of each port that should be open.
_PORTS = {
    "primary": "states, messages, programs",
    "secondary": "states, programs",
    "realtime": "states at the full rate",
    "rtde": "variables, registers, the speed slider",
    "dashboard": "power, brakes, installed programs",
}

#: Delay of a wake-up of this computer, in seconds: largest delay that is ok, and smallest delay that is bad. A cycle of
#: a servo loop at 500 Hz has only 2 ms.
_LATE_OK, _LATE_BAD = 0.001, 0.01

#: Limit of the longest gap between packets: the mean gap, plus this number of periods.
_JITTER = 1.5


class Finding(NamedTuple):
    """One line of output: state, checked item, observation, and remedy."""

    state: str  # "ok", "look" or "BAD"
    topic: str
    seen: str
    remedy: str = ""


@command(
    "doctor",
    "check a robot, the network and this computer",
    *ADDRESS,
    argument("--duration", type=seconds, default=2.0, metavar="S", help="receive packets for S seconds (default: 2)"),
    argument("--json", action="store_true", help="print one JSON object per line"),
)
def run(args: argparse.Namespace) -> int:
    """Check a controller, the network to it and this computer, and print problems.

    Each check prints one line: "ok", "look" for something that may be intended, or "BAD" for something that does not
    work, with a remedy. Nothing is moved or switched. Each free RTDE input is claimed for a few milliseconds to find
    out whether another client has claimed it. If another client tries to claim the input at that moment, the
    controller refuses this claim.

    examples:
      urlink doctor 192.168.56.101
      urlink doctor sim:// --duration 1
      urlink doctor 192.168.56.101 --json
    """
    is_bad = False
    with ProgressBar(f"checking {args.address}", args.quiet) as progress:
        for finding in _findings(args.address, args.connect_timeout, args.duration, progress):
            if args.json:
                print(strict_json(finding._asdict()), flush=True)
            else:
                remedy = f"; {finding.remedy}" if finding.remedy else ""
                print(f"{finding.state:4}  {finding.topic:13}  {printable(finding.seen + remedy)}", flush=True)
            is_bad |= finding.state == "BAD"
    return int(is_bad)


def _findings(address: str, timeout: float, duration: float, progress: ProgressBar) -> Iterator[Finding]:
    place = parse_address(address)
    if isinstance(place, RecordingAddress):
        raise BadValue(f"{address} is a recording; doctor needs a running controller")
    yield _scheduling()
    progress(text=f"connecting to {address}")
    if isinstance(place, SimulatorAddress):
        with connect(address, timeout=timeout) as robot:
            served_at = parse_address(robot.controller.address)
            assert isinstance(served_at, RobotAddress), "a simulator that has been started is at ports of this computer"
            yield from _expected(_ports(served_at, timeout, progress), robot)
            yield from _of_robot(robot, duration, progress)
        return
    try:
        open_ports = list(_ports(place, timeout, progress))
    except ConnectFailed as error:
        remedy = "check the spelling and the network's name server, or use the IP address shown on the pendant"
        reason = getattr(error.__cause__, "strerror", None) or error.__cause__
        yield Finding("BAD", "host", f"{place.host} is unknown ({reason})", remedy)
        return
    progress(text=f"connecting to {address}")
    try:
        robot = connect(address, timeout=timeout)
    except RemoteError as error:
        yield from open_ports
        remedy = "check that the controller is on, and that this is its address"
        if any(finding.state == "ok" for finding in open_ports):
            remedy = "the primary or secondary interface must be open, because it identifies the controller"
        yield Finding("BAD", "controller", str(error), remedy)
        return
    with robot:
        yield from _expected(open_ports, robot)
        yield from _of_robot(robot, duration, progress)


def _expected(ports: Iterable[Finding], robot: Robot) -> Iterator[Finding]:
    """Yield the findings about ports. A closed port is ok if this generation of controllers does not have the port."""
    for finding in ports:
        if finding.state == "BAD" and finding.seen.startswith("rtde") and not _has_rtde(robot):
            yield Finding("ok", finding.topic, "rtde: closed; controllers before 3.3 have none")
        else:
            yield finding


def _has_rtde(robot: Robot) -> bool:
    return OUTPUTS["timestamp"].is_in(robot.firmware)


def _of_robot(robot: Robot, duration: float, progress: ProgressBar) -> Iterator[Finding]:
    looks: list[Callable[[Robot], Iterator[Finding]]] = [_identity, _modes, _stop, _remote_control, _inputs]
    for look in looks:
        progress(text=f"checking the {_topic(look)}")
        try:
            yield from look(robot)
        except LinkError as error:
            yield Finding("look", _topic(look), f"could not be checked: {error}")
    yield from _packets(robot, duration, progress)


def _topic(look: Callable[[Robot], Iterator[Finding]]) -> str:
    return look.__name__.strip("_").replace("_", " ")


# -- this computer ---------------------------------------------------------------------------------


def _scheduling() -> Finding:
    """Measure how late a thread wakes up that sleeps for 1 ms. A loop at 500 Hz needs a short delay."""
    late = []
    for _ in range(200):
        due = clock.now() + 0.001
        clock.sleep(0.001)
        late.append(clock.now() - due)
    worst, median = max(late), statistics.median(late)
    seen = f"woken {median * 1e3:.2f} ms late (median), {worst * 1e3:.2f} ms at worst (200 sleeps)"
    if clock.RESOLUTION > _LATE_OK:
        return Finding("BAD", "computer", "the clock is coarser than 1 ms", "timing is not reliable on this computer")
    if worst > _LATE_BAD:
        return Finding(
            "look", "computer", seen, "set-points may be late: stop other programs, or use a servo rate of 125 Hz"
        )
    return Finding("ok", "computer", seen)


# -- the network -----------------------------------------------------------------------------------


def _ports(place: RobotAddress, timeout: float, progress: ProgressBar) -> Iterator[Finding]:
    """Check whether each port is open.

    Raises:
        ConnectFailed: If the host is unknown.
    """
    for name, purpose in _PORTS.items():
        port = place.ports[name]
        progress(text=f"connecting to port {port} ({name})")
        transport = TcpTransport(place.host, port, silence=timeout)
        began = clock.now()
        try:
            transport.open(timeout)
        except LinkTimeout:
            yield Finding("BAD", f"port {port}", f"{name}: no answer", "check the address, the route and firewalls")
        except ConnectFailed as error:
            if is_unknown_host(error):
                raise  # every port would report the same error
            remedy = f"needed for {purpose}; check whether the service is switched off (Settings, Security, Services)"
            yield Finding("BAD", f"port {port}", f"{name}: {error}", remedy)
        else:
            took = clock.now() - began
            yield Finding("ok", f"port {port}", f"{name}: open, {took * 1e3:.1f} ms to connect")
        finally:
            transport.abort()


# -- the robot -------------------------------------------------------------------------------------


def _identity(robot: Robot) -> Iterator[Finding]:
    identity = robot.identity
    seen = f"{identity.model or 'unknown arm'}, firmware {identity.firmware}"
    if not identity.said_so:
        yield Finding("look", "controller", seen, "the firmware is inferred from the sizes of its packages")
    elif identity.firmware[:2] > (newest := _newest(identity.firmware))[:2]:
        remedy = f"newer than {newest}, the newest known firmware: added data are kept, but not decoded"
        yield Finding("look", "controller", seen, remedy)
    else:
        yield Finding("ok", "controller", seen)


def _newest(firmware: Firmware) -> Firmware:
    """Return the newest known firmware of the same generation that is not newer than `firmware`."""
    return [row.since for row in RELEASES if row.since.major <= firmware.major][-1]


def _modes(robot: Robot) -> Iterator[Finding]:
    modes = robot.primary.of(RobotModeData).wait(2.0)
    running = RobotModeCB2.RUNNING if robot.firmware.is_cb2 else RobotMode.RUNNING
    if modes.robot_mode == running:
        yield Finding("ok", "robot mode", modes.robot_mode.name)
    else:
        remedy = "switch it on with robot.dashboard.start(), or at the pendant"
        yield Finding("look", "robot mode", modes.robot_mode.name, remedy)
    state = robot.realtime.wait(2.0)
    safety = state.safety_mode if state.safety_status is None else state.safety_status
    if safety is None:
        is_stopped = modes.is_emergency_stopped or modes.is_protective_stopped
        yield Finding("BAD" if is_stopped else "ok", "safety", "stopped" if is_stopped else "not stopped")
    elif safety in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        yield Finding("ok", "safety", safety.name)
    else:
        yield Finding("BAD", "safety", safety.name, "the arm cannot move until a person has cleared this")
    if modes.is_program_running:
        yield Finding("look", "program", "a program is running", "a motion from this computer would end it")
    else:
        yield Finding("ok", "program", "no program is running")


def _stop(robot: Robot) -> Iterator[Finding]:
    """Explain the active stop, or a stop during this check."""
    if robot.safety.cause is None:
        return
    found = robot.safety.explain()
    if found is not None:
        seen = str(found).rstrip(".")
        lacking = f" (missing: {'; '.join(found.missing)})" if found.missing else ""
        remedy = found.cause.remedy.rstrip(".")
        yield Finding("BAD", "stop", seen + lacking, remedy[:1].lower() + remedy[1:])


def _remote_control(robot: Robot) -> Iterator[Finding]:
    if not robot.firmware.is_e_series:
        yield Finding("ok", "control", "this generation accepts commands without remote control")
    elif robot.dashboard.is_in_remote_control():
        yield Finding("ok", "control", "remote: programs and commands are accepted")
    else:
        remedy = "programs and commands are ignored without an error: switch to remote control on the pendant"
        yield Finding("BAD", "control", "local", remedy)


def _inputs(robot: Robot) -> Iterator[Finding]:
    if not _has_rtde(robot):
        return
    held = sorted(name for name, why in robot.rtde.who_holds().items() if why == "in use")
    if held:
        remedy = "another RTDE client, a URCap or a fieldbus must release them before this computer can write them"
        names = ", ".join(held if len(held) <= 6 else [*held[:3], "...", *held[-2:]])
        yield Finding("look", "inputs", f"{len(held)} in use: {names}", remedy)
    else:
        yield Finding("ok", "inputs", "no RTDE input is in use")


def _packets(robot: Robot, duration: float, progress: ProgressBar) -> Iterator[Finding]:
    looks: tuple[tuple[str, int, Stream[Any], type], ...] = (
        ("realtime", robot.firmware.rate, robot.realtime, RealtimeState),
        ("primary", 10, robot.primary, RobotState),
    )
    for name, rate, stream, kind in looks:
        before = stream.stats
        progress(text=f"listening to {name} for {duration:g} s")
        try:
            with Tap(stream, kind) as tap:
                arrivals = [packet.received.monotonic for packet in tap.packets(duration=duration)]
        except LinkError as error:
            yield Finding("BAD", f"{name} data", str(error))
            continue
        periods = [later - earlier for earlier, later in itertools.pairwise(arrivals)]
        if not periods:
            yield Finding("BAD", f"{name} data", f"{len(arrivals)} packets in {duration:g} s", "expected more")
            continue
        mean, longest = statistics.fmean(periods), max(periods)
        spread = statistics.pstdev(periods)
        seen = (
            f"{1 / mean if mean else math.inf:.1f} Hz of {rate}, longest gap {longest * 1e3:.1f} ms, "
            f"jitter {spread * 1e3:.2f} ms ({len(arrivals)} packets)"
        )
        stats = stream.stats
        missed = (stats.missed or 0) - (before.missed or 0)
        if missed:
            lost = Missing(missed, stats.gaps - before.gaps, stats.longest_gap)
            seen += f"; {lost.text(stats.received - before.received)} by its own clock"
        if mean * rate > 1.05:
            yield Finding(
                "BAD", f"{name} data", seen, "packets are missing: the network, or this computer, is too slow"
            )
        elif missed:
            yield Finding("look", f"{name} data", seen, "the controller did not send them, or the network was delayed")
        elif longest > mean + _JITTER * max(1 / rate, 0.01):
            yield Finding("look", f"{name} data", seen, "such gaps make streamed set-points late")
        else:
            yield Finding("ok", f"{name} data", seen)
