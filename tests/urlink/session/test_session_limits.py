"""Limits of a session: their values, files, and comparisons without an arm."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from linkcore.errors import BadValue, LocalError
from urlink.errors import LimitExceeded
from urlink.session.connect_options import ConnectOptions
from urlink.session.session_limits import CHECKED, KINDS, MARGIN, UNCHECKED, WATCHED, SessionLimits

BOX = ((-0.5, -0.4, 0.1), (0.5, 0.4, 0.8))


@pytest.mark.parametrize(
    "wrong",
    [
        {"tool_speed": 0.0},
        {"tool_speed": float("nan")},
        {"joint_speed": -1.0},
        {"speed_slider": 1.5},
        {"box": ((0, 0, 0), (1, 1, -1))},
        {"box": ((0, 0), (1, 1))},
        {"box": "everywhere"},
        {"box": ((0, 0, 0), (1, 1, 900))},
        {"allowed": "jog"},
        {"allowed": ("move_jonts",)},
    ],
)
def test_session_limits_reject_bad_values(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue):
        SessionLimits(**wrong)


def test_connect_rejects_limits_of_another_type() -> None:
    with pytest.raises(BadValue, match="SessionLimits"):
        ConnectOptions("sim://", limits={"tool_speed": 0.2})  # type: ignore[arg-type]


def test_load_reads_what_a_file_contains(tmp_path: Path) -> None:
    path = tmp_path / "lab.json"
    path.write_text(json.dumps({"tool_speed": 0.2, "box": BOX, "allowed": ["jog", "script.run"]}))
    assert SessionLimits.load(path) == SessionLimits(tool_speed=0.2, box=BOX, allowed=("jog", "script.run"))
    assert SessionLimits.named(str(path)) == SessionLimits.load(path)


@pytest.mark.parametrize("text", ["", "[]", '{"tool_sped": 0.2}', '{"tool_speed": 99}', '{"allowed": ["run"]}'])
def test_load_names_the_file_of_bad_limits(tmp_path: Path, text: str) -> None:
    path = tmp_path / "lab.json"
    path.write_text(text)
    with pytest.raises(BadValue, match=r"lab\.json"):
        SessionLimits.load(path)


def test_load_rejects_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match="cannot read"):
        SessionLimits.named(str(tmp_path / "none.json"))


def test_teaching_allows_slow_motions_and_freedrive() -> None:
    limits = SessionLimits.named("teaching")
    for kind in (*CHECKED, "freedrive", "stop"):
        limits.allow(kind)
    for kind in (*UNCHECKED, "torque", "force_mode", "impedance"):
        with pytest.raises(LimitExceeded):
            limits.allow(kind)
    assert SessionLimits.teaching(BOX).box == BOX


def test_allow_refuses_kinds_that_are_not_listed() -> None:
    limits = SessionLimits()
    for kind in (*WATCHED, *UNCHECKED, "a program"):
        with pytest.raises(LimitExceeded, match=kind):
            limits.allow(kind)
    SessionLimits(allowed=KINDS).allow("script.run")


def test_limit_exceeded_names_limit_value_and_expected() -> None:
    with pytest.raises(LocalError) as caught:
        SessionLimits(speed_slider=0.5).check_slider(0.8)
    error = caught.value
    assert isinstance(error, LimitExceeded)
    assert (error.limit, error.value, error.expected) == (
        "speed_slider",
        "the speed slider would be at 0.8",
        "at most 0.5",
    )
    assert "0.8" in str(error)
    assert "at most 0.5" in str(error)


def test_check_slider_accepts_the_limit_itself() -> None:
    SessionLimits(speed_slider=0.5).check_slider(0.5)
    SessionLimits().check_slider(1.0)


def test_check_places_keeps_the_margin() -> None:
    limits = SessionLimits(box=BOX)
    limits.check_places(np.array([[0.5 - 1.01 * MARGIN, 0.0, 0.5]]))
    with pytest.raises(LimitExceeded, match=r"x = 0\.4995 m"):
        limits.check_places(np.array([[0.0, 0.0, 0.5], [0.5 - 0.5 * MARGIN, 0.0, 0.5]]))
    with pytest.raises(LimitExceeded):
        limits.check_places(np.full((1, 3), np.nan))


def test_check_speeds_compares_each_joint_and_the_tool() -> None:
    limits = SessionLimits(tool_speed=0.25, joint_speed=1.0)
    limits.check_joint_speeds(np.full((2, 6), -1.0))
    limits.check_tool_speeds(np.array([0.25]))
    with pytest.raises(LimitExceeded, match="elbow"):
        limits.check_joint_speeds(np.array([[0.0, 0.0, -1.1, 0.0, 0.0, 0.0]]))
    with pytest.raises(LimitExceeded, match=r"0\.26 m/s"):
        limits.check_tool_speeds(np.array([0.1, 0.26]))
    with pytest.raises(LimitExceeded):
        limits.check_tool_speeds(np.array([np.nan]))
