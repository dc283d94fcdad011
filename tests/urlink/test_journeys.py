"""How many modules a reader meets who follows one call through the code: counted by running it."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from types import FrameType

import pytest

from linkcore.simulated.primitives import hash_
from tests.fakes.rehearsal import Rehearsal, turned
from urlink.simulator import Controller

#: Once the command has left, the states are subscribed to: an arm that is moved while it is paused is stopped.
SUBSCRIBING = {
    "urlink.command.program_time",
    "linkcore.threads",
    "linkcore.streaming.connection_life",
    "linkcore.streaming.fanout",
    "linkcore.streaming.feed",
    "linkcore.streaming.packet_queue",
    "linkcore.streaming.stream",
    "linkcore.streaming.subscription",
}

#: Checks of arguments and facts about the robot: a reader looks them up, and the command does not go through them.
LOOKED_UP = {
    "linkcore.arguments",
    "urlink.arm.bounds",
    "urlink.arm.vectors",
    "urlink.script.text",
    "urlink.session.identity",
    "urlink.arm.models",
    "urlink.protocol.firmware",
    "linkcore.wire.fields",
}


def modules_met(call: Callable[[], object]) -> set[str]:
    """The modules of the project in which any function runs during a call, in this thread."""
    met: set[str] = set()

    def look(frame: FrameType, event: str, argument: object) -> None:
        name = str(frame.f_globals.get("__name__", ""))
        # Once time was simulated in this process, that is the hash of a thread.
        if name.partition(".")[0] in ("urlink", "linkcore") and frame.f_code is not hash_.__code__:
            met.add(name)

    # What earlier tests have left is collected before: its finalizers would run in this thread.
    gc.collect()
    gc.disable()
    before = sys.getprofile()
    sys.setprofile(look)
    try:
        call()
    finally:
        sys.setprofile(before)
        gc.enable()
    return met


@pytest.mark.real_time
def test_move_joints() -> None:
    with Rehearsal() as robot:
        robot.motion.move_joints(turned(0.1))  # the second one connects and asks no more
        met = modules_met(lambda: robot.motion.move_joints(turned(0.2)))
    assert met >= SUBSCRIBING
    assert met - LOOKED_UP - SUBSCRIBING == {
        "urlink.motion.motions",  # arguments
        "urlink.script.commands",  # the text
        "urlink.script.wrapping",  # what is put around it
        "linkcore.handle",  # the one state machine of its life
        "linkcore.pending_call",  # the order of calls and stops; whether the task that awaits this was cancelled
        "linkcore.names",  # no attribute is set that the object does not have
        "linkcore.process",  # this is the process that has connected
        "urlink.command.programs",  # the registry
        "urlink.command.channel",  # the one way out
        "linkcore.net.undo",  # is anything given up before that may still be carried out?
        "urlink.command.section",
        "urlink.command.safety_monitor",
        "urlink.command.interlock",  # may it leave?
        "linkcore.streaming.connection",  # is this the thread that reads?
        "linkcore.clock",  # how old is the news?
    }


#: What else a cycle of the simulated controller brings up to date, whether a program runs or not.
EVERY_CYCLE = {
    "urlink.simulator.state",
    "urlink.simulator.faults.schedule",
    "urlink.simulator.registers",
    "urlink.simulator.robot.modes",
    "urlink.simulator.robot.sensors",
    "urlink.simulator.robot.surroundings",
}


def test_a_script_on_the_simulated_arm() -> None:
    """From the text to the arm: 11 modules, beside the inside of the language, which is a compiler like any other."""
    controller = Controller("UR5e", "5.11")
    text = "def turn():\n  movej([0, -1.57, 1.57, -1.57, -1.57, {}])\nend\n"

    def run(turned: float) -> None:
        controller.take(text.format(turned))
        while controller.is_running_program:
            controller.step()

    run(0.1)
    met = modules_met(lambda: run(0.2))
    language = {name for name in met if name.startswith("urlink.simulator.urscript.")}
    packets = {name for name in met if name.startswith("linkcore.wire.")}
    assert met - language - packets - EVERY_CYCLE - LOOKED_UP - {"urlink.arm.kinematics.arm"} == {
        "urlink.simulator.controller",
        "linkcore.names",  # no attribute is set that the object does not have
        "urlink.simulator.programs.loader",  # whole programs, in their turn; the compiler is called from here
        "urlink.simulator.programs.runner",  # runs them
        "urlink.simulator.programs.program_world",  # what they call; their sockets are closed with them
        "urlink.simulator.messages",  # it began, it ended
        "urlink.simulator.control_loop",
        "urlink.simulator.robot.generator.drive",
        "urlink.simulator.robot.generator.motion_generator",
        "urlink.simulator.robot.generator.joint_limits",
        "urlink.simulator.robot.generator.path_motion",
        "urlink.simulator.robot.characteristics",  # how fast programs go
        "urlink.simulator.robot.arm",
    }
    assert "urlink.simulator.urscript.builtins.motions" in language  # `movej`
