"""Addresses: every valid form, and a clear error for every other text."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadAddress, BadRecording
from urlink.protocol.firmware import Firmware
from urlink.protocol.ports import PORTS
from urlink.session.address import RecordingAddress, RobotAddress, SimulatorAddress, parse_address


@pytest.mark.parametrize(
    ("text", "host"),
    [
        ("192.168.56.101", "192.168.56.101"),
        ("  192.168.56.101\n", "192.168.56.101"),
        ("robot.example.org", "robot.example.org"),
        ("ur://192.168.56.101", "192.168.56.101"),
        ("ur://192.168.56.101/", "192.168.56.101"),
        ("UR://Robot", "robot"),
        ("[::1]", "::1"),
        ("ur://[fe80::1%25eth0]", "fe80::1%eth0"),
    ],
)
def test_robot_address_is_parsed(text: str, host: str) -> None:
    assert parse_address(text) == RobotAddress(host, dict(PORTS))


def test_robot_address_sets_ports() -> None:
    place = parse_address("ur://robot?realtime=1&primary_readonly=65535")
    assert isinstance(place, RobotAddress)
    assert place.ports == {**PORTS, "realtime": 1, "primary_readonly": 65535}
    assert parse_address("robot?realtime=1") == RobotAddress("robot", {**PORTS, "realtime": 1})


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("sim://", SimulatorAddress()),
        ("sim:///", SimulatorAddress()),
        ("sim://ur10", SimulatorAddress("ur10")),
        ("sim:///UR10e", SimulatorAddress("UR10e")),
        ("sim://?firmware=3.4", SimulatorAddress(None, Firmware(3, 4))),
        ("sim://ur5e?firmware=5.11.1", SimulatorAddress("ur5e", Firmware(5, 11, 1))),
        ("sim://?firmware=3.15.8", SimulatorAddress(None, Firmware(3, 15, 8))),
        ("sim://?firmware=10.99", SimulatorAddress(None, Firmware(10, 99))),
        ("sim://?motion=still", SimulatorAddress(None, None, "still")),
        ("sim://ur10?motion=demo&firmware=3.4", SimulatorAddress("ur10", Firmware(3, 4), "demo")),
        ("sim://ur5e?scene=/tmp/a%20table.xml", SimulatorAddress("ur5e", scene=Path("/tmp/a table.xml"))),
    ],
)
def test_simulator_address_is_parsed(text: str, place: SimulatorAddress) -> None:
    assert parse_address(text) == place


@pytest.mark.parametrize(
    ("text", "path", "rate"),
    [
        ("replay:///tmp/run.urlog", "/tmp/run.urlog", 1),
        ("replay://run.urlog", "run.urlog", 1),
        ("replay://Runs/Run.urlog", "Runs/Run.urlog", 1),
        ("replay:///tmp/run.urlog?rate=2.5", "/tmp/run.urlog", 2.5),
        ("replay:///tmp/run.urlog?rate=0", "/tmp/run.urlog", 0),
        ("replay:///tmp/run.urlog?rate=max", "/tmp/run.urlog", 0),
        ("replay:///tmp/my%20run%23%3F1%25.urlog", "/tmp/my run#?1%.urlog", 1),
        ("replay:///tmp/%C3%BC.urlog", "/tmp/ü.urlog", 1),
        ("replay:///tmp/ü.urlog", "/tmp/ü.urlog", 1),
    ],
)
def test_recording_address_is_parsed(text: str, path: str, rate: float) -> None:
    assert parse_address(text) == RecordingAddress(Path(path), rate)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("", "expected a host, ur://host, sim://model or replay:///file"),
        ("  ", "is not an address"),
        ("two words", "is not an address"),
        ("nul\0", "is not an address"),
        ("replay:///tmp/my run.urlog", "write a space in a file name as %20"),
        ("http://192.168.56.101", "unknown scheme 'http'; expected ur, sim or replay"),
        ("://", "unknown scheme|expected a host"),
        ("ur://", "expected a host name or address"),
        ("ur://host/path", "expected a host name or address"),
        ("ur://somebody@host", "expected a host name or address"),
        (
            "192.168.56.101:30003",
            "one port number is not enough, because a robot has a port for each interface; expected ur://192.168.56.101?realtime=30003",
        ),
        ("ur://[::1]:30003", "one port number is not enough"),
        ("[::1", "is not an address"),
        ("ur://a]b", "is not an address"),
        ("ur://host?speed=3", "unknown option 'speed'; expected one of primary, secondary, realtime"),
        ("ur://host?realtime=0", "realtime='0' is not a port; expected 1 to 65535"),
        ("ur://host?realtime=65536", "is not a port"),
        ("ur://host?realtime=", "is not a port"),
        ("ur://host?realtime=-1", "is not a port"),
        ("ur://host?realtime=" + "9" * 5000, "is not a port"),
        ("ur://host#30003", "unexpected #30003"),
        ("sim://?speed=3", "unknown option 'speed'; expected firmware, motion, like, scene, gripper or frequency"),
        ("sim://?motion=dance", "motion='dance'; expected still or demo"),
        ("sim://?motion=", "motion=''; expected still or demo"),
        ("sim://?firmware=new", "'new' is not a version"),
        ("sim://?firmware=0.1", "unknown firmware 0.1"),
        ("sim://?firmware=6.1", "unknown firmware 6.1"),
        (
            "sim://?firmware=99.1",
            "no controller has firmware 99.1; expected 1.x up to 1.8, 3.x up to 3.15, 5.x or 10.x",
        ),
        ("sim://?firmware=3.16", "no controller has firmware 3.16"),
        ("sim://?firmware=1.9", "no controller has firmware 1.9"),
        ("sim://?firmware=5", "not a version"),
        ("sim://?firmware=1.2.3.4.5", "not a firmware"),
        ("replay://", "names no file; expected replay:///path/run.urlog"),
        ("replay:///run.urlog?rate=-1", "expected a positive number, or max"),
        ("replay:///run.urlog?rate=fast", "rate='fast'"),
        ("replay:///run.urlog?rate=", "rate=''"),
        ("replay:///run.urlog?rate=nan", "rate='nan'"),
        ("replay:///run.urlog?rate=1e999", "rate='1e999'"),
        ("replay:///run.urlog?speed=2", "unknown option 'speed'; expected rate"),
        ("replay:///run#1.urlog", "write # in a file name as %23"),
    ],
)
def test_invalid_address_names_expected_form(text: str, hint: str) -> None:
    with pytest.raises(BadAddress) as caught:
        parse_address(text)
    assert any(part in str(caught.value) for part in hint.split("|"))
    assert isinstance(caught.value, ValueError)


anything = st.text() | st.text(alphabet="/:?#[]@=&%.0123456789abursimeplyt ", max_size=40)


@pytest.mark.property
@given(anything | st.builds("{}://{}".format, st.sampled_from(["ur", "sim", "replay"]), anything))
@example("ur://[")
@example("ur://\u2100")
@example("sim://?firmware=9.999999999")
@example("replay://%00")
@example("\ud800")
def test_any_text_is_an_address_or_raises_bad_address(text: str) -> None:
    try:
        place = parse_address(text)
    except BadAddress:
        return
    match place:
        case RobotAddress(host, ports):
            assert host
            assert ports.keys() == PORTS.keys()
            assert all(0 < port < 65536 for port in ports.values())
        case SimulatorAddress(model):
            assert model is None or model
        case RecordingAddress(_, rate):
            assert 0 <= rate < float("inf")


@pytest.mark.parametrize("name", ["nothing.urlog", "nul%00.urlog"])
def test_connect_raises_for_missing_recording(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadRecording, match="cannot read"):
        urlink.connect(f"replay://{tmp_path}/{name}")


def test_connect_raises_for_file_of_other_type(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("not a recording")
    with pytest.raises(BadRecording, match="is not a recording"):
        urlink.connect(f"replay://{tmp_path}/notes.txt")


@pytest.mark.simulated_time
def test_missing_interface_of_recording_raises_immediately(tmp_path: Path) -> None:
    with urlink.connect("sim://ur5?firmware=3.4") as robot, robot.record(tmp_path / "run.urlog", ["primary"]):
        robot.primary.wait()
    with urlink.connect(f"replay://{tmp_path}/run.urlog?rate=max") as replayed:
        assert (str(replayed.firmware), replayed.model) == ("3.4", "UR5")
        with pytest.raises(BadRecording, match="has no channel 'realtime'; its channels are primary"):
            replayed.realtime  # noqa: B018
        assert list(replayed.primary)


def test_robot_address_round_trip() -> None:
    assert str(RobotAddress("127.0.0.1")) == "127.0.0.1"
    assert str(RobotAddress("::", dict(PORTS))) == "[::1]"
    somewhere = RobotAddress("0.0.0.0", {**PORTS, "realtime": 5})
    assert str(somewhere) == "ur://127.0.0.1?realtime=5"
    for address in (RobotAddress("::1", {**PORTS, "primary": 7}), RobotAddress("robot", dict.fromkeys(PORTS, 9))):
        assert parse_address(str(address)) == address
