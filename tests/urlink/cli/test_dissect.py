from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.clock import Stamp
from linkcore.recording.file import Kind, RecordingWriter
from tests import real_captures
from tests.harm import HOSTILE, assert_harmless, strict
from urlink.cli.dissect import PacketPiece, cut, dissect, guess_interface
from urlink.packets import JointData, RealtimeState, RobotModeData, RobotState, TextMessage, VersionMessage
from urlink.protocol.firmware import NEWEST, RELEASES, release_of
from urlink.simulator import Controller

from .conftest import Run

_CAPTURES = sorted(path.name for path in (real_captures.ROOT / "ur").glob("*.bin") if "rtde" not in path.name)


def rebuilt(pieces: list[dict[str, Any]]) -> bytes:
    """Reassemble the bytes of a dissection, and check that each byte is shown once, at its offset."""
    shown = sorted(_hex(pieces))
    data = b""
    for offset, text in shown:
        assert offset == len(data), f"gap or overlap at offset {offset}"
        data += bytes.fromhex(text)
    return data


def _hex(pieces: list[dict[str, Any]]) -> Iterator[tuple[int, str]]:
    for piece in pieces:
        for row in piece.get("fields", []):
            yield row["offset"], row["hex"]
        yield from _hex(piece.get("packages", []))
        if "hex" in piece:
            yield piece["offset"], piece["hex"]


def as_json(pieces: Iterator[PacketPiece]) -> list[dict[str, Any]]:
    return [json.loads(json.dumps(piece.as_json())) for piece in pieces]


def dissected(run: Run, data: bytes, tmp_path: Path, *options: str) -> list[dict[str, Any]]:
    path = tmp_path / "bytes.bin"
    path.write_bytes(data)
    status, out, err = run("dissect", str(path), "--json", *options)
    assert (status, err) == (0, "")
    pieces = list(map(strict, out.splitlines()))
    assert rebuilt(pieces) == data
    return pieces


# -- one packet ----------------------------------------------------------------------------------------


def test_dissect_prints_realtime_packet(run: Run, tmp_path: Path) -> None:
    data = bytes(RealtimeState("3.4", time=951.5, q_actual=[1, 2, 3, 4, 5, float("nan")], digital_input_bits=5))
    path = tmp_path / "packet.bin"
    path.write_bytes(data)
    status, out, err = run("dissect", str(path))
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "#1 RealtimeState: 1060 bytes at 0, layout of firmware 3.2 and later"
    assert lines[1].split(maxsplit=6) == ["0", "00", "00", "04", "24", "size", "1060 B                        header"]
    assert lines[2].split()[:9] == ["4", *data[4:12].hex(" ").split()]
    assert lines[2].split()[9:] == ["time", "951.5", "s", "time", "since", "the", "controller", "started"]
    (first,) = (line for line in lines if " q_actual[0] " in line)
    assert first.endswith("1 rad                         actual joint positions")
    assert first.split()[0] == "252"
    assert any(" q_actual[5] " in line and "nan rad" in line for line in lines)
    assert any("digital_input_bits" in line and " 0x5 " in line for line in lines)


def test_robot_state_is_split_into_sub_packages(run: Run, tmp_path: Path) -> None:
    state = RobotState(RobotModeData("5.11", robot_mode=7), JointData("5.11", q_actual=[1, 2, 3, 4, 5, 6]))
    (piece,) = dissected(run, bytes(state), tmp_path)
    assert piece["type"] == "RobotState"
    assert [part["type"] for part in piece["packages"]] == ["RobotModeData", "JointData"]
    mode, joints = piece["packages"]
    (robot_mode,) = (row for row in mode["fields"] if row["name"] == "robot_mode")
    assert (robot_mode["value"], robot_mode["meaning"]) == ("RUNNING", "robot mode")
    names = [row["name"] for row in joints["fields"]]
    assert names[:4] == ["size", "type", "q_actual[0]", "q_target[0]"]  # the order on the wire
    path = tmp_path / "bytes.bin"
    out = run("dissect", str(path))[1]
    assert "\n  RobotModeData: 47 bytes at 5, layout of firmware 3.5 and later\n" in out


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_packets_of_every_firmware_are_dissected_completely(run: Run, tmp_path: Path, release: Any) -> None:
    controller = Controller(None, release.since)
    controller.step(3)
    realtime = controller.realtime_packet() * 2
    primary = b"".join(controller.greeting("primary")) + controller.state_package()
    for data, options in ((realtime, ()), (primary, ()), (realtime, ("--firmware", str(release.since)))):
        pieces = dissected(run, data, tmp_path, *options)
        assert all(piece["error"] is None for piece in pieces)
        assert not any(row["name"] == "tail" for piece in pieces for row in piece.get("fields", []))
    assert dissected(run, realtime, tmp_path)[0]["size"] == release.realtime


