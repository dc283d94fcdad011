"""The file of points: round trip, damaged files, names, locks and atomic changes."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import subprocess
import sys
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue, LocalError
from tests.platforms import MACHINE
from urlink import NoSuchPoint, Point
from urlink.motion.points import point_file
from urlink.motion.points.point_file import PointFile, parse, to_text

DATE = datetime(2026, 3, 1, 12, tzinfo=timezone.utc)
POINT = Point([0.0, -1.5, 2.0, -2.0, -1.5, 0.0], [0.4, -0.1, 0.3, 0.0, 3.0, 0.0], [0.0] * 6, "UR5e", DATE)  # type: ignore[arg-type]

ROTATION = st.tuples(*[st.floats(-3.0, 3.0)] * 3)
POSES = st.builds(lambda xyz, r: [*xyz, *r], st.tuples(*[st.floats(-1.0, 1.0)] * 3), ROTATION)
DATES = st.datetimes(datetime(1971, 1, 1), datetime(9000, 1, 1), timezones=st.just(timezone(timedelta(hours=2))))
POINTS = st.builds(
    Point,
    q=st.lists(st.floats(-1e6, 1e6), min_size=6, max_size=6),
    pose=POSES,
    tcp=POSES,
    model=st.sampled_from(["UR5e", "UR3", "UR99 ü"]),
    date=DATES,
)
NAMES = st.text(min_size=1, max_size=100).filter(lambda name: name.isprintable() and name == name.strip())


def entries(**changed: Any) -> dict[str, Any]:
    """Return the entries of a valid point, with changes; an entry that is ... is left out."""
    held = point_file.described(POINT) | changed
    return {key: value for key, value in held.items() if value is not ...}


def content(points: Any, **changed: Any) -> bytes:
    return json.dumps({"format": "urlink points", "version": 1, "points": points} | changed).encode()


@pytest.mark.property
@given(st.dictionaries(NAMES, POINTS, max_size=4))
def test_points_survive_a_round_trip(points: dict[str, Point]) -> None:
    text = to_text(points)
    read = parse(text.encode())
    assert read == points
    assert list(read) == list(points)
    assert json.loads(text)["version"] == 1


@pytest.mark.property
@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_parse_of_random_bytes_raises_bad_value(text: bytes) -> None:
    with pytest.raises(BadValue):
        parse(text)


@pytest.mark.property
@given(st.data())
def test_parse_of_a_changed_byte_never_crashes(data: st.DataObject) -> None:
    text = bytearray(to_text({"bin": POINT}).encode())
    text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.integers(0, 255))
    with contextlib.suppress(BadValue):
        for point in parse(bytes(text)).values():
            assert isinstance(point, Point)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"{", "not a JSON file: .*line 1 column 2"),
        (b"\xff", "not a JSON file: byte 0 is not UTF-8"),
        (b"[" * 100_000, "not a JSON file"),
        (b"[]", 'expected an object whose "format" is "urlink points"'),
        (content({}, format="other"), 'expected an object whose "format"'),
        (content({}, version=2), "unknown version 2; expected 1"),
        (content({}, version=True), "unknown version True; expected 1"),
        (content([]), '"points" must be an object'),
        (content({}, more=1), 'the file has an unknown entry "more"; expected format, version, points'),
        (b'{"format": "urlink points", "version": 1}', 'the file has no "points"'),
        (b'{"format": "urlink points", "format": "a"}', '"format" occurs twice'),
        (content({" a": entries()}), "point name ' a'; expected 1 to 100 printable"),
        (content({"bin": 3}), "point 'bin': expected an object with model, date, q, pose, tcp"),
        (content({"bin": entries(tcp=...)}), "point 'bin': the point has no \"tcp\""),
        (content({"bin": entries(note="x")}), "point 'bin': the point has an unknown entry \"note\""),
        (content({"bin": entries(q=[0, 1])}), r"point 'bin': q has the shape \(2,\); expected six numbers"),
        (content({"bin": entries(q=[0, 1, 2, 3, 4, True])}), "point 'bin': \"q\" must be a list of six numbers"),
        (content({"bin": entries(q="012345")}), "point 'bin': \"q\" must be a list of six numbers"),
        (content({"bin": entries(q=[math.nan] * 6)}), r"point 'bin': q\[0\] is not finite"),
        (content({"bin": entries(q=[10**400] * 6)}), "point 'bin': q: expected numbers"),
        (content({"bin": entries(pose=[500, 0, 0, 0, 0, 0])}), "point 'bin': the position in pose"),
        (content({"bin": entries(tcp=[0, 0, 0, 90, 0, 0])}), "point 'bin': the rotation vector in tcp"),
        (content({"bin": entries(model=None)}), "point 'bin': model is None; expected the name of an arm"),
        (content({"bin": entries(date="yesterday")}), "point 'bin': \"date\" is 'yesterday'; expected a date"),
        (content({"bin": entries(date=5)}), "point 'bin': \"date\" is 5; expected a date"),
        (content({"bin": entries(date="2026-03-01T12:00:00")}), "point 'bin': date is .* with a time zone"),
        (content({"bin": entries(date="0001-01-01T00:00:00+05:00")}), "point 'bin': date is .* from year 1"),
    ],
)
def test_damaged_file_is_refused_with_the_place(tmp_path: Path, text: bytes, message: str) -> None:
    file = PointFile(tmp_path / "cell.json")
    file.path.write_bytes(text)
    for call in (file.read, lambda: file.add({"new": POINT}, replace=True), lambda: file.remove(("bin",))):
        with pytest.raises(BadValue, match=f"cell.json: {message}"):
            call()
    assert file.path.read_bytes() == text


def test_date_with_suffix_z_is_read() -> None:
    assert parse(content({"bin": entries(date="2026-03-01T12:00:00Z")}))["bin"].date == DATE


def test_change_by_another_program_is_read(tmp_path: Path) -> None:
    mine, other = PointFile(tmp_path / "cell.json"), PointFile(tmp_path / "cell.json")
    mine.add({"bin": POINT}, replace=False)
    points = mine.read()
    points.clear()
    assert mine.read() == {"bin": POINT}
    other.add({"new": POINT}, replace=False)
    assert list(mine.read()) == ["bin", "new"]
    mine.path.unlink()
    assert mine.read() == {}


def test_missing_file_has_no_points(tmp_path: Path) -> None:
    assert PointFile(tmp_path / "none.json").read() == {}


def test_unreadable_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match="cannot read "):
        PointFile(tmp_path).read()


def test_unwritable_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LocalError, match=r"cannot lock .*cell.json: No such file"):
        PointFile(tmp_path / "none" / "cell.json").add({"bin": POINT}, replace=False)


@pytest.mark.parametrize("name", ["", " a", "a\n", "\ud800", "x" * 101, 5, None])
def test_add_refuses_an_invalid_name(tmp_path: Path, name: Any) -> None:
    file = PointFile(tmp_path / "cell.json")
    with pytest.raises(BadValue, match="point name"):
        file.add({name: POINT}, replace=False)
    assert not list(tmp_path.iterdir())


def test_add_keeps_an_existing_point_without_replace(tmp_path: Path) -> None:
    file = PointFile(tmp_path / "cell.json")
    file.add({"bin": POINT}, replace=False)
    other = Point(POINT.q + 0.1, POINT.pose, POINT.tcp, "UR5e", DATE)
    with pytest.raises(BadValue, match="already has a point 'bin', taught on 2026-03-01; pass replace=True"):
        file.add({"new": POINT, "bin": other}, replace=False)
    assert file.read() == {"bin": POINT}
    file.add({"bin": other}, replace=True)
    assert file.read() == {"bin": other}


def test_unknown_name_is_refused_with_a_suggestion(tmp_path: Path) -> None:
    file = PointFile(tmp_path / "cell.json")
    with pytest.raises(NoSuchPoint, match=re.escape("has no point 'bin'; it has no points")):
        file.point("bin")
    file.add({"above_bin": POINT}, replace=False)
    with pytest.raises(KeyError) as caught:
        file.remove(("above_bin", "abov_bin"))
    assert str(caught.value) == f"{file.path} has no point 'abov_bin'; did you mean 'above_bin'?"
    assert file.remove(("above_bin", "above_bin")) == [POINT, POINT]
    assert file.read() == {}


def test_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = PointFile(tmp_path / "cell.json")
    file.add({"bin": POINT}, replace=False)

    def fail(number: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(LocalError, match=r"cannot write .*cell.json: No space left"):
        file.add({"new": POINT}, replace=False)
    assert file.read() == {"bin": POINT}
    assert {each.name for each in tmp_path.iterdir()} == {"cell.json", ".cell.json.lock"}


@pytest.mark.skipif(sys.platform == "win32", reason=MACHINE)
def test_change_keeps_link_and_permissions(tmp_path: Path) -> None:
    target = tmp_path / "shared.json"
    target.write_text(to_text({}))
    target.chmod(0o640)
    link = tmp_path / "cell.json"
    link.symlink_to(target)
    PointFile(link).add({"bin": POINT}, replace=False)
    assert link.is_symlink()
    assert PointFile(target).read() == {"bin": POINT}
    assert target.stat().st_mode & 0o777 == 0o640


@pytest.mark.simulated_time
def test_locked_file_is_refused_after_5_s(tmp_path: Path) -> None:
    file = PointFile(tmp_path / "cell.json")
    with (tmp_path / ".cell.json.lock").open("w") as held:
        assert point_file._try_lock(held.fileno())
        with pytest.raises(LocalError, match=r"has kept .*cell.json locked for 5 s; nothing was changed"):
            file.add({"bin": POINT}, replace=False)
    assert file.read() == {}
    file.add({"bin": POINT}, replace=False)
    assert file.read() == {"bin": POINT}


def test_change_holds_the_lock_while_it_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read, locked = PointFile.read, []

    def spy(file: PointFile) -> dict[str, Point]:
        with (tmp_path / ".cell.json.lock").open("w") as other:
            locked.append(not point_file._try_lock(other.fileno()))
        return read(file)

    monkeypatch.setattr(PointFile, "read", spy)
    file = PointFile(tmp_path / "cell.json")
    file.add({"bin": POINT}, replace=False)
    file.remove(("bin",))
    assert locked == [True, True]


WRITER = """
import sys
from urlink.motion.points.point_file import PointFile
file, own = PointFile(sys.argv[1]), PointFile(sys.argv[2])
for name, point in own.read().items():
    file.add({name: point}, replace=False)
"""


@pytest.mark.slow
@pytest.mark.real_time
def test_changes_of_several_processes_are_all_kept(tmp_path: Path) -> None:
    processes = []
    for writer in range(3):
        own = tmp_path / f"own{writer}.json"
        PointFile(own).add({f"{writer} {number}": POINT for number in range(15)}, replace=False)
        command = [sys.executable, "-c", WRITER, str(tmp_path / "cell.json"), str(own)]
        processes.append(subprocess.Popen(command))
    assert [process.wait(120) for process in processes] == [0, 0, 0]
    assert len(PointFile(tmp_path / "cell.json").read()) == 45
