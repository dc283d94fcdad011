"""Firmware versions: parsing them, and `Since` for fields that only some versions send."""

from __future__ import annotations

import pickle
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadVersion, LocalError, PacketError, RemoteError
from linkcore.wire.fields import Since, Version, parse_version


@pytest.mark.parametrize(
    ("text", "version"),
    [
        ("1.8", (1, 8)),
        ("3.10", (3, 10)),
        (" 5.11 ", (5, 11)),
        ("5.11.1.108318", (5, 11, 1, 108318)),
        ("3.2.19293", (3, 2, 19293)),
        ((5, 4), (5, 4)),
    ],
)
def test_parse_version_accepts_valid_texts(text: str | Version, version: Version) -> None:
    assert parse_version(text) == version


@pytest.mark.parametrize(
    "text", ["", "5", "5.", ".5", "5.x", "5.-1", "v5.1", "5,1", "5.1.", "５.１", "5.1234567890", "5 .1"]
)
def test_parse_version_rejects_invalid_texts(text: str) -> None:
    with pytest.raises(BadVersion, match="is not a version") as caught:
        parse_version(text)
    assert isinstance(caught.value, (LocalError, ValueError))


@given(st.lists(st.integers(0, 999_999), min_size=2, max_size=5))
def test_parse_version_round_trips_numbers(numbers: list[int]) -> None:
    assert parse_version(".".join(map(str, numbers))) == tuple(numbers)


@given(st.text(max_size=12))
def test_parse_version_of_any_text_returns_or_raises_bad_version(text: str) -> None:
    try:
        version = parse_version(text)
    except BadVersion:
        return
    assert len(version) >= 2
    assert all(number >= 0 for number in version)


@pytest.mark.parametrize(
    ("since", "present", "absent"),
    [
        ("0.0", [(0, 0), (1, 5), (9, 9)], []),
        ("3.2", [(3, 2), (3, 2, 0), (3, 10), (4, 0), (5, 0)], [(1, 8), (3, 1), (3, 1, 99)]),
        # A field that 3.10 and 5.4 introduced; versions 5.0 to 5.3 do not have it.
        ("3.10/5.4", [(3, 10), (3, 15), (4, 0), (5, 4), (5, 25), (10, 7)], [(1, 8), (3, 9), (5, 0), (5, 3, 7)]),
        ("5.0/3.5", [(3, 5), (5, 0)], [(3, 4)]),
    ],
)
def test_since_contains_versions_by_generation(since: str, present: list[Version], absent: list[Version]) -> None:
    span = Since(since)
    assert [version for version in present if version not in span] == []
    assert [version for version in absent if version in span] == []
    assert repr(span) == f"Since('{since}')"


@given(st.sampled_from(["0.0", "1.6", "3.10/5.4", "3.5/5.0", "3.14/5.9", "1.7/3.2/5.4"]), st.data())
def test_since_gives_same_answer_between_its_steps(text: str, data: st.DataObject) -> None:
    since = Since(text)
    one, other = sorted(data.draw(st.tuples(st.integers(0, 7), st.integers(0, 20))) for _ in range(2))
    if not any(one < step <= other for step in since.steps):
        assert (one in since) == (other in since)


def test_pickled_packet_error_keeps_its_attributes() -> None:
    facts: dict[str, Any] = {"packet": "P", "version": "5.4", "expected": 10, "actual": 7, "offset": 7}
    error = PacketError("packet too short", **facts)
    assert str(error) == "P of firmware 5.4: packet too short: expected 10 bytes, got 7 (at offset 7)"
    assert isinstance(error, (RemoteError, ValueError))
    again = pickle.loads(pickle.dumps(error))
    assert vars(again) == {"reason": "packet too short", **facts}
    assert str(again) == str(error)