def test_unknown_tail_is_shown(run: Run, tmp_path: Path) -> None:
    body = bytes(RealtimeState(NEWEST))[4:] + b"newfield"
    (piece,) = dissected(run, (len(body) + 4).to_bytes(4, "big") + body, tmp_path)
    assert piece["fields"][-1] == {
        "offset": release_of(NEWEST).realtime,
        "hex": b"newfield".hex(),
        "name": "tail",
        "value": None,
        "unit": "",
        "meaning": "bytes that no known layout explains",
    }


def test_firmware_option_selects_layout(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "packet.bin"
    path.write_bytes(bytes(RealtimeState("3.0")))
    assert run("dissect", str(path), "--firmware", "3.1")[0] == 0
    status, out, err = run("dissect", str(path), "--firmware", "5.4")
    assert (status, err) == (1, "")
    assert "!! RealtimeState of firmware 5.4: the packet is too short: expected 1116 bytes, got 1044" in out


# -- damaged data --------------------------------------------------------------------------------------


def test_bytes_between_packets_and_truncated_packet_are_shown(run: Run, tmp_path: Path) -> None:
    packet = bytes(RealtimeState("5.11", time=1.0))
    pieces = dissected(run, packet + b"\xff" * 33 + packet + packet[:500], tmp_path)
    assert [piece["type"] for piece in pieces] == [
        "RealtimeState",
        "no packet",
        "RealtimeState",
        "beginning of a packet",
    ]
    assert pieces[1]["hex"] == "ff" * 33
    assert pieces[3]["error"] == "cut off: expected 1220 bytes, got 500"


def test_truncated_robot_state_shows_complete_sub_packages(run: Run, tmp_path: Path) -> None:
    data = bytes(RobotState(RobotModeData("5.11"), JointData("5.11")))[:100]
    (piece,) = dissected(run, data, tmp_path)
    assert piece["error"] == "cut off: expected 303 bytes, got 100"
    assert [part["type"] for part in piece["packages"]] == ["RobotModeData", "rest"]
    assert piece["packages"][1]["error"] == "no whole sub-package: expected 251 bytes, got 48"


def test_bad_sub_package_does_not_hide_the_others(run: Run, tmp_path: Path) -> None:
    bad = (20).to_bytes(4, "big") + bytes([1]) + bytes(15)  # valid joint data have 251 bytes
    unknown = (9).to_bytes(4, "big") + bytes([77]) + b"what"
    body = bytes(RobotModeData("5.11")) + bad + unknown
    data = (5 + len(body)).to_bytes(4, "big") + bytes([16]) + body
    (piece,) = dissected(run, data, tmp_path)
    assert piece["error"] == "1 of 3 sub-packages could not be decoded"
    assert [part["type"] for part in piece["packages"]] == [
        "RobotModeData",
        "sub-package of type 1",
        "UnknownSubPackage",
    ]
    assert "too short" in piece["packages"][1]["error"]
    assert piece["packages"][2]["fields"][-1]["hex"] == b"what".hex()
    assert "!! 1 of 3 sub-packages could not be decoded" in run("dissect", str(tmp_path / "bytes.bin"))[1]


def test_hostile_text_is_escaped(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "text.bin"
    path.write_bytes(bytes(TextMessage(text=HOSTILE)))
    for options in ((), ("--json",)):
        status, out, _ = run("dissect", str(path), *options)
        assert status == 0
        assert_harmless(out)
    assert strict(run("dissect", str(path), "--json")[1])["fields"][-1]["value"] == HOSTILE


def test_dissect_reads_hex_text_and_stdin(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = bytes(TextMessage(text="hello"))
    path = tmp_path / "packet"
    path.write_bytes(data)
    status, expected, _ = run("dissect", str(path))
    assert status == 0
    for text in (data, data.hex().encode(), data.hex(" ").encode() + b"\n"):
        path.write_bytes(text)
        assert run("dissect", str(path))[:2] == (0, expected)
        monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(text)))
        assert run("dissect", "-")[:2] == (0, expected)
    path.write_text("00000000: 0000 0037")
    status, _, err = run("dissect", str(path))
    assert status == 1
    assert "it is text that begins with '00000000: 0000 0037'; expected hex digits" in err


@pytest.mark.parametrize("data", [b"", b"\xff" * 5000, b"HTTP/1.1 400 Bad Request\r\n\r\n"])
def test_dissect_fails_without_any_packet(run: Run, tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "x.bin"
    path.write_bytes(data)
    status, out, err = run("dissect", str(path))
    assert (status, out) == (1, "")
    assert err.count("\n") == 1
    if data:
        # With an explicit interface, the bytes are shown, and the exit status reports that none could be decoded.
        status, out, _ = run("dissect", str(path), "--interface", "primary")
        assert status == 1
        assert "these bytes belong to no packet" in out or "cut off" in out


# -- files ---------------------------------------------------------------------------------------------


def test_dissect_detects_the_interface_from_the_bytes() -> None:
    controller = Controller("UR5", "1.8")
    controller.step()
    assert guess_interface(controller.realtime_packet()) == "realtime"
    assert guess_interface(b"".join(controller.greeting("primary"))) == "primary"
    assert guess_interface(controller.realtime_packet()[:300]) == "realtime"
    assert guess_interface(controller.state_package()[:300]) == "primary"
    assert guess_interface(b"\xff" * 3000) is None


def test_count_limits_packets(run: Run, recording: Path) -> None:
    pieces = list(map(strict, run("dissect", str(recording), "--count", "3", "--json")[1].splitlines()))
    assert [piece["number"] for piece in pieces] == [1, 2, 3]


def test_recording_shows_both_interfaces(run: Run, recording: Path) -> None:
    status, out, err = run("dissect", str(recording), "--json")
    assert (status, err) == (0, "")
    assert_harmless(out)
    types = [strict(line)["type"] for line in out.splitlines()]
    assert types == ["RealtimeState"] * 20 + ["VersionMessage", "TextMessage", "RobotState"]
    only = run("dissect", str(recording), "--json", "--interface", "primary")[1]
    assert [strict(line)["type"] for line in only.splitlines()] == types[20:]
    status, _, err = run("dissect", str(recording), "--interface", "secondary")
    assert status == 1
    assert "has no channel 'secondary'" in err


def test_connections_of_recording_are_dissected_separately(run: Run, tmp_path: Path) -> None:
    packet = bytes(RealtimeState("5.11"))
    path = tmp_path / "x.urlog"
    writer = RecordingWriter(path)
    channel = writer.add_channel({"name": "realtime"})
    stamp = Stamp(1.0, 1.0)
    writer.write(Kind.BYTES, channel, stamp, packet + packet[:100])
    writer.write(Kind.EVENT, channel, stamp, b'{"state": "lost", "error": "cable"}')
    writer.write(Kind.BYTES, channel, stamp, packet)
    writer.close()
    pieces = list(map(strict, run("dissect", str(path), "--json")[1].splitlines()))
    assert [(piece["type"], piece["offset"]) for piece in pieces] == [
        ("RealtimeState", 0),
        ("beginning of a packet", 1220),
        ("RealtimeState", 0),
    ]


def test_version_message_selects_layout_of_later_packets() -> None:
    version = bytes(VersionMessage("5.4", major=5, minor=4, build_date="01-01-2024, 00:00:00"))
    short = bytes(RobotState(RobotModeData("3.0")))
    (alone,) = dissect(short, "primary", None)
    assert alone.error is None
    _, after = dissect(version + short, "primary", None)
    assert after.error is not None
    assert "firmware 5.4" in (after.parts[0].error or "")


# -- arbitrary bytes -----------------------------------------------------------------------------------


@pytest.mark.property
@pytest.mark.parametrize("interface", ["realtime", "primary"])
@given(data=st.data())
def test_every_byte_is_shown_once(interface: Any, data: st.DataObject) -> None:
    controller = _STEPPED
    good = [controller.realtime_packet()] if interface == "realtime" else controller.greeting("primary")
    parts = data.draw(st.lists(st.sampled_from(good) | st.binary(max_size=300), max_size=6))
    raw = bytearray(b"".join(parts))
    for at in data.draw(st.lists(st.integers(0, max(len(raw) - 1, 0)), max_size=4)) if raw else []:
        raw[at] ^= data.draw(st.integers(1, 255))
    pieces = as_json(dissect(bytes(raw), interface, None))
    assert rebuilt(pieces) == bytes(raw)
    assert b"".join(stretch.data for stretch in cut(bytes(raw), interface)) == bytes(raw)
    for piece in dissect(bytes(raw), interface, None):
        assert_harmless(*piece.lines(1))


_STEPPED = Controller("UR5e", "5.11")
_STEPPED.step()


@pytest.mark.captures("ur")
@pytest.mark.parametrize("name", _CAPTURES)
def test_dissection_of_captures_shows_every_byte(run: Run, captures: Path, name: str) -> None:
    path = captures / name
    status, out, err = run("dissect", str(path), "--json", "--interface", _interface(path))
    pieces = list(map(strict, out.splitlines()))
    assert rebuilt(pieces) == path.read_bytes()
    assert err == ""
    assert status == (0 if any("fields" in piece for piece in pieces) else 1)
    if path.stem == "ursim_5.8_primary_state_1386":
        assert len(pieces[0]["packages"]) == 13


def _interface(path: Path) -> str:
    return "realtime" if "_rt_" in path.name else "primary"


@pytest.mark.captures("ur")
def test_captured_connections_are_found() -> None:
    assert _CAPTURES


def test_dissected_values_equal_the_decoded_packet() -> None:
    state = RealtimeState("5.11", q_actual=[1, 2, 3, 4, 5, 6])
    (piece,) = dissect(bytes(state), "realtime", None)
    values = {row.name: row.value for row in piece.rows}
    (decoded,) = urlink.decode(bytes(state), "realtime")
    assert list(values["q_actual"]) == list(decoded.q_actual)
