"""Defects of a controller, planted in its evidence, and the requirement that must detect each defect.

A defect changes the evidence of a sound run: bytes of packets, their arrival times, or answers.
"""

from __future__ import annotations

import copy
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from linkcore.clock import Stamp
from urlink.protocol.realtime.packets import RealtimeState
from urlink.protocol.rtde.recipes import Recipe
from urlink_accept.acceptance.evidence import Evidence, Wire

__all__ = ["DEFECTS", "Defect", "later", "planted", "planted_copy"]

Values = NDArray[np.float64]
Plant = Callable[[Evidence], None]


class Defect(NamedTuple):
    """A defect.

    Attributes:
        plant: Function that changes a copy of the evidence.
        named: Requirement that is not held with the defect.
        said: Text of the verdict, or a part of it.
        moves: Whether the defect shows only while the arm moves.
    """

    plant: Plant
    named: str
    said: str = ""
    moves: bool = False


# -- bytes -----------------------------------------------------------------------------------------


def _frames(wire: Wire) -> list[tuple[Stamp, list[bytes]]]:
    """Split the chunks of a connection into packets; remaining bytes stay with their chunk."""
    found = []
    for stamp, data in wire.chunks:
        at, parts = 0, []
        while at < len(data):
            width = 2 if wire.interface == "rtde" else 4
            size = max(int.from_bytes(data[at : at + width], "big"), width)
            parts.append(data[at : at + size])
            at += size
        found.append((stamp, parts))
    return found


def _each(interface: str, change: Callable[[bytes, int], bytes | None]) -> Plant:
    """Change each packet that arrived on an interface.

    `change` receives the packet and its number, and returns the new packet, or None to leave the packet out.
    """

    def plant(evidence: Evidence) -> None:
        for wire in evidence.received(interface):
            number, chunks = 0, []
            for stamp, frames in _frames(wire):
                changed = []
                for frame in frames:
                    changed.append(change(frame, number))
                    number += 1
                chunks.append((stamp, b"".join(frame for frame in changed if frame is not None)))
            wire.chunks = [(stamp, data) for stamp, data in chunks if data]

    return plant


def _doubles(frame: bytes, at: int, count: int, change: Callable[[Values], Any]) -> bytes:
    values = np.frombuffer(frame, ">f8", count, at).astype(np.float64)
    made = np.broadcast_to(np.asarray(change(values), np.float64), (count,))
    return frame[:at] + made.astype(">f8").tobytes() + frame[at + 8 * count :]


