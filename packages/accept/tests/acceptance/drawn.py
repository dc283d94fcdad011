"""Defects that are drawn by a seed: a field, a transformation, and the interfaces that send the changed field.

``python -m packages.accept.tests.acceptance drawn --seed 44 --runs 102`` plants them in the bytes that sound simulated
controllers have sent, and prints a table. A defect is found if a requirement is not held. Its cause is named if one of
the likely causes on the page names the field, by the name of either interface, and the transformation. Defects that do
not change a single byte of the sound run cannot be found, and are drawn again.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import urlink
from linkcore.clock import Stamp
from urlink.protocol.realtime.packets import RealtimeState
from urlink.protocol.rtde.recipes import Recipe
from urlink_accept.acceptance.causes import likely_causes
from urlink_accept.acceptance.evidence import Evidence
from urlink_accept.acceptance.report import Verdict, judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.acceptance.stages import run

from .defects import later, planted_copy

Values = NDArray[np.float64]
FIRMWARES = ("3.15", "5.11", "10.12")
SEED = 44

#: Field of the real-time interface -> variable of RTDE.
_FIELDS: Mapping[str, str] = {
    "q_actual": "actual_q",
    "q_target": "target_q",
    "qd_actual": "actual_qd",
    "qd_target": "target_qd",
    "I_actual": "actual_current",
    "I_target": "target_current",
    "M_target": "target_moment",
    "tool_vector_actual": "actual_TCP_pose",
    "tcp_speed_actual": "actual_TCP_speed",
    "tcp_force": "actual_TCP_force",
    "tool_accelerometer": "actual_tool_accelerometer",
    "motor_temperatures": "joint_temperatures",
    "V_actual": "actual_joint_voltage",
    "speed_scaling": "speed_scaling",
    "robot_mode": "robot_mode",
    "safety_mode": "safety_mode",
    "digital_output_bits": "actual_digital_output_bits",
    "digital_input_bits": "actual_digital_input_bits",
}
_DISCRETE = ("robot_mode", "safety_mode", "digital_output_bits", "digital_input_bits")


class _Change(NamedTuple):
    """Change of the values of one packet, from the values and the first values of the connection; and its words."""

    of: Callable[[Values, Values], Any]
    words: tuple[str, ...]


_STUCK = ("frozen", "stays the same", "constant", "a constant is added")
#: For a mode, the wrong and the right number are the cause; for a digital signal, which one is not shown.
_WRONG_MODE = ("instead of", "is not on", "is not off", "changed: ", "during the", "with robot_mode", "list of modes")
_TRANSFORMATIONS: Mapping[str, _Change] = {
    "negated": _Change(lambda v, first: -v, ("sign", "opposite", "-1 times")),
    "doubled": _Change(lambda v, first: 2.0 * v, (" 2 times", "2 times as large", " 0.5 times")),
    "in thousandths": _Change(lambda v, first: 1000.0 * v, ("1000 times", "thousandths", "e+03 times", "expected -")),
    "frozen": _Change(lambda v, first: first, _STUCK),
    "in another order": _Change(lambda v, first: np.roll(v, 1), ("order",)),
    "zero": _Change(lambda v, first: 0.0 * v, (*_STUCK, "zero", " 0 times", "identical constants, 0", "0 V")),
}
_OF_MODES = ("frozen", "zero", "doubled")
_INTERFACES = ("realtime", "rtde", "realtime and rtde")


class Drawn(NamedTuple):
    """Defect that was drawn."""

    field: str
    transformation: str
    interface: str

    def __str__(self) -> str:
        return f"{self.field} {self.transformation} on {self.interface}"


#: Defects of the times of arrival, and the words that name them.
_TIMES: Mapping[str, tuple[Callable[[float], float], tuple[str, ...]]] = {
    "in bursts of 50 ms": (lambda t: 0.05 - t % 0.05, ("bursts", "unevenly")),
    "with 40 ms of jitter": (lambda t: 0.04 * ((t * 7919.0) % 1.0), ("bursts", "unevenly")),
    "0.15 s late": (lambda t: 0.15, ("late", "ms in")),
}


def all_defects() -> list[Drawn]:
    """Return field × transformation × interface, without those that change nothing."""
    found = [
        Drawn(field, name, interface)
        for field in _FIELDS
        for name in (_OF_MODES if field in _DISCRETE else _TRANSFORMATIONS)
        for interface in _INTERFACES
        if not (field == "speed_scaling" and name == "in another order")
    ]
    found += [Drawn("packets", name, "realtime") for name in ("in bursts of 50 ms", "with 40 ms of jitter")]
    found += [Drawn("packets", name, "rtde") for name in _TIMES]
    return found


def drawn(seed: int, count: int, bases: Mapping[str, Evidence]) -> Iterator[tuple[str, Drawn]]:
    """Yield defects, each with the firmware it is planted in: each firmware in turn."""
    firmwares = list(bases)
    order = iter(random.Random(seed).sample(all_defects(), len(all_defects())))
    for number in range(count):
        firmware = firmwares[number % len(firmwares)]
        yield firmware, next(each for each in order if changes(bases[firmware], each))


def sound(firmware: str, path: Path) -> Evidence:
    """Run stages 0 and 1, and the swings of the shoulder and of wrist 2, with a sound controller."""

    def consent(number: int, does: str) -> str:
        is_swing = number == 3 and does.startswith("moves the")
        return "" if not is_swing or "shoulder alone" in does or "wrist 2 alone" in does else "left out"

    with urlink.simulated_time(seed=SEED):
        run(f"sim://?firmware={firmware}", path, (0, 1, 3), consent, seconds=2.0)
    return Evidence(path)


def verdicts_with(base: Evidence, defect: Drawn) -> list[Verdict]:
    """Return the verdicts on sound evidence with a defect planted in its bytes."""
    evidence = planted_copy(base)
    for interface in defect.interface.split(" and "):
        evidence.__dict__.pop(interface, None)
        if defect.field == "packets":
            later(interface, _TIMES[defect.transformation][0])(evidence)
            continue
        for number, wire in enumerate(evidence.wires):
            if wire.interface == interface and not wire.is_sent:
                _change(evidence, number, defect)
    return judge(evidence, requirements())


def changes(base: Evidence, defect: Drawn) -> bool:
    """Return whether a defect changes a byte or a time of the evidence."""
    evidence = planted_copy(base)
    if defect.field == "packets":
        return True
    for number, wire in enumerate(evidence.wires):
        if wire.interface in defect.interface.split(" and ") and not wire.is_sent:
            _change(evidence, number, defect)
    return any(one.data != other.data for one, other in zip(base.wires, evidence.wires, strict=True))


def is_found(verdicts: list[Verdict]) -> bool:
    """Return whether a requirement is not held."""
    return any(each.state == "not held" for each in verdicts)


def is_named(verdicts: list[Verdict], defect: Drawn) -> bool:
    """Return whether a likely cause names the field and what is wrong with it."""
    causes = likely_causes(verdicts)
    if defect.field == "packets":
        return any(word in each for each in causes for word in _TIMES[defect.transformation][1])
    names = (defect.field, _FIELDS[defect.field])
    words = _WRONG_MODE if defect.field in _DISCRETE else _TRANSFORMATIONS[defect.transformation].words
    return any(any(n in each for n in names) and any(w in each for w in words) for each in causes)


def _change(evidence: Evidence, number: int, defect: Drawn) -> None:
    wire = evidence.wires[number]
    place = _place(evidence, number, defect.field)
    if place is None:
        return
    at, code = place
    change = _TRANSFORMATIONS[defect.transformation].of
    width, first, chunks = 2 if wire.interface == "rtde" else 4, None, []
    for stamp, data in wire.chunks:
        start, parts = 0, []
        while start < len(data):
            size = max(int.from_bytes(data[start : start + width], "big"), width)
            frame = data[start : start + size]
            start += size
            if (wire.interface == "realtime" or frame[2:3] == b"U") and at + struct.calcsize(code) <= len(frame):
                values = np.array(struct.unpack_from(code, frame, at), np.float64)
                first = values if first is None else first
                made = change(values, first)
                is_whole = code[-1] != "d"
                packed = struct.pack(code, *(int(each) % (1 << 31) if is_whole else each for each in made))
                frame = frame[:at] + packed + frame[at + len(packed) :]
            parts.append(frame)
        chunks.append((Stamp(stamp.monotonic, stamp.wall), b"".join(parts)))
    wire.chunks = chunks


_CODES = {
    "DOUBLE": "d",
    "VECTOR6D": "6d",
    "VECTOR3D": "3d",
    "INT32": "i",
    "UINT32": "I",
    "UINT64": "Q",
    "VECTOR6INT32": "6i",
}


def _place(evidence: Evidence, number: int, field: str) -> tuple[int, str] | None:
    """Return the offset and the struct code of a field in the packets of a connection."""
    if evidence.wires[number].interface == "realtime":
        places = RealtimeState.LAYOUTS.of(str(evidence.firmware)).places
        if field not in places:
            return None
        place = places[field]
        return place.offset, f">{place.size // 8}d"
    said = evidence.last("rtde-names")
    received = evidence.received("rtde")
    is_long = max(received, key=lambda wire: len(wire.data)) is evidence.wires[number]
    if said is None or not is_long or _FIELDS[field] not in said["names"]:
        return None
    place = Recipe(said["names"], said["types"]).layout.places[_FIELDS[field]]
    return place.offset, ">" + _CODES[said["types"][said["names"].index(_FIELDS[field])]]
