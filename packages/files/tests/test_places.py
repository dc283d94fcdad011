"""Names of files on a controller."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from urlink import BadValue
from urlink_files.places import patterns_of, target_of


@pytest.mark.parametrize(
    ("name", "patterns"),
    [
        ("programs", ["/programs/*"]),
        ("programs/", ["/programs/*"]),
        ("programs/cell/../*.urp", ["/programs/*.urp"]),
        ("logs", ["/root/log_history*", "/root/polyscope.log*"]),
        ("flightreports/1.zip", ["/root/flightreports/1.zip"]),
        ("/programs//a", ["/programs/a"]),
    ],
)
def test_patterns_of_names(name: str, patterns: list[str]) -> None:
    assert patterns_of(name) == patterns


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("program", "'program' is not a place on the controller; did you mean 'programs'"),
        ("", "expected programs, logs, flightreports, or a path"),
        ("programs/../etc/passwd", "'../etc/passwd' is not below /programs"),
        ("programs//etc/passwd", "'/etc/passwd' is not below /programs"),
        ("a\nb", "is not a path on the controller"),
        (5, "5 is not a path on the controller"),
    ],
)
def test_invalid_name_is_refused(name: Any, message: str) -> None:
    with pytest.raises(BadValue, match=message):
        patterns_of(name)


def test_target_is_below_programs() -> None:
    assert target_of("programs", "a.urp") == "/programs/a.urp"
    assert target_of("programs/cell", "a.urp") == "/programs/cell/a.urp"
    for folder in ("logs", "/programs", "programs/..", "programs/../root"):
        with pytest.raises(BadValue):
            target_of(folder, "a.urp")


@pytest.mark.property
@given(st.text("ab./", max_size=12), st.text("ab.", max_size=4))
def test_target_never_leaves_programs(folder: str, file: str) -> None:
    try:
        target = target_of(f"programs/{folder}", file)
    except BadValue:
        return
    assert target.startswith("/programs/")
    assert ".." not in target.split("/")
