"""Names in docstrings and pages lead to the API reference, and signatures show short types."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import urlink
from urlink.arm import poses
from urlink.arm.kinematics import Arm

DOCS = Path(__file__).resolve().parents[1] / "docs"
#: Some of the names that the API reference contains.
DOCUMENTED = (
    "rhdlink.Variables",
    "rhdlink.Variables.sync",
    "rhdlink.connect",
    "urlink.Feed",
    "urlink.Feed.plot",
    "urlink.Handle",
    "urlink.Handle.wait",
    "urlink.Motion",
    "urlink.RealtimeState",
    "urlink.Robot",
    "urlink.Robot.motion",
    "urlink.Stream",
    "urlink.Trajectory",
    "urlink.connect",
    "urlink.motion.Motions",
    "urlink.motion.Motions.jog",
    "urlink.motion.Motions.stop",
    "urlink_compat.urx.robot.Robot",
)


@pytest.fixture(scope="module")
def extensions() -> Iterator[None]:
    sys.path.insert(0, str(DOCS / "_extensions"))
    yield
    sys.path.remove(str(DOCS / "_extensions"))


@pytest.fixture(scope="module")
def names(extensions: None) -> Any:
    return importlib.import_module("_names").Names(DOCUMENTED)


@pytest.fixture(scope="module")
def signatures(extensions: None) -> Any:
    return importlib.import_module("signatures")


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("urlink.connect", "urlink.connect"),
        ("connect", "urlink.connect"),
        ("Motion", "urlink.Motion"),
        ("Motion.wait", "urlink.Handle.wait"),
        ("Motions.stop", "urlink.motion.Motions.stop"),
        ("robot.motion", "urlink.Robot.motion"),
        ("robot.motion.jog", "urlink.motion.Motions.jog"),
        ("robot.realtime.plot", "urlink.Feed.plot"),
        ("state.q_actual", "urlink.RealtimeState"),
        ("robot.nothing", None),
        ("Motion.nothing", None),
        ("timeout", None),
        ("time.time", None),
    ],
)
def test_name_in_page_resolves_to_its_public_name(names: Any, text: str, name: str | None) -> None:
    assert names.public(text, False) == name


def test_page_of_rhdlink_prefers_names_of_rhdlink(names: Any) -> None:
    assert names.public("connect", True) == "rhdlink.connect"
    assert names.public("robot.sync", True) == "rhdlink.Variables.sync"


def test_docstring_name_is_looked_up_in_its_class(names: Any) -> None:
    assert names.in_docstring("stop", "urlink.motion", "Motions") == "urlink.motion.Motions.stop"
    assert names.in_docstring("wait", "urlink", "Motion") == "urlink.Handle.wait"
    assert names.in_docstring("stop", "urlink", "Motion") is None
    assert names.in_docstring("Trajectory", "urlink.motion", "Motions") == "urlink.Trajectory"


def test_types_of_arguments_are_short(signatures: Any) -> None:
    move = signatures.types_of(urlink.motion.Motions.move_joints)
    assert [each.__name__ for each in move["q"].__args__] == ["Joints", "Point"]
    assert move["return"] is urlink.Motion
    linear = signatures.types_of(urlink.motion.Motions.move_linear)
    assert [each.__name__ for each in linear["pose"].__args__] == ["Pose", "Point"]
    forward = signatures.types_of(Arm.forward)
    assert [forward[name].__name__ for name in ("q", "return")] == ["ArrayLike", "NDArray"]
    assert {each.__name__ for each in forward["tcp"].__args__} == {"ArrayLike", "NoneType"}
    assert signatures.types_of(poses.compose)["return"].__name__ == "NDArray"


def test_api_page_describes_each_type_of_the_signatures(signatures: Any) -> None:
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    heading, _, rest = page.partition("## Types in signatures\n")[2].partition("```{toctree}")
    assert rest
    assert set(re.findall(r"^\| `(\w+)` \|", heading, re.MULTILINE)) == signatures.NAMES
    assert signatures.ANCHOR == "types-in-signatures"
