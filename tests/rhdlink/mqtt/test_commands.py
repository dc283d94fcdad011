"""The commands to a robot with MQTT, in both dialects."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadAddress, BadValue
from rhdlink.address import MqttAddress, is_mqtt, parse_address, parse_mqtt_address
from rhdlink.mqtt.commands import (
    DIALECTS,
    FASTEST,
    STANDSTILL,
    Command,
    alive,
    configure,
    find_dialect,
    leds,
    new_identity,
    stop,
    teensy,
    velocity,
)

OLD, NEW = DIALECTS["2025"], DIALECTS["2026"]


@pytest.mark.parametrize(
    ("command", "old", "new"),
    [
        (velocity(0.1, 0.5), ("robobot/cmd/ti/rc", "0.1 0.5"), ("robobot/cmd/ti", "rc 0.1 0.5")),
        (
            velocity(0.25, 0, time=7.5),
            ("robobot/cmd/ti/rc", "0.250 0.000 7.5"),
            ("robobot/cmd/ti", "rc 0.250 0.000 7.5"),
        ),
        (STANDSTILL, ("robobot/cmd/ti/rc", "0 0"), ("robobot/cmd/ti", "rc 0 0")),
        (stop(), ("robobot/cmd/T0/stop", " "), ("robobot/cmd/T0", "stop")),
        (alive("now"), ("robobot/cmd/ti/alive", "now"), ("robobot/cmd/ti", "alive now")),
        (leds(16, 0, 0, 30), ("robobot/cmd/T0/leds", "16 0 0 30"), ("robobot/cmd/T0", "leds 16 0 0 30")),
        (teensy("sub livn 10"), ("robobot/cmd/T0/sub", "livn 10"), ("robobot/cmd/T0", "sub livn 10")),
        (
            configure(0.074, 0.074, 19, 68, 0.23),
            ("robobot/cmd/T0/confw", "0.074 0.074 19 68 0.23"),
            ("robobot/cmd/T0", "confw 0.074 0.074 19 68 0.23"),
        ),
    ],
)
def test_dialects_encode_and_decode_commands(command: Command, old: tuple[str, str], new: tuple[str, str]) -> None:
    for dialect, message in ((OLD, old), (NEW, new)):
        assert dialect.encode(command) == message
        assert dialect.decode(message[0], message[1].encode()) == command


def test_robot_of_2026_ignores_the_last_part_of_the_topic() -> None:
    assert NEW.decode("robobot/cmd/T0/leds", b"leds 16 0 0 100") == leds(16, 0, 0, 100)


def test_alive_of_the_other_dialect_is_not_understood() -> None:
    """Recognising the dialect sends both forms, so a robot must not take one for another command."""
    identity = "2026-11-29 04:00:00.000000"
    topic, payload = NEW.encode(alive(identity))
    assert OLD.decode(topic, payload.encode()) is None
    topic, payload = OLD.encode(alive(identity))
    other = NEW.decode(topic, payload.encode())
    assert other is not None
    assert other.keyword == "2026-11-29"


@pytest.mark.property
@given(
    keyword=st.from_regex(r"[a-z][a-z0-9]{0,15}", fullmatch=True),
    words=st.lists(st.text("abc0123456789.-:", min_size=1, max_size=8), max_size=6),
)
def test_teensy_command_is_read_back(keyword: str, words: list[str]) -> None:
    command = teensy(" ".join([keyword, *words]))
    for each in (OLD, NEW):
        topic, payload = each.encode(command)
        assert each.decode(topic, payload.encode()) == command


@pytest.mark.property
@given(linear=st.floats(-FASTEST, FASTEST), angular=st.floats(-FASTEST, FASTEST))
def test_velocity_is_read_back_exactly(linear: float, angular: float) -> None:
    topic, payload = NEW.encode(velocity(linear, angular))
    command = NEW.decode(topic, payload.encode())
    assert command is not None
    assert [float(word) for word in command.arguments.split()] == [linear, angular]


@pytest.mark.property
@given(topic=st.text(max_size=40), payload=st.binary(max_size=60))
def test_decode_accepts_any_message(topic: str, payload: bytes) -> None:
    for each in (OLD, NEW):
        for name in (topic, f"robobot/cmd/{topic}"):
            command = each.decode(name, payload)
            assert command is None or isinstance(command.keyword, str)


@pytest.mark.parametrize("text", ["", "Stop", "leds\n16", "lip \x00", "léds 1", " ", "a" * 20])
def test_teensy_rejects_invalid_commands(text: str) -> None:
    with pytest.raises(BadValue, match="expected a keyword and arguments"):
        teensy(text)


@pytest.mark.parametrize(("linear", "angular"), [(11.0, 0.0), (0.0, -11.0), (float("nan"), 0.0), ("1", 0.0)])
def test_velocity_rejects_invalid_numbers(linear: float, angular: float) -> None:
    with pytest.raises(BadValue, match=r"linear|angular"):
        velocity(linear, angular)


def test_leds_rejects_a_colour_above_255() -> None:
    with pytest.raises(BadValue, match="green"):
        leds(14, 0, 256, 0)


def test_find_dialect_names_the_dialects() -> None:
    with pytest.raises(BadValue, match="dialect is '2027'; expected one of 2025, 2026"):
        find_dialect("2027")


def test_new_identity_always_has_the_same_length() -> None:
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{6}", new_identity())


# -- addresses -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("mqtt://192.168.0.55", MqttAddress("192.168.0.55", 1883, None)),
        (" MQTT://robobot:1884/ ", MqttAddress("robobot", 1884, None)),
        ("mqtt://[::1]:1884?dialect=2025", MqttAddress("::1", 1884, "2025")),
    ],
)
def test_parse_mqtt_address_reads_host_port_and_dialect(text: str, address: MqttAddress) -> None:
    assert is_mqtt(text)
    assert parse_mqtt_address(text) == address
    assert parse_mqtt_address(str(address)) == address


@pytest.mark.parametrize(
    "text",
    [
        "mqtt://",
        "mqtt://a b",
        "mqtt://a:0",
        "mqtt://a:x",
        "mqtt://u@a",
        "mqtt://a/b",
        "mqtt://a?b=1",
        "mqtt://a?x",
        "a",
    ],
)
def test_parse_mqtt_address_rejects_other_texts(text: str) -> None:
    with pytest.raises(BadAddress, match="expected mqtt://HOST"):
        parse_mqtt_address(text)


def test_parse_address_names_both_schemes() -> None:
    with pytest.raises(BadAddress, match="unknown scheme 'http' in address 'http://a'; expected 'rhd' or 'mqtt'"):
        parse_address("http://a")
