"""Cancel each awaitable of the asyncio API at turns of the event loop: nothing moves, and its thread is free.

The list comes from the API itself (`every_awaitable`), so a new method is tested automatically.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Sequence
from pathlib import Path

import pytest

import urlink
from linkcore import clock
from linkcore.errors import LinkError
from rhdlink import Host
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.host.world import World
from tests.cancelling import Turns
from tests.matrix import IS_WHOLE, trials
from tests.urlink.aio.every_awaitable import CHANGES, OPEN, PROGRAM, READY, Cell, awaitables, is_busy, lacking, use_of
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.simulated_time

#: Time limits in s: until a thread is free, until the arm is at rest, and until no program is left. A program without
#: start permission waits for its permission for five seconds.
FREE, AT_REST, LEFT = 0.2, 3.0, 6.0
#: Turns that are tried one by one, and the last turn.
EACH, MOST = 60, 2000
#: Distance between the turns that are tried one by one; each call starts with another turn.
STRIDE = trials(7, 1)
#: Ratio of two consecutive later turns.
GROWTH = 1.3 if IS_WHOLE else 1.8
#: Blocks in which a person may move the arm.
BY_HAND = ("AsyncRobot.freedrive", "AsyncRobot.teach", "AsyncTeaching")


class Bench:
    """Arms and a mobile robot. A group has two arms; any other object has one, which takes half the processor time."""

    def __init__(self, host: str, files: Path) -> None:
        self.host = host
        self.files = files
        self.controllers: list[Controller] = []

    def _controller(self) -> Controller:
        program = f"def pick():\n  movej({[1.2, *READY[1:]]}, a=1, v=0.1)\nend\n"
        return Controller("UR5e", "5.25", motion=Still(READY), files={PROGRAM: program}).start()

    def renew(self, name: str) -> None:
        """Replace the controllers by new ones with everything switched on, as many as the class of `name` needs."""
        self.close()
        self.controllers = [self._controller() for _ in range(2 if name.startswith("AsyncGroup") else 1)]

    def close(self) -> None:
        for each in self.controllers:
            each.close()

    @contextlib.asynccontextmanager
    async def cell(self) -> AsyncIterator[Cell]:
        points = self.files / "cell.json"
        async with contextlib.AsyncExitStack() as stack:
            robots = [
                await stack.enter_async_context(urlink.connect_async(each.address, stale_after=10.0, points=points))
                for each in self.controllers
            ]
            for robot in robots:
                await robot.realtime.wait()
            yield Cell(robots, self.host, self.files)

    @property
    def moves(self) -> bool:
        return any(each.arm.is_moving for each in self.controllers)

    @property
    def runs(self) -> bool:
        return any(each.is_running_program for each in self.controllers)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with Host([Turtle(World(1000.0))], period=0.02, port=0) as host:
        bench = Bench(host.address, tmp_path)
        yield bench
        bench.close()


async def _until(condition: Callable[[], bool], seconds: float, otherwise: str) -> None:
    until = clock.now() + seconds
    while not condition():
        assert clock.now() < until, otherwise
        await asyncio.sleep(0.01)


async def _cancelled(turns: Turns, number: int, name: str, bench: Bench, cell: Cell) -> bool:
    """Cancel a call at this turn, and check the state afterwards; return whether the call was still running."""
    at = f"{name} at turn {number}"
    async with OPEN[name.partition(".")[0]](cell) as part:
        task = await turns.cancel(use_of(name, part, cell), number)
        if not task.cancelled():
            error = task.exception()
            assert error is None or isinstance(error, LinkError), f"{at}: {error!r}"
        else:
            workers = [robot._workers for robot in cell.robots]
            await _until(lambda: not any(map(is_busy, workers)), FREE, f"{at}: a thread is still busy")
            if not name.startswith(BY_HAND):
                await _until(lambda: not bench.moves, AT_REST, f"{at}: the arm moves")
    if task.cancelled():
        await _until(lambda: not bench.moves, AT_REST, f"{at}: the arm moves")
        await _until(lambda: bench.moves or not bench.runs, LEFT, f"{at}: a program is left on the robot")
        await asyncio.sleep(0.3)
        assert not bench.moves, f"{at}: the arm moves again"
        assert not bench.runs, f"{at}: a program has started"
    elif name not in CHANGES:
        for robot in cell.robots:
            await robot.motion.stop(wait=True)
    return task.cancelled()


def _try(names: Sequence[str], numbers: Callable[[str], Iterable[int]], bench: Bench) -> None:
    """Test each name of a class at these turns, up to the first turn that comes after the end of the call."""

    async def tried(name: str, left: Iterator[int], turns: Turns) -> bool:
        """Whether another turn has to be tested with another robot."""
        async with bench.cell() as cell:
            for number in left:
                if not await _cancelled(turns, number, name, bench, cell):
                    return False
                if name in CHANGES:
                    return True
        return False

    bench.renew(names[0])
    for name in names:
        turns, left = Turns(), iter(numbers(name))
        while turns.run(tried(name, left, turns)):
            bench.renew(name)
        if name in CHANGES:
            bench.renew(name)


def _by_class() -> dict[str, list[str]]:
    return {kind: list(names) for kind, names in itertools.groupby(awaitables(), lambda name: name.partition(".")[0])}


def test_every_awaitable_has_a_test_case() -> None:
    assert not lacking(), "\n" + "\n".join(lacking())


@pytest.mark.parametrize("kind", _by_class())
def test_cancel_in_one_loop_iteration_leaves_nothing_behind(kind: str, bench: Bench) -> None:
    names = _by_class()[kind]
    _try(names, lambda name: (2 + 7 * names.index(name) % 16,), bench)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("name", awaitables())
def test_cancel_in_any_loop_iteration_leaves_nothing_behind(name: str, bench: Bench) -> None:
    later = itertools.takewhile(lambda turn: turn < MOST, (int(EACH * GROWTH**n) for n in itertools.count()))
    first = 1 + list(awaitables()).index(name) % STRIDE
    _try([name], lambda name: itertools.chain(range(first, EACH, STRIDE), later), bench)
