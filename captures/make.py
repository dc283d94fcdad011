"""Record the samples in this folder from the project's simulator, and write their golden files.

    python captures/make.py                 # missing recordings, and the golden file of each recording
    python captures/make.py --golden-only   # only the golden files of all existing recordings

A golden file contains the first, the middle and the last packet of each class, as returned by `to_dict()`.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import urlink
from linkcore.recording.file import RecordingFile
from linkcore.wire.packet import State
from urlink.protocol.firmware import LAST_CB2, LAST_CB3, NEWEST, Firmware
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.protocol.realtime.protocol import RealtimeProtocol

FOLDER = Path(__file__).parent

#: One firmware for each generation of layouts. Recordings of earlier newest releases stay in the folder.
FIRMWARE = (str(LAST_CB2), "3.4", "3.10", str(LAST_CB3), "5.4", "5.9", "5.11", str(NEWEST))


def packets(path: Path, interface: str) -> list[State]:
    """Return every packet of one interface in a recording, decoded like in a stream."""
    recording = RecordingFile(path)
    channel = recording.channel(interface)
    session: Any = RealtimeProtocol() if interface == "realtime" else PrimaryProtocol()
    found: list[State] = []
    for record in recording:
        if record.channel == channel and record.kind.name == "BYTES":
            found += [session.decode(frame) for frame in session.framer.feed(record.payload)]
    return found


def golden(path: Path) -> dict[str, Any]:
    """Return the content of a golden file: channels, and counts and packets of each class."""
    told: dict[str, Any] = {"channels": {}, "packets": {}}
    for info in RecordingFile(path).channels.values():
        name = info["name"]
        told["channels"][name] = {key: info.get(key) for key in ("address", "firmware", "model")}
        classes: dict[str, list[State]] = {}
        for packet in packets(path, name):
            classes.setdefault(type(packet).__name__, []).append(packet)
        told["packets"][name] = {
            kind: {
                "count": len(found),
                "first": told_of(found[0]),
                "middle": told_of(found[len(found) // 2]),
                "last": told_of(found[-1]),
            }
            for kind, found in classes.items()
        }
    return told


def told_of(packet: State) -> dict[str, Any]:
    """Return the size of a packet, and its `to_dict()` in the form of JSON."""
    plain: dict[str, Any] = json.loads(json.dumps(packet.to_dict()))
    return {"bytes": len(bytes(packet)), "fields": plain}


def golden_of(path: Path) -> Path:
    """Return the path of the golden file of a recording."""
    return path.with_suffix(".golden.json")


def record(path: Path, firmware: str) -> None:
    """Record about a hundred real-time packets, and the primary interface during the same time."""
    e_series = Firmware.parse(firmware).is_e_series
    with urlink.connect(f"sim://{'UR5e' if e_series else 'UR5'}?firmware={firmware}&motion=demo") as robot:
        assert robot.controller is not None
        robot.controller.signals.set_digital_input(2, True)
        robot.controller.signals.set_digital_output(5, True)
        wanted = 120 if e_series else 80
        with robot.record(path):
            robot.realtime.wait()
            while robot.realtime.stats.received < wanted or robot.primary.stats.received < 5:
                robot.realtime.wait()
            robot.controller.faults.protective_stop()
            # A message and a state that report the stop.
            robot.primary.of(urlink.packets.SafetyModeMessage if e_series else urlink.packets.RobotState).wait()
            robot.primary.wait()


def main() -> None:
    """Make the requested files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--golden-only", action="store_true", help="write only the golden files")
    options = parser.parse_args()
    if not options.golden_only:
        for firmware in FIRMWARE:
            path = FOLDER / f"simulator-{firmware}.urlog"
            if not path.exists():
                record(path, firmware)
    for path in sorted(FOLDER.glob("*.urlog")):
        golden_of(path).write_text(json.dumps(golden(path), indent=1) + "\n")


if __name__ == "__main__":
    main()
