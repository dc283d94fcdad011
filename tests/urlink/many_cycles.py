"""Repeat each call of `test_cycles.py` and `test_cycles_of_others.py` ten thousand times, in simulated time.

In real time that takes twenty hours, most of them spent waiting for the arm and for states. Here, the controller is in
the same process. So the modules of types and code distinguish the objects that only the collector finds: objects of the
client count, objects of the simulation do not. Each call is repeated until its count is reached or its processor time
is used up. With ``--state``, the next run resumes there.

    python -m tests.urlink.many_cycles --calls 10000 --seconds 60 --state /tmp/cycles.json
    python -m tests.urlink.many_cycles --only Motions
"""

from __future__ import annotations

import argparse
import asyncio
import collections
import contextlib
import gc
import json
import os
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import urlink
from linkcore.errors import LinkError, LocalError, RemoteError
from tests.urlink import test_cycles as own
from tests.urlink import test_cycles_of_others as others
from urlink.simulator import Controller, Still
from urlink_compat import rtde_io, urx

HOST = "192.168.0.100"
#: Calls between two collections, which remove the garbage of the simulated controller.
BATCH = 20

#: Modules of the counted objects, except the modules of the simulation.
OWN = ("urlink", "linkcore", "tests.urlink")
SIMULATED = ("urlink.simulator", "linkcore.simulated")

#: Function that repeats a call this number of times.
Repeat = Callable[[int], object]


def module_of(found: object) -> str:
    """Return the module of the code or of the type of an object."""
    # `isinstance` would ask a weak reference for the class of its deleted object.
    if type(found) is types.TracebackType:
        found = found.tb_frame
    if type(found) is types.FrameType:
        return str(found.f_globals.get("__name__"))
    if type(found) is types.MethodType:
        found = found.__func__
    return str(found.__module__ if type(found) is types.FunctionType else type(found).__module__)


def of_the_client(garbage: list[object]) -> list[object]:
    """Return the garbage of the client that no reference connects with the controller.

    The module of a class is not enough, because client and controller share some classes.
    """
    modules = list(map(module_of, garbage))
    is_own = [module.startswith(OWN) and not module.startswith(SIMULATED) for module in modules]
    if not any(is_own):
        return []
    places = {id(each): place for place, each in enumerate(garbage)}
    above = list(range(len(garbage)))

    def root(place: int) -> int:
        while above[place] != place:
            above[place] = place = above[above[place]]
        return place

    for place, each in enumerate(garbage):
        for referred in gc.get_referents(each):
            if id(referred) in places:
                above[root(place)] = root(places[id(referred)])
    simulated = {root(place) for place, module in enumerate(modules) if module.startswith("urlink.simulator")}
    return [each for place, each in enumerate(garbage) if is_own[place] and root(place) not in simulated]


def left() -> collections.Counter[str]:
    """Collect all garbage. Count, by type, the objects of the client that only the collector could free."""
    gc.set_debug(gc.DEBUG_SAVEALL)
    try:
        gc.collect()
        return collections.Counter(
            f"{module_of(each)}.{each.__qualname__ if type(each) is types.FunctionType else type(each).__qualname__}"
            for each in of_the_client(list(gc.garbage))
        )
    finally:
        gc.set_debug(0)
        gc.garbage.clear()
        gc.collect()


def processor_time() -> float:
    """Return the processor time of this process in s, which is never simulated."""
    used = os.times()
    return used.user + used.system


def counted(repeat: Repeat, calls: int, seconds: float) -> tuple[int, collections.Counter[str]]:
    """Return the number of calls, at most `calls`, and the garbage that they left, by type."""
    repeat(2)  # creates objects that are made only once, such as a connection
    gc.collect()
    gc.freeze()
    gc.disable()
    made, found, until = 0, collections.Counter[str](), processor_time() + seconds
    try:
        while made < calls and processor_time() < until:
            count = min(BATCH, calls - made)
            repeat(count)
            made += count
            found += left()
    finally:
        gc.enable()
        gc.unfreeze()
    return made, found


def again(call: Callable[[], object], *refusals: type[Exception]) -> Repeat:
    """Return a function that repeats a call and ignores its refusals."""
    refusals = refusals or (RemoteError,)

    def repeat(count: int) -> None:
        for _ in range(count):
            with contextlib.suppress(*refusals):
                call()

    return repeat