def rt(name: str, change: Callable[[Values], Any]) -> Plant:
    """Change a field of the real-time interface."""
    place = RealtimeState.LAYOUTS.of("5.11").places[name]
    count = {3: 3, 6: 6}.get(place.size // 8, 1)
    return _each("realtime", lambda frame, number: _doubles(frame, place.offset, count, change))


def _rtde_place(evidence: Evidence, name: str) -> tuple[int, int]:
    said = evidence.last("rtde-names")
    assert said is not None
    place = Recipe(said["names"], said["types"]).layout.places[name]
    return place.offset, place.size // 8


def rtde(name: str, change: Callable[[Values], Any]) -> Plant:
    """Change an RTDE variable."""

    def plant(evidence: Evidence) -> None:
        at, count = _rtde_place(evidence, name)

        def changed(frame: bytes, number: int) -> bytes:
            return _doubles(frame, at, count, change) if frame[2:3] == b"U" else frame

        _each("rtde", changed)(evidence)

    return plant


def sub_package(kind: int, change: Callable[[bytes], bytes], interface: str = "primary") -> Plant:
    """Change a sub-package of the robot states, and adapt the sizes."""

    def changed(frame: bytes, number: int) -> bytes:
        if frame[4] != 16:
            return frame
        at, parts = 5, []
        while at < len(frame):
            (size,) = struct.unpack_from(">i", frame, at)
            part = frame[at : at + size]
            if part[4] == kind:
                part = change(part)
                part = struct.pack(">i", len(part)) + part[4:]
            parts.append(part)
            at += size
        body = b"".join(parts)
        return struct.pack(">iB", 5 + len(body), 16) + body

    return _each(interface, changed)


def _resized(extra: bytes) -> Callable[[bytes, int], bytes]:
    def changed(frame: bytes, number: int) -> bytes:
        return struct.pack(">i", len(frame) + len(extra)) + frame[4:] + extra

    return changed


def _shorter(count: int) -> Callable[[bytes, int], bytes]:
    def changed(frame: bytes, number: int) -> bytes:
        return struct.pack(">i", len(frame) - count) + frame[4 : len(frame) - count]

    return changed


# -- times and notes -------------------------------------------------------------------------------


def later(interface: str, seconds: Callable[[float], float]) -> Plant:
    """Delay chunks by seconds that depend on the time since the connection was made."""

    def plant(evidence: Evidence) -> None:
        for wire in evidence.received(interface):
            first = wire.chunks[0][0].monotonic if wire.chunks else 0.0
            wire.chunks = [(Stamp(s.monotonic + seconds(s.monotonic - first), s.wall), data) for s, data in wire.chunks]

    return plant


def note(step: str, change: Callable[[dict[str, Any]], Any]) -> Plant:
    """Change the note about a step."""

    def plant(evidence: Evidence) -> None:
        for number, each in enumerate(evidence.notes):
            if each.step == step:
                said = copy.deepcopy(dict(each.said))
                change(said)
                evidence.notes[number] = each._replace(said=said)

    return plant


def answer(asked: str, reply: str) -> Plant:
    """Change an answer of the dashboard server."""
    return note("dashboard", lambda said: said.update(reply=reply) if said["asked"] == asked else None)


def both(*plants: Plant) -> Plant:
    """Combine several defects."""

    def plant(evidence: Evidence) -> None:
        for each in plants:
            each(evidence)

    return plant


def _calibration(evidence: Evidence) -> None:
    known = evidence.identity
    assert known is not None
    table = known.dh_table
    assert table is not None
    evidence.identity = replace(known, dh_table=type(table)(**{**_of(table), "dh_a": np.array(table.dh_a) * 1.02}))


def _of(table: Any) -> dict[str, Any]:
    return {name: list(map(float, getattr(table, name))) for name in ("dh_theta", "dh_a", "dh_d", "dh_alpha")}


def _swapped(frame: bytes, one: str, other: str) -> bytes:
    places = RealtimeState.LAYOUTS.of("5.11").places
    a, b, size = places[one].offset, places[other].offset, places[one].size
    first, second = frame[a : a + size], frame[b : b + size]
    frame = frame[:a] + second + frame[a + size :]
    return frame[:b] + first + frame[b + size :]


def _joint(number: int) -> Callable[[Values], Values]:
    def flip(values: Values) -> Values:
        values[number] = -values[number]
        return values

    return flip


def _order(values: Values) -> Values:
    return values[[0, 2, 1, 3, 4, 5]]


def _stopped_clock(frame: bytes, number: int) -> bytes:
    return frame[:4] + struct.pack(">d", 100.0) + frame[12:]


def _clock(factor: float) -> Plant:
    return _each(
        "realtime", lambda f, n: f[:4] + struct.pack(">d", struct.unpack_from(">d", f, 4)[0] * factor) + f[12:]
    )


def _set(**values: Any) -> Callable[[dict[str, Any]], None]:
    return lambda said: said.update(values)


def _data(change: Callable[[bytes], bytes]) -> Plant:
    return _each("rtde", lambda frame, number: change(frame) if frame[2:3] == b"U" else frame)


def _longer_data(frame: bytes) -> bytes:
    return struct.pack(">H", len(frame) + 8) + frame[2:] + bytes(8)


def _another_version(frame: bytes, number: int) -> bytes:
    at = frame.find(b"URControl")
    return frame if frame[4] != 20 or at < 0 else frame[: at + 9] + bytes([5, 9]) + frame[at + 11 :]


def _misfit(frame: bytes) -> bytes:
    """Set a size of the first sub-package that is larger than the package."""
    return frame[:5] + struct.pack(">i", 0x7FFF) + frame[9:]


def _joint_order(part: bytes) -> bytes:
    """Swap the first two joints of the joint data, which has 41 bytes for each joint."""
    return part[:5] + part[46:87] + part[5:46] + part[87:]


DEFECTS: Mapping[str, Defect] = {
    "wrong sign of q_actual": Defect(rt("q_actual", lambda q: -q), "fields-agree", "sign of 6 of 6"),
    "wrong sign of one joint": Defect(rt("q_actual", _joint(2)), "fields-agree", "sign of 1 of 6"),
    "wrong sign of one joint against the target": Defect(rt("q_actual", _joint(1)), "tracking", "joint 2"),
    "wrong sign of qd_actual": Defect(
        rt("qd_actual", lambda qd: -qd), "velocities", "its sign is inverted", moves=True
    ),
    "wrong sign of I_actual": Defect(rt("I_actual", lambda i: -i), "fields-agree", "I_actual"),
    "wrong sign of I_target": Defect(rt("I_target", lambda i: -i), "fields-agree", "I_target"),
    "wrong sign of M_target": Defect(rt("M_target", lambda m: -m), "fields-agree", "M_target"),
    "wrong sign of all moments": Defect(
        both(rt("M_target", lambda m: -m), rtde("target_moment", lambda m: -m)), "gravity", "Nm from the masses"
    ),
    "wrong sign of all currents": Defect(
        both(rt("I_target", lambda i: -i), rtde("target_current", lambda i: -i)), "currents", "opposite direction"
    ),
    "currents in mA": Defect(rt("I_actual", lambda i: 1000.0 * i), "values-possible", "I_actual"),
    "joints in degrees": Defect(rt("q_actual", np.rad2deg), "fields-agree", "degrees"),
    "speeds in degrees": Defect(rtde("actual_qd", np.rad2deg), "fields-agree", "degrees", moves=True),
    "joints in another order": Defect(rt("q_actual", _order), "fields-agree", "another order"),
    "targets and speeds swapped": Defect(
        _each("realtime", lambda f, n: _swapped(f, "q_target", "qd_target")), "fields-agree", "q_target"
    ),
    "target and actual currents swapped": Defect(
        _each("realtime", lambda f, n: _swapped(f, "I_target", "I_actual")), "fields-agree", "I_actual"
    ),
    "pose and speed of the tool swapped": Defect(
        _each("realtime", lambda f, n: _swapped(f, "tool_vector_actual", "tcp_speed_actual")),
        "fields-agree",
        "tool_vector",
    ),
    "pose in mm": Defect(rt("tool_vector_actual", lambda p: [*(p[:3] * 1000.0), *p[3:]]), "kinematics", "mm"),
    "displaced tool on all interfaces": Defect(
        both(rt("tool_vector_actual", lambda p: p + 0.01), rtde("actual_TCP_pose", lambda p: p + 0.01)), "kinematics"
    ),
    "a calibration of another arm": Defect(_calibration, "kinematics", "its own calibration"),
    "force in mN": Defect(rt("tcp_force", lambda f: 1000.0 * f), "fields-agree", "thousandths"),
    "temperatures in kelvin": Defect(rt("motor_temperatures", lambda t: t + 273.15), "values-possible", "temperatures"),
    "tenfold voltages": Defect(rt("V_actual", lambda v: 10.0 * v), "values-possible", "V_actual"),
    "NaN in q_actual": Defect(rt("q_actual", lambda q: np.nan), "values-possible", "nan"),
    "an unknown robot mode": Defect(rt("robot_mode", lambda m: 42.0), "modes-known", "robot_mode"),
    "an unknown safety mode": Defect(rt("safety_mode", lambda m: 99.0), "modes-known", "safety_mode"),
    "an unknown program state": Defect(rt("program_state", lambda m: 77.0), "modes-known", "program_state"),
    "unknown joint modes": Defect(rt("joint_modes", lambda m: 3.0), "modes-known", "joint_modes"),
    "scaling in percent": Defect(rt("speed_scaling", lambda s: 100.0), "values-possible", "speed_scaling"),
    "momentum below zero": Defect(rt("linear_momentum_norm", lambda m: -1.0), "values-possible", "momentum"),
    "elbow at the base": Defect(rt("elbow_position", lambda p: 0.0), "fields-agree", "elbow_position"),
    "acceleration in g": Defect(rt("tool_accelerometer", lambda a: a / 9.82), "accelerometer", "1.00 m/s²"),
    "a wrong payload": Defect(rt("payload_mass", lambda m: 9.0), "gravity", "9.00 kg"),
    "a sensor with an offset": Defect(rt("q_actual", lambda q: q + 0.02), "tracking"),
    "a stopped clock": Defect(_each("realtime", _stopped_clock), "clock-forward", "time of the previous one"),
    "a clock that jumps back": Defect(
        _each("realtime", lambda f, n: f if n % 97 else f[:4] + struct.pack(">d", 0.5) + f[12:]), "clock-forward"
    ),
    "a fast clock": Defect(_clock(1.01), "clock-drift", "ppm"),
    "a slow clock": Defect(_clock(0.995), "clock-drift", "ppm"),
    "a clock in ms": Defect(_clock(1000.0), "realtime-rate"),
    "packets sent twice": Defect(_each("realtime", lambda f, n: f + f), "clock-forward", "realtime"),
    "packets left out": Defect(_each("realtime", lambda f, n: f if n % 9 else None), "realtime-missed", "gaps"),
    "robot states left out": Defect(_each("primary", lambda f, n: f if n % 4 != 1 else None), "primary-rate", "7.5"),
    "half the rate": Defect(_each("realtime", lambda f, n: f if n % 2 else None), "realtime-rate", "250.00 Hz"),
    "extra bytes": Defect(_each("realtime", _resized(bytes(8))), "realtime-size", "1228 B"),
    "extra bytes at the end": Defect(_each("realtime", _resized(bytes(16))), "unknown-parts", "realtime"),
    "missing bytes": Defect(_each("realtime", _shorter(80)), "realtime-size", "1140 B"),
    "garbage between packets": Defect(
        _each("realtime", lambda f, n: f if n % 50 else f + b"\xde\xad\xbe"), "realtime-bytes", "belong to no"
    ),
    "packets cut off": Defect(
        _each("realtime", lambda f, n: f if n % 50 else f[:-7]), "realtime-bytes", "belong to no"
    ),
    "late packets": Defect(later("realtime", lambda t: 0.6 if 1.0 < t < 1.3 else 0.0), "realtime-late", "ms"),
    "stale RTDE": Defect(later("rtde", lambda t: 0.06), "rtde-fresh", "+60"),
    "RTDE with a stopped clock": Defect(rtde("timestamp", lambda t: 50.0), "clock-forward", "rtde"),
    "RTDE with the wrong sign": Defect(rtde("actual_q", lambda q: -q), "fields-agree", "rtde actual_q"),
    "constant values of RTDE": Defect(rtde("actual_current", lambda i: 0.5), "fields-agree", "stays the same"),
    "RTDE at half the rate": Defect(
        _each("rtde", lambda f, n: None if f[2:3] == b"U" and n % 2 else f), "rtde-rate", "250.00 Hz"
    ),
    "RTDE with extra bytes": Defect(_data(_longer_data), "rtde-bytes"),
    "RTDE package of unknown type": Defect(
        _each("rtde", lambda f, n: f if n % 40 else f + b"\x00\x04\x5a\x00"), "rtde-bytes"
    ),
    "a missing variable": Defect(note("rtde-names", _set(missing=["actual_q"])), "rtde-names", "actual_q"),
    "a variable of another type": Defect(
        note("rtde-names", lambda said: said["types"].__setitem__(said["names"].index("robot_mode"), "DOUBLE")),
        "rtde-names",
        "robot_mode has the type DOUBLE",
    ),
    "protocol 2 is refused": Defect(note("rtde", _set(protocol=1)), "rtde-protocol", "protocol 2"),
    "RTDE does not start": Defect(note("rtde", _set(error="RtdeRefused: start")), "rtde-protocol", "start"),
    "RTDE without data": Defect(
        _each("rtde", lambda f, n: None if f[2:3] == b"U" else f), "rtde-protocol", "no data package"
    ),
    "an unknown sub-package": Defect(
        _each(
            "primary", lambda f, n: f if f[4] != 16 else struct.pack(">i", len(f) + 9) + f[4:] + b"\0\0\0\x09\x63abcd"
        ),
        "unknown-parts",
        "primary",
    ),
    "a longer sub-package": Defect(sub_package(4, lambda part: part + bytes(4)), "state-size", "sub-package 4"),
    "a missing sub-package": Defect(
        sub_package(7, lambda part: part[:4] + b"\x63" + part[5:]), "state-size", "no sub-package 7"
    ),
    "a state with inconsistent sizes": Defect(
        _each("primary", lambda f, n: f if f[4] != 16 else f[:5] + b"\0\0\x7f\xff" + f[9:]),
        "primary-bytes",
        "belong to no",
    ),
    "a secondary state with inconsistent sizes": Defect(
        _each("secondary", lambda f, n: f if f[4] != 16 else _misfit(f)), "secondary-bytes"
    ),
    "a late primary interface": Defect(later("primary", lambda t: 0.3), "primary-fresh", "+300"),
    "joints of the primary in another order": Defect(
        sub_package(1, _joint_order), "fields-agree", "primary q_actual, against the others"
    ),
    "another firmware on the secondary": Defect(_each("secondary", _another_version), "versions-agree", "secondary"),
    "another firmware from the dashboard": Defect(
        answer("PolyscopeVersion", "URSoftware 5.9.1.1 (x)"), "versions-agree", "dashboard"
    ),
    "an unknown reply of the dashboard": Defect(answer("running", "yes"), "dashboard-words", "running"),
    "a wrong reply of the dashboard": Defect(answer("robotmode", "Robotmode: IDLE"), "dashboard-modes", "IDLE"),
    "a closed port": Defect(note("port", _set(error="connection refused")), "ports", "refused"),
    "an arm without a model": Defect(
        lambda evidence: setattr(evidence, "identity", replace(_identity(evidence), model=None)), "identity"
    ),
}


def _identity(evidence: Evidence) -> Any:
    assert evidence.identity is not None
    return evidence.identity


def planted_copy(base: Evidence) -> Evidence:
    """Return a copy of the evidence whose bytes and notes can be changed."""
    evidence = copy.copy(base)
    evidence.notes = list(base.notes)
    evidence.wires = [replace(wire, chunks=list(wire.chunks)) for wire in base.wires]
    return evidence


def planted(base: Evidence, defect: Defect | None) -> Evidence:
    """Return a copy of the evidence, with or without a defect."""
    evidence = planted_copy(base)
    if defect is not None:
        defect.plant(evidence)
    return evidence
