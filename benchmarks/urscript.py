"""Speed of the simulated controller at running programs, compared with a real controller.

Controllers that are stepped cycle by cycle run both kinds of programs that `robot.motion.follow` uploads, and a motion
of ten seconds. Everything happens in one thread: the sockets of the programs are real sockets over loopback. Their peer
in this process sends its data before each cycle, so that the streaming program never waits for a set-point. The work of
the peer is part of the measured time, which is processor time. No client requests packets; a controller that serves its
ports has to make those too. The time to compile long programs is measured as well.

    python benchmarks/urscript.py                  # 10 s of controller time each, seven times
    python benchmarks/urscript.py --quick          # three times
    python benchmarks/urscript.py --json           # prints one JSON object
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import socket
import statistics
import time
from collections.abc import Callable, Sequence
from contextlib import closing

from urlink.arm.kinematics import Arm
from urlink.protocol.enums import ProgramState
from urlink.protocol.firmware import Firmware
from urlink.script import commands, waypoints, wrapping
from urlink.script.links import ReverseSocket
from urlink.script.messages import STOP_MESSAGE, dated, setpoint
from urlink.script.streaming import streaming as streaming_program
from urlink.simulator import Controller, Still
from urlink.simulator.urscript import compile_script
from urlink.simulator.urscript.errors import MAX_TOKENS

ARMS = (("UR5", "3.4"), ("UR5e", "5.11"))
READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)
#: Controller time of each program, in s.
SECONDS = 10.0
#: Time between two waypoints of the low-bandwidth program, in s.
APART = 0.5
#: Goal for the streaming program, as a multiple of real time.
GOAL = 20.0
#: Characters of the programs that are compiled, and the maximum time for each, in s.
COMPILED, LONGEST = 250_000, 1.0


def standing(model: str, firmware: str) -> Controller:
    """Return a controller whose arm is at rest at `READY`."""
    motion = Still()
    motion.start(READY)
    return Controller(model, firmware, motion=motion)


def joint_path(t: float) -> list[float]:
    """Return a point of a path: the tool joint moves forth and back, the others are at rest."""
    return [*READY[:5], 0.5 - 0.5 * math.cos(t)]


def joint_speeds(t: float) -> list[float]:
    return [0.0] * 5 + [0.5 * math.sin(t)]


def run(controller: Controller, body: Sequence[str]) -> None:
    controller.take(wrapping.program("measured", body).text)


def is_running(controller: Controller) -> bool:
    return controller.modes.program_state is ProgramState.PLAYING


def connected(controller: Controller, listener: socket.socket) -> socket.socket:
    """Step until the program has connected and has sent its token, which is 0."""
    listener.settimeout(0.0)
    link: socket.socket | None = None
    token = b""
    for _ in range(1000):
        controller.step()
        try:
            if link is None:
                link, _ = listener.accept()
                link.setblocking(False)
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            token += link.recv(4 - len(token))
        except BlockingIOError:
            continue
        if token == bytes(4):
            return link
    raise SystemExit("the program did not connect")


def listen() -> socket.socket:
    return socket.create_server(("127.0.0.1", 0))


def streaming(model: str, firmware: str) -> float:
    """Return the processor time, in s, for `SECONDS` of the streaming program."""
    controller = standing(model, firmware)
    rate = controller.firmware.rate
    with listen() as listener:
        run(
            controller,
            streaming_program(
                controller.firmware,
                ReverseSocket("127.0.0.1", listener.getsockname()[1], 0),
                speeds=[6.28] * 6,
            ),
        )
        with closing(connected(controller, listener)) as link:
            cycles = round(SECONDS * rate)
            messages = [dated(setpoint(joint_path(n / rate), joint_speeds(n / rate)), n) for n in range(cycles)]
            began = time.process_time()
            for message in messages:
                link.send(message)
                controller.step()
            taken = time.process_time() - began
            check(controller.arm.setpoint.q, joint_path(SECONDS), within=0.05)
            link.send(dated(STOP_MESSAGE, cycles))
            controller.step(rate)
    if is_running(controller):
        raise SystemExit("the streaming program did not end")
    return taken


def low_bandwidth(model: str, firmware: str) -> float:
    """Return the same for the program that interpolates on its own."""
    controller = standing(model, firmware)
    with listen() as listener:
        run(
            controller,
            waypoints.interpolating(controller.firmware, "127.0.0.1", listener.getsockname()[1], 0, is_quintic=False),
        )
        with closing(connected(controller, listener)) as link:
            last = round(SECONDS / APART)
            cycles = 0
            began = time.process_time()
            while is_running(controller):
                serve(link, last)
                controller.step()
                cycles += 1
            taken = time.process_time() - began
    check(controller.arm.setpoint.q, joint_path(SECONDS), within=1e-4)
    return taken * SECONDS * controller.firmware.rate / cycles


def serve(link: socket.socket, last: int) -> None:
    """Answer the requests of the low-bandwidth program."""
    try:
        lines = link.recv(4096).split()
    except BlockingIOError:
        return
    for line in lines:
        request = int(line)
        if request == waypoints.BEAT:
            link.send(b"(1)\n")
        elif 0 <= request <= last:
            t = request * APART
            speed = 0.5 * math.sin(t) if request < last else 0.0
            since = APART if request else 0.0
            link.send(f"({request},{','.join(map(str, joint_path(t)))},0,0,0,0,0,{speed},{since})\n".encode())
        elif request > last:
            link.send(f"({waypoints.NO_MORE},{','.join('0' * 13)})\n".encode())


def moving(model: str, firmware: str) -> float:
    """Return the same for a joint motion of five seconds and a linear motion of five seconds."""
    controller = standing(model, firmware)
    turned = [*READY[:5], 1.0]
    below = Arm(controller.model).forward(turned).tolist()
    below[2] -= 0.1
    half = 0.5 * SECONDS
    run(controller, commands.move_joints(turned, 1.0, 1.0, half) + commands.move_linear(below, 1.0, 1.0, half))
    cycles = 0
    began = time.process_time()
    while cycles == 0 or is_running(controller):
        controller.step()
        cycles += 1
    taken = time.process_time() - began
    check(Arm(controller.model).forward(controller.arm.setpoint.q).tolist(), below, within=1e-6)
    return taken * SECONDS * controller.firmware.rate / cycles


def repeated(statement: str, tokens: int | None = None) -> str:
    """Return a program that repeats one statement.

    It has 250 kB, or, if `tokens` (per statement) is given, about the maximum number of tokens.
    """
    count = COMPILED // len(statement) if tokens is None else (MAX_TOKENS - 10) // tokens
    return f"def long():\n{statement * count}end\n"


def compiling(text: str) -> float:
    """Return the processor time to compile a program, in s, with deferred garbage collection."""
    gc.collect()
    began = time.process_time()
    script = compile_script(text, Firmware.parse("5.11"))
    gc.collect(0)
    taken = time.process_time() - began
    del script
    return taken


LONG = {
    "statements": repeated("  x = (1 + 2) * 3 - 4\n"),
    "movements": repeated("  movej([0.1, -1.57, 1.57, -1.57, -1.57, 0.0], a=1.4, v=1.05)\n"),
    "most tokens": repeated(" x=1" + "+1" * 60 + "\n", tokens=123),
    "most statements": f"def long():\n y=1\n{' y' * (COMPILED // 2)}\nend\n",
    "calls of functions": f"def long():\n def f(x):\n return x\n end\n{' f(2)+1' * (MAX_TOKENS // 6 - 4)}\nend\n",
}


def check(actual: Sequence[float], goal: Sequence[float], within: float) -> None:
    """Check that the arm has done the measured motion."""
    away = max(abs(a - g) for a, g in zip(actual, goal, strict=True))
    if away > within:
        raise SystemExit(f"the arm is {away:.4f} rad or m away from the goal of the program")


PROGRAMS: dict[str, Callable[[str, str], float]] = {
    "streaming": streaming,
    "low bandwidth": low_bandwidth,
    "movej, movel": moving,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="three times instead of seven")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    rounds = 3 if options.quick else 7
    figures: dict[str, dict[str, float]] = {}
    for model, firmware in ARMS:
        for name, measure in PROGRAMS.items():
            seconds = statistics.median(measure(model, firmware) for _ in range(rounds))
            rate = Firmware.parse(firmware).rate
            figures[f"{name}, {rate} Hz"] = {
                "seconds": seconds,
                "cycles_per_second": SECONDS * rate / seconds,
                "times_real_time": SECONDS / seconds,
            }
    compiled = {
        name: {
            "seconds": statistics.median(compiling(text) for _ in range(rounds)),
            "characters": len(text),
        }
        for name, text in LONG.items()
    }
    if options.json:
        print(json.dumps({**figures, **{f"compiling {name}": row for name, row in compiled.items()}}))
        return
    print(f"{SECONDS:g} s of controller time, stepped (median)")
    for name, row in figures.items():
        goal = f"   (goal: at least {GOAL:g} x)" if name.startswith("streaming") else ""
        print(
            f"  {name:24} {row['seconds'] * 1e3:7.0f} ms {row['cycles_per_second']:9.0f} cycles/s"
            f" {row['times_real_time']:6.0f} x real time{goal}"
        )
    print("compiling (median)")
    for name, row in compiled.items():
        goal = f"   (goal: at most {LONGEST * 1e3:g} ms)"
        print(f"  {name:24} {row['seconds'] * 1e3:7.0f} ms {row['characters'] / 1e3:9.0f} kB{goal}")


if __name__ == "__main__":
    main()