@contextlib.contextmanager
def connected(kind: str, name: str) -> Iterator[Repeat]:
    """Yield the function that repeats one call of a table on a robot in its home position."""
    with urlink.connect(HOST, stale_after=60.0, silence=60.0) as robot:
        robot.motion.move_joints(own.HOME, wait=30)
        if name.startswith("Gripper"):
            robot.gripper.activate()
        if kind == "refused":
            robot.registers.read_bit(64)
            robot.registers.write_bit(70, True)
        elif kind == "dashboard":
            method, arguments = getattr(robot.dashboard, name), own.ARGUMENTS.get(name, ())
            yield again(lambda: method(*arguments), LinkError)
        else:
            call = own.CALLS[name]
            if isinstance(call, own.Within) and not call.is_once:
                # The table has another call for opening. Opening for each use would take most of the time.
                yield lambda count: call(robot, count)
            else:
                yield lambda count: [call(robot) for _ in range(count)] and None
    if kind == "refused":
        yield again(lambda: own.CALLS[name](robot), LinkError)


@contextlib.contextmanager
def awaited(kind: str, name: str) -> Iterator[Repeat]:
    async def connect() -> urlink.AsyncRobot:
        return await urlink.connect_async(HOST, stale_after=60.0, silence=60.0)

    async def call(count: int) -> None:
        for _ in range(count):
            with contextlib.suppress(RemoteError):
                await others.AWAITED[name](robot)

    others.is_home(HOST)
    loop = asyncio.new_event_loop()
    robot = loop.run_until_complete(connect())
    yield lambda count: loop.run_until_complete(call(count))
    loop.run_until_complete(robot.close())
    loop.close()


@contextlib.contextmanager
def by_other_names(kind: str, name: str) -> Iterator[Repeat]:
    others.is_home(HOST)
    if kind == "urx":
        robot = urx.Robot(HOST)
        yield again(lambda: others.URX[name](robot))
        robot.close()
    elif kind == "ur_rtde":
        control = others.Control(HOST)
        yield again(lambda: others.CONTROL[name](control))
        control.disconnect()
    else:
        outputs = rtde_io.RTDEIOInterface(HOST)
        yield again(lambda: others.OUTPUTS[name](outputs))
        outputs.disconnect()


#: Kind of call -> its table, and the context manager that yields the repeating function of one of its calls.
TABLES: dict[str, tuple[Any, Callable[[str, str], contextlib.AbstractContextManager[Repeat]]]] = {
    "call": (own.CALLS, connected),
    "refused": (own.CALLS, connected),
    "dashboard": ([name for name in own.DASHBOARD if name not in ("power_off", "restart_safety")], connected),
    "awaited": (others.AWAITED, awaited),
    "ur_rtde": (others.CONTROL, by_other_names),
    "ur_rtde output": (others.OUTPUTS, by_other_names),
    "urx": (others.URX, by_other_names),
}


#: Controllers for each call, in order. A CB3 is first, because it needs a quarter of the cycles, and so a quarter of
#: the processor time, and supports most calls.
CONTROLLERS = (("UR5", "3.15"), ("UR5e", "5.25"))


def tried(kind: str, name: str, calls: int, seconds: float) -> tuple[int, collections.Counter[str]]:
    """Return the number of times that one call of a table was made, and the garbage of the client, by type."""
    for model, firmware in CONTROLLERS[:-1] if kind not in ("refused", "dashboard") else ():
        with contextlib.suppress(LocalError):  # raised for calls that the controller does not support
            return tried_on(model, firmware, kind, name, calls, seconds)
    return tried_on(*CONTROLLERS[-1], kind, name, calls, seconds)


def tried_on(
    model: str, firmware: str, kind: str, name: str, calls: int, seconds: float
) -> tuple[int, collections.Counter[str]]:
    with urlink.simulated_time(1, limit=1e9) as sim:
        cell = sim.computer("cell", HOST)
        with sim.on(cell):
            controller = Controller(
                model, firmware, host=HOST, ports="standard", motion=Still(own.HOME.tolist())
            ).start()
        with TABLES[kind][1](kind, name) as repeat:
            outcome = counted(repeat, calls, seconds)
        with sim.on(cell):
            controller.close()
    return outcome


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calls", type=int, default=10_000, help="number of times to make each call (10000)")
    parser.add_argument("--seconds", type=float, default=60.0, help="processor time for each call, in s (60)")
    parser.add_argument("--only", default="", help="only make calls whose kind and name contain this text")
    parser.add_argument("--state", type=Path, help="file with the number of calls made so far, to resume from")
    args = parser.parse_args()
    done: dict[str, int] = json.loads(args.state.read_text()) if args.state and args.state.exists() else {}
    for kind, (table, _) in TABLES.items():
        for name in table:
            key = f"{kind} {name}"
            calls = args.calls - done.get(key, 0)
            if args.only not in key or calls <= 0:
                continue
            made, found = tried(kind, name, calls, args.seconds)
            done[key] = done.get(key, 0) + made
            print(
                f"{key}: {done[key]} calls left {found.total()} objects {dict(found.most_common(5)) or ''}", flush=True
            )
            if args.state:
                args.state.write_text(json.dumps(done))


if __name__ == "__main__":
    main()
