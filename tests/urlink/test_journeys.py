"""How many modules a reader meets who follows one call through the code: counted by running it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType

from tests.urlink.motion.rehearsal import Rehearsal, turned

#: Checks of arguments and facts about the robot: a reader looks them up, and the command does not go through them.
LOOKED_UP = {
    "linkcore.arguments",
    "urlink.vectors",
    "urlink.urscript.text",
    "urlink.identity",
    "urlink.models",
    "urlink.firmware",
}


def modules_met(call: Callable[[], object]) -> set[str]:
    """The modules of the project in which any function runs during a call, in this thread."""
    met: set[str] = set()

    def look(frame: FrameType, event: str, argument: object) -> None:
        name = str(frame.f_globals.get("__name__", ""))
        if name.partition(".")[0] in ("urlink", "linkcore"):
            met.add(name)

    before = sys.getprofile()
    sys.setprofile(look)
    try:
        call()
    finally:
        sys.setprofile(before)
    return met


def test_move_joints() -> None:
    with Rehearsal() as robot:
        robot.motion.move_joints(turned(0.1))  # the second one connects and asks no more
        met = modules_met(lambda: robot.motion.move_joints(turned(0.2)))
    assert met - LOOKED_UP == {
        "urlink.motion.motions",  # arguments
        "urlink.urscript.programs",  # the text
        "urlink.urscript.wrapping",  # what is put around it
        "linkcore.handle",  # the one state machine of its life
        "urlink.commanding.programs",  # the registry
        "urlink.commanding.channel",  # the one way out
        "urlink.commanding.section",
        "urlink.commanding.monitor",
        "urlink.commanding.interlock",  # may it leave?
        "linkcore.streaming.connection",
    }
