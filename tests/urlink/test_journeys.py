"""Tests of the number of modules that run during one call, and that its reader must follow."""

from __future__ import annotations

import gc
import sys
import threading
from collections.abc import Callable
from types import FrameType

import pytest

import urlink
from linkcore.simulated.primitives import hash_
from tests.fakes.rehearsal import Rehearsal, turned
from urlink.packets import RealtimeState
from urlink.simulator import Controller

#: Modules for the subscription to states after the command was sent, which stops arms that are moved while paused.
SUBSCRIBING = {
    "urlink.command.program_time",
    "linkcore.threads",
    "linkcore.streaming.connection_life",
    "linkcore.streaming.fanout",
    "linkcore.streaming.subscription",
}

#: Modules that check arguments and hold facts about the robot. The command does not pass through them.
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
    """Return the modules of the project with a function that runs in this thread during a call."""
    met: set[str] = set()

    def look(frame: FrameType, event: str, argument: object) -> None:
        name = str(frame.f_globals.get("__name__", ""))
        # The hash of a thread runs `hash_` after time was simulated in this process.
        if name.partition(".")[0] in ("urlink", "linkcore") and frame.f_code is not hash_.__code__:
            met.add(name)

    # Garbage of earlier tests is collected before the call, because its finalizers would run in this thread.
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
def test_move_joints_uses_only_the_listed_modules() -> None:
    with Rehearsal() as robot:
        robot.motion.move_joints(turned(0.1))  # connects and identifies, so the next command does not
        met = modules_met(lambda: robot.motion.move_joints(turned(0.2)))
    assert met >= SUBSCRIBING
    assert met - LOOKED_UP - SUBSCRIBING == {
        "urlink.motion.context",  # limits of the session
        "urlink.motion.motions",  # arguments
        "urlink.script.commands",  # text of the program
        "urlink.script.wrapping",  # program around the text
        "linkcore.handle",  # state machine of the handle
        "linkcore.pending_call",  # order of calls and stops, and cancelled tasks
        "linkcore.names",  # only existing attributes are set
        "linkcore.process",  # check of the calling process
        "urlink.command.programs",  # registry of programs
        "urlink.command.channel",  # only connection for commands
        "linkcore.net.undo",  # abandoned commands that might still be executed
        "urlink.command.section",
        "urlink.command.safety_monitor",
        "urlink.command.interlock",  # permission to send
        "linkcore.streaming.connection",  # check of the calling thread
        "linkcore.clock",  # age of the newest state
    }


@pytest.mark.real_time
def test_packet_passes_through_the_listed_modules_in_order() -> None:
    met: list[str] = []
    is_over = threading.Event()

    def look(frame: FrameType, event: str, argument: object) -> None:
        name = str(frame.f_globals.get("__name__", ""))
        if event == "call" and name.partition(".")[0] in ("urlink", "linkcore") and name not in met:
            met.append(name)

    def follow_one_packet(state: RealtimeState) -> None:
        # The reader thread calls this function at the end of the way of each packet. The flight record is called only
        # for bytes that are not exactly one packet, which is rare unless the computer is busy.
        if "linkcore.net.transport" in met and "linkcore.streaming.flight_record" not in met:
            sys.setprofile(None)
            is_over.set()
        else:
            met.clear()
            sys.setprofile(look)

    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        robot.realtime.wait()  # the first packet chooses the layout
        subscription = robot.realtime.subscribe(follow_one_packet, inline=True)
        assert is_over.wait(10)
        subscription.close()
    assert met == [
        "linkcore.net.transport",  # bytes of the socket, and when they arrived
        "linkcore.streaming.connection",  # loop of the reader thread
        "linkcore.streaming.receiver",  # bytes to packets
        "linkcore.wire.framing",  # where the packet ends
        "linkcore.wire.state_layouts",  # layout for its size, and the state object
        "linkcore.streaming.statistics",  # counters
        "linkcore.streaming.peer_clock",  # the controller's clock
        "linkcore.streaming.fanout",  # all subscriptions
        "linkcore.streaming.subscription",  # the callback
    ]


#: Modules that run in each cycle of the simulated controller, with or without a program.
EVERY_CYCLE = {
    "urlink.simulator.state",
    "urlink.simulator.faults.schedule",
    "urlink.simulator.registers",
    "urlink.simulator.robot.modes",
    "urlink.simulator.robot.noise",
    "urlink.simulator.robot.sensors",
    "urlink.simulator.robot.surroundings",
}


def test_script_on_the_simulator_uses_only_the_listed_modules() -> None:
    """The listed modules run between the text and the arm, in addition to the compiler of the language."""
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
        "linkcore.names",  # only existing attributes are set
        "urlink.simulator.programs.loader",  # whole programs in order, and calls of the compiler
        "urlink.simulator.programs.runner",  # execution of the programs
        "urlink.simulator.programs.program_world",  # functions for programs, and their sockets
        "urlink.simulator.messages",  # start and end of programs
        "urlink.simulator.control_loop",
        "urlink.simulator.robot.generator.drive",
        "urlink.simulator.robot.generator.motion_generator",
        "urlink.simulator.robot.generator.joint_limits",
        "urlink.simulator.robot.generator.path_motion",
        "urlink.simulator.robot.characteristics",  # speed of programs
        "urlink.simulator.robot.arm",
    }
    assert "urlink.simulator.urscript.builtins.motions" in language  # `movej`
