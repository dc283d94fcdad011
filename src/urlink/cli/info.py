"""`urlink info`: identifies a controller, and shows known facts about its firmware."""

from __future__ import annotations

import argparse
import textwrap
from typing import Any

from linkcore.cli.options import argument, command
from linkcore.cli.progress import ProgressBar
from linkcore.text import printable, strict_json

from ..protocol.firmware import release_of
from ..protocol.primary.robot_state import SUB_PACKAGES
from ..recording.recording import load
from ..robot import Robot
from ..session.address import RecordingAddress, RobotAddress, SimulatorAddress, parse_address
from .options import ADDRESS, connected


@command(
    "info", "identify a controller", *ADDRESS, argument("--json", action="store_true", help="print one JSON object")
)
def run(args: argparse.Namespace) -> int:
    """Identify a controller: print its firmware and arm, and known facts about this firmware.

    Sizes and rates are from the matching row of the firmware table; `evidence` is the source of that row. If a
    controller does not send its version, the firmware is the oldest that sends packages of the same sizes, and is
    marked as inferred. For a recording, the output also lists the missing parts.

    examples:
      urlink info 192.168.56.101
      urlink info 'sim://ur10?firmware=3.4'
      urlink info replay:///tmp/run.urlog --json
    """
    with connected(args) as robot:
        answer = _facts(robot, args.quiet)
    if args.json:
        print(strict_json(answer))
        return 0
    source = "reported by the controller" if answer["firmware_is_said"] else "inferred from the sizes of its packages"
    sizes = answer["sizes"]
    parts = ", ".join(f"{name} {size}" for name, size in sizes["sub_packages"].items())
    print(f"address     {printable(answer['address'])}")
    print(f"firmware    {answer['firmware']} ({source})")
    print(f"model       {printable(answer['model'] or 'not reported by the controller')}")
    print(f"real-time   {sizes['realtime']} bytes, {answer['realtime_rate']} Hz")
    print(f"state       {sizes['first_state']} bytes, the first of a connection; then {sizes['state']} bytes, 10 Hz")
    print(textwrap.fill(parts, 100, initial_indent=" " * 12, subsequent_indent=" " * 12))
    print(f"table row   firmware {answer['release']} and later")
    print(f"evidence    {answer['evidence']}")
    for each in answer["missing"]:
        print(f"missing     {printable(each)}")
    if answer["ports"]:
        ports = ", ".join(f"{name} {port}" for name, port in answer["ports"].items())
        print(textwrap.fill(ports, 100, initial_indent="ports       ", subsequent_indent=" " * 12))
    return 0


def _facts(robot: Robot, quiet: bool) -> dict[str, Any]:
    identity = robot.identity
    release = release_of(identity.firmware)
    return {
        "address": robot.address,
        "firmware": str(identity.firmware),
        "firmware_is_said": identity.said_so,
        "model": identity.model,
        "realtime_rate": identity.firmware.rate,
        "release": str(release.since),
        "evidence": release.evidence,
        "sizes": {
            "realtime": release.realtime,
            "first_state": release.first_state_size,
            "state": release.state_size,
            "sub_packages": {_name(kind, size): size for kind, size in release.state.items()},
        },
        "ports": _ports(robot),
        "missing": _missing(robot, quiet),
    }


def _missing(robot: Robot, quiet: bool) -> tuple[str, ...]:
    """Return the missing parts of a recording; empty for a controller."""
    place = parse_address(robot.address)
    if not isinstance(place, RecordingAddress):
        return ()
    with ProgressBar(f"reading {place.path}", quiet) as progress:
        return load(place.path, progress=progress).missing


def _name(kind: int, size: int) -> str:
    """Return the name of a sub-package. If its type number has two meanings, the size decides."""
    for part in SUB_PACKAGES[kind]:
        if size >= min(layout.size for layout in part.LAYOUTS.all):
            return part.__name__
    return str(kind)


def _ports(robot: Robot) -> dict[str, int]:
    place = parse_address(robot.address)
    if isinstance(place, SimulatorAddress) and robot.controller is not None:
        return dict(robot.controller.ports)
    return dict(place.ports) if isinstance(place, RobotAddress) else {}
