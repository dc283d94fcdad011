"""The topics of a robot with MQTT, and the decoder of their payloads."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from rhdlink.mqtt.topics import DRIVE, LONGEST, TOPICS, decode
from rhdlink.mqtt.variables import RobobotVariables
from rhdlink.mqtt.wheel_odometry import Odometry
from rhdlink.variables.value_types import Int32, Text

DECLARED = RobobotVariables.declared()


def test_decode_reads_a_pose_as_in_the_reference() -> None:
    """The log has no pose: the format is that of the source of 2026, with the time of the Teensy first."""
    message = decode("robobot/drive/T0/pose", b"1738331987.8049 4162.2822 1.250 -0.500 1.5708 0.0100")
    assert message is not None
    assert message.stamp == (1738331987, 804900)
    assert message.values == {
        **{"posetime": 4162.2822, "posex": 1.25, "posey": -0.5, "heading": 1.5708, "tilt": 0.01},
    }


def test_decode_keeps_the_first_values_of_a_longer_payload() -> None:
    message = decode("robobot/drive/T0/ird", b"1738331987.8049 0.25 1.5 7 8")
    assert message is not None
    assert message.values == {"dist": (0.25, 1.5)}


@pytest.mark.parametrize("topic", ["robobot/drive/T0/unknown", "robobot/cmd/ti", "other/drive/T0/pose", ""])
def test_decode_ignores_unknown_topics(topic: str) -> None:
    assert decode(topic, b"1738331987.8049 1 2") is None


@pytest.mark.parametrize(
    ("topic", "payload", "reason"),
    [
        ("T0/pose", b"", "'' is not a time"),
        ("T0/pose", b"1738331987.8 4162.2 1.0 2.0", "got 3 values"),
        ("T0/pose", b"1738331987.8 4162.2 1.0 2.0 x", "could not convert string to float: 'x'"),
        ("T0/pose", b"1738331987.8 4162.2 1.0 2.0 nan", "'nan' is not a finite number"),
        ("T0/pose", b"1738331987.8 4162.2 1e9 2.0 0", "1000000000"),
        ("T0/livn", b"1738331987.8 1 2 3 4 5 6 7 8.5", "'8.5' is not an integer"),
        ("T0/mvel", b"later 1 2", "'later' is not a time"),
        ("T0/mvel", b"9999999999 1 2", "is not a time"),
        ("T0/mvel", "1738331987.8 1 \u0663".encode(), "ascii"),
        ("master", b"1738331987.8", "a text is missing"),
    ],
)
def test_decode_raises_the_reason_of_an_invalid_payload(topic: str, payload: bytes, reason: str) -> None:
    with pytest.raises(BadValue, match=reason) as raised:
        decode(DRIVE + topic, payload)
    assert f"{DRIVE}{topic}: invalid payload" in str(raised.value)
    assert TOPICS[topic].variables[0] in str(raised.value)


@pytest.mark.property
@given(topic=st.sampled_from(sorted(TOPICS)), payload=st.binary(max_size=2 * LONGEST))
def test_decode_returns_or_raises_bad_value_for_any_payload(topic: str, payload: bytes) -> None:
    try:
        message = decode(DRIVE + topic, payload)
    except BadValue:
        return
    assert message is not None
    assert set(message.values) <= set(TOPICS[topic].variables)


@st.composite
def payloads(draw: st.DrawFn) -> tuple[str, str, dict[str, object]]:
    """A topic, a payload and its values."""
    topic = TOPICS[draw(st.sampled_from(sorted(TOPICS)))]
    words = [f"{draw(st.integers(0, 2**31 - 1))}.{draw(st.integers(0, 9999)):04d}"]
    values: dict[str, object] = {}
    for name in topic.variables:
        declaration = DECLARED[name]
        if isinstance(declaration.type, Text):
            text = draw(st.text("abc-: #12", min_size=1, max_size=20).map(str.strip).filter(bool))
            words.append(text)
            values[name] = text
            continue
        whole: st.SearchStrategy[float] = st.integers(-(2**31), 2**31 - 1)
        fixed = st.integers(-2_000_000_000, 2_000_000_000).map(lambda step: round(step * 1e-6, 6))
        each = whole if declaration.type is Int32 else fixed
        numbers = draw(st.lists(each, min_size=declaration.count, max_size=declaration.count))
        words += [str(number) if isinstance(number, int) else f"{number:.6f}" for number in numbers]
        values[name] = tuple(numbers) if declaration.count > 1 else numbers[0]
    return topic.name, " ".join(words), values


@pytest.mark.property
@given(payloads())
def test_decode_reads_back_written_values(case: tuple[str, str, dict[str, object]]) -> None:
    topic, payload, values = case
    message = decode(DRIVE + topic, payload.encode())
    assert message is not None
    assert message.values == values


def test_variables_of_the_topics_are_declared_once() -> None:
    names = {name for topic in TOPICS.values() for name in topic.variables}
    assert names <= DECLARED.keys()
    derived = {"transpos", "rotpos", "linesensor"}
    assert {each.name for each in DECLARED.values() if each.direction == "r"} == names | derived


# -- odometry --------------------------------------------------------------------------------------------------


def pose(seconds: float, x: float, y: float, heading: float) -> dict[str, float]:
    return {"posetime": seconds, "posex": x, "posey": y, "heading": heading}


def wheels(seconds: float, left: float, right: float) -> dict[str, float]:
    return {"veltime": seconds, "velleft": left, "velright": right}


def test_odometry_adds_up_poses_and_unwraps_the_heading() -> None:
    odometry = Odometry()
    for number, (x, heading) in enumerate([(0.0, 3.1), (-0.01, 3.14), (-0.02, -3.13)]):
        odometry.take_pose(pose(0.01 * number, x, 0.0, heading))
    assert odometry.distance == pytest.approx(0.02, abs=1e-5)
    assert odometry.heading == pytest.approx(2 * 3.141592653589793 - 3.13 - 3.1)


def test_odometry_does_not_count_a_reset_pose() -> None:
    odometry = Odometry()
    for number, x in enumerate([1.0, 1.01, 0.0, 0.01]):
        odometry.take_pose(pose(0.01 * number, x, 0.0, 0.0))
    assert odometry.distance == pytest.approx(0.02)


def test_odometry_integrates_wheel_speeds() -> None:
    odometry = Odometry()
    for number in range(101):
        assert odometry.take_wheels(wheels(0.01 * number, 0.1, 0.2))
    assert odometry.distance == pytest.approx(0.15)
    assert odometry.heading == pytest.approx(0.1 / 0.23)


def test_odometry_skips_an_interruption() -> None:
    odometry = Odometry()
    odometry.take_wheels(wheels(0.0, 0.1, 0.1))
    odometry.take_wheels(wheels(5.0, 0.1, 0.1))
    odometry.take_wheels(wheels(1.0, 0.1, 0.1))  # the Teensy was restarted
    assert odometry.distance == 0.0


def test_odometry_prefers_poses() -> None:
    odometry = Odometry()
    odometry.take_pose(pose(0.0, 0.0, 0.0, 0.0))
    assert not odometry.take_wheels(wheels(0.0, 1.0, 1.0))
