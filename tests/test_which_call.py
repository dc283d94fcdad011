"""The page that helps readers to choose a call names calls that exist."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import urlink
from linkcore.handle import Motion

PAGE = Path(__file__).resolve().parents[1] / "docs" / "which-call.md"
TEXT = PAGE.read_text(encoding="utf-8")
#: Calls of the cheat sheet, without their arguments.
CALLS = re.findall(r"^\| `([\w.]+)", TEXT, re.MULTILINE)


def test_cheat_sheet_has_about_forty_calls() -> None:
    assert 38 <= len(CALLS) <= 45, f"{PAGE} lists {len(CALLS)} calls; the text at its top says some forty"


@pytest.mark.simulated_time
def test_every_call_of_the_cheat_sheet_exists() -> None:
    with urlink.connect("sim://") as robot:
        objects: dict[str, Any] = {
            "urlink": urlink,
            "robot": robot,
            "motion": robot.motion,
            "handle": Motion,
            "recording": urlink.Recording,
        }
        missing = []
        for call in CALLS:
            first, *names = call.split(".")
            found = objects[first]
            for name in names:
                found = getattr(found, name, None)
                if found is None and name != "latest":
                    missing.append(call)
                    break
    assert not missing, f"{PAGE} names calls that do not exist: {', '.join(missing)}"


@pytest.mark.simulated_time
def test_every_motion_call_is_on_the_page() -> None:
    with urlink.connect("sim://") as robot:
        ways = [name for name in dir(robot.motion) if name[0] != "_" and name != "current"]
    missing = [name for name in ways if f"motion.{name}(" not in TEXT]
    assert not missing, f"add a row to {PAGE} for motion.{', motion.'.join(missing)}"
