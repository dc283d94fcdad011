"""Run of one world in simulated time: its controller, its clients, and its events."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import gc
import inspect
import itertools
import logging
import math
import random
import threading
import time
import traceback
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import urlink
from linkcore.errors import LinkError, LinkTimeout, RemoteError
from linkcore.event_loop import within
from linkcore.handle import Event as LifeEvent
from linkcore.handle import Handle
from linkcore.pending_call import current_call
from linkcore.simulated import Computer, Deadlock, Simulation, TimeLimit, simulated_time
from urlink.aio import awaited
from urlink.protocol.enums import ProgramState
from urlink.simulator import Controller, Still
from urlink_compat.rtde_control import RTDEControlInterface
from urlink_compat.urx import Robot as UrxRobot

from . import acting
from .asked import BLOCK, CALL, DURING, MOTION, PENDANT_PROGRAM, UR_RTDE, URX
from .foreign import RAW
from .happening import at_the_robot, elsewhere
from .mobile import Base
from .signals import signalled
from .surface import ACTIONS
from .trials import AWAITED, MOBILE, TRIALS, Bench
from .watch import ADMITS, BRAKING, Outcome, Watch
from .world import AT_THE_ROBOT, Ask, Client, Event, World

__all__ = ["Outcome", "Run", "run"]

HOST = "192.168.0.100"
#: Time that a call may exceed its timeout, in s.
LATE = 1.5
#: Time limits for the start of a motion, and for the end of an abandoned motion, in s.
BEGUN, ENDED = 20.0, 30.0
#: Documented time limits for the end of a cancelled task, and for closing a robot, in s.
CANCELLED, CLOSED = 6.0, 2.0
#: Number of calls that only wait, which keep all threads of the asyncio interface busy.
BUSY = 16
#: Time for which `then` waits for a motion, and for a block, which does not end on its own, in s.
WAIT, WAIT_IN_BLOCK = 20.0, 0.5
#: Number of consecutive checks, a tenth of the braking time apart, after which no further motion is expected.
QUIET = 3
#: Limit of simulated time for a world, in s.
LIMIT = 400.0
#: Modules of the library between whose lines threads yield, without modules that keep state between worlds.
PREEMPTED = (
    "linkcore.aio",
    "linkcore.event_loop",
    "linkcore.handle",
    "linkcore.net",
    "linkcore.pending_call",
    "linkcore.streaming",
    "linkcore.threads",
    "urlink.aio",
    "urlink.command",
    "urlink.motion.control",
    "urlink.group",
    "urlink.motion",
    "urlink.robot",
    "urlink.rtde",
    "rhdlink",
    "urlink_compat",
)
#: Calls that neither move the arm nor prevent motions.
_HARMLESS = ("output", "analog_output", "payload", "tcp", "registers", "outputs", "subscribe", "iterate", "wait_state")
#: Calls after which the arm may move without a handle that reports the end.
_LASTING = ("line", "script.send_line")
_NO_END = {"servoJ", "speedJ", "jogStart", "forceMode", "freedriveMode", "speedj"}


MOTION = {**MOTION, **{name: acting.begin for name, action in ACTIONS.items() if action.kind == "motion"}}
BLOCK = {**BLOCK, **{name: acting.begin for name, action in ACTIONS.items() if action.kind == "block"}}
DURING = {**DURING, **{name: acting.during for name, action in ACTIONS.items() if action.kind == "block"}}
CALL = {**CALL, **{name: acting.call for name, action in ACTIONS.items() if action.kind == "call"}}


class Interrupted(Exception):
    """Exception that the program of a client raises in a block."""


class _Awaited:
    """Call that a task awaits, as the methods of an `AsyncRobot` make it, with its result.

    Attributes:
        is_making: Whether it is running in a thread.
        made: Returned object.
        error: Raised error.
    """

    def __init__(self, function: Callable[[Any, Ask], Any], robot: Any, ask: Ask) -> None:
        self._function = function
        self._robot = robot
        self._ask = ask
        self._is_public = ask.what in ACTIONS
        self.is_making = False
        self.made: Any = None
        self.error: BaseException | None = None

    def _make(self, wait: float | None = None) -> Any:
        self.is_making = True
        try:
            self.made = self._function(self._robot._part, self._ask)
            if wait is not None:
                self.made.wait(wait)
        except BaseException as error:
            self.error = error
            raise
        finally:
            self.is_making = False
        return self.made

    async def _made_publicly(self) -> Any:
        """Make the call with the asyncio interface itself."""
        action, drawn = ACTIONS[self._ask.what], acting.drawing(self._robot, self._ask)
        drawn.on_call = lambda: acting.on_call(self._robot, self._ask)
        positional, named = action.arguments(drawn)
        if action.kind == "motion" and action.name != "motion.stop":
            named.setdefault("wait", False)
        try:
            method = action.of(self._robot)
            takes = inspect.signature(method).parameters
            if not any(each.kind is each.VAR_KEYWORD for each in takes.values()):
                named = {name: value for name, value in named.items() if name in takes}
            made = method(*positional, **named)
            if inspect.isawaitable(made) and action.kind != "block":
                made = await made
        except Exception as error:
            self.error = error
            raise
        if action.kind != "block":
            self.made = made
        return made

    async def begun(self) -> Any:
        """Return the result of the function, as with `wait=False`."""
        if self._is_public:
            return await self._made_publicly()
        return await self._robot._workers.make(self._make, awaited._end)

    async def done(self) -> None:
        """Make the call and wait for its end, as with `wait=True`."""
        if self._is_public:
            made = await self._made_publicly()
            if self._ask.what in MOTION:
                await made
            else:
                await acting.use_awaited(made, self._ask)
            return
        await self._robot._workers.make(functools.partial(self._make, WAIT), awaited._end)

    def block(self) -> Any:
        """Return the block to enter."""
        if self._is_public:
            return self._entered_publicly()
        return awaited.Block(self._robot._workers, self._make, lambda made, workers: made)

    @contextlib.asynccontextmanager
    async def _entered_publicly(self) -> AsyncIterator[Any]:
        async with await self._made_publicly() as entered:
            self.made = getattr(entered, "_part", entered)
            yield entered


class Run:
    """Clients and events of one world."""

    def __init__(self, world: World, sim: Simulation, outcome: Outcome) -> None:
        self.world = world
        self.sim = sim
        self.robot = sim.computer("robot", HOST)
        arm = "UR5e" if urlink.protocol.firmware.Firmware.parse(world.firmware).is_e_series else "UR5"
        pick = "def pick():\n  movej([0.2, -1.57, 1.4, -1.57, -1.57, 0.0], v=0.5)\n  sleep(0.2)\nend\n"
        with sim.on(self.robot):
            self.controller = Controller(
                arm,
                world.firmware,
                host=HOST,
                ports="standard",
                motion=Still(),
                seed=world.seed,
                files={PENDANT_PROGRAM: pick},
            ).start()
        acting.prepared(self.controller, world.seed)
        self.controller.call(lambda: self.controller.pendant.load(PENDANT_PROGRAM))
        asks = [ask for client in world.clients for ask in client.asks]
        is_in_turn = all(ask.thread == 0 and ask.then != "forget" for ask in asks)
        self.is_sequence = not world.events and len(world.clients) == 1 and is_in_turn
        self.is_alone = not world.events and sum(len(client.asks) for client in world.clients) == 1
        self.watch = Watch(
            sim, self.controller, outcome, is_quiet=_is_quiet(world), is_alone=self.is_alone and not world.lines
        )
        self.computers: list[Computer] = []
        self.gone: set[int] = set()
        #: Numbers of the requests of each client for which the arm may move.
        self.owners: list[set[int]] = [set() for _ in world.clients]
        self._numbers = itertools.count()
        self._begun = 0.0
        self._threads_of_robot = 0
        #: Waiting calls of tasks that keep threads busy.
        self._busy: dict[int, list[asyncio.Future[Any]]] = {}
        #: Computer of the mobile robot of each client.
        self._peers: dict[int, Computer] = {}
        #: Threads of persons at the pendant.
        self.hands: list[threading.Thread] = []

    def everything(self) -> None:
        self._begun = self.sim.now
        self._threads_of_robot = len(self.sim.threads)
        if self.world.lines:
            self.sim.preempt(*PREEMPTED)
            self.sim.at(self._begun + self.world.lines, self.sim.preempt)
        threads = []
        for number, client in enumerate(self.world.clients):
            computer = self.sim.computer(f"client{number}", f"192.168.0.{10 + number}")
            computer.rate += client.drift
            self.computers.append(computer)
            with self.sim.on(computer):
                threads.append(
                    threading.Thread(target=self._client, args=(number, client), name=f"client {number}", daemon=True)
                )
        for number in range(len(threads)):
            self._happen(number, None)
        for number, thread in enumerate(threads):
            with self.sim.on(self.computers[number]):
                thread.start()
        for number, thread in enumerate(threads):
            while number not in self.gone and thread.is_alive() and self.sim.now < LIMIT / 2:
                thread.join(1.0)
                is_paused = self.controller.modes.program_state == ProgramState.PAUSED
                if is_paused and self.sim.now > self._begun + 1.25 * WAIT:
                    # `moveJ` of ur_rtde waits forever for a motion that another client has paused.
                    self.controller.call(self.controller.pendant.stop)
            if thread.is_alive() and number not in self.gone:
                self.watch.fault(f"client {number} has not ended\n{self.sim.stacks()}")
        for hand in self.hands:
            hand.join(60.0)
        self._settle()
        with self.sim.on(self.robot):
            self.controller.close()
        left = [
            name for name in self.sim.threads if not any(name.startswith(f"client {number}") for number in self.gone)
        ]
        if left and not self.gone:
            self.watch.fault(f"threads are left: {left}")
        self.watch.observed.check_ends()
        if not self.gone and self.sim.open_sockets:
            self.watch.fault(f"{self.sim.open_sockets} sockets are left")

    def _settle(self) -> None:
        """Watch the arm until nothing can move it: for twice `BRAKING`, or until everything is at rest and idle."""
        until = self.sim.now + 2 * BRAKING
        quiet = 0
        while self.sim.now < until and quiet < QUIET:
            time.sleep(BRAKING / 10)
            has_arrived = all(map(self.watch.observed.has_arrived, self.computers))
            is_alone = len(self.sim.threads) <= self._threads_of_robot and not self.gone
            is_quiet = is_alone and has_arrived and self.controller.stopped_since is None
            quiet = quiet + 1 if is_quiet and self.watch.is_at_rest else 0

    def _until(self, ask: Ask) -> float:
        """Return the seconds until a request is made."""
        return max(self._begun + ask.at - self.sim.now, 0.0) + ask.after

    # -- clients that want the arm to move -----------------------------------------------------------------

    def begin(self, client: int) -> int:
        """Record a request that may move the arm; return its number."""
        owner = next(self._numbers)
        self.owners[client].add(owner)
        self.watch.begin(owner)
        return owner

    def end(self, client: int, owner: int, error: BaseException | None) -> None:
        """Record that the client knows the end of its request."""
        self.owners[client].discard(owner)
        self.watch.end(owner, error)

    def leave(self, client: int) -> None:
        """Record that a client no longer exists; its motions may continue to their end."""
        self.gone.add(client)
        self.watch.gone(-1)
        for owner in self.owners[client]:
            self.watch.gone(owner)

    # -- clients -----------------------------------------------------------------------------------------

    def _client(self, number: int, client: Client) -> None:
        kinds: dict[str, Callable[[int, Client], None]] = {
            "asyncio": lambda number, client: asyncio.run(self._tasks(number, client)),
            "ur_rtde": self._ur_rtde,
            "urx": self._urx,
            "foreign": self._foreign,
            "mobile": self._mobile,
            "trials": self._trials,
            "trials in tasks": lambda number, client: asyncio.run(self._trials_in_tasks(number, client)),
            "mobile trials": self._mobile_trials,
        }
        try:
            kinds.get(client.kind, self._threads)(number, client)
        except LinkError as error:
            self.watch.note(f"client {number}: {_brief(error)}")
        except Exception as error:
            self.watch.fault(f"client {number}: {type(error).__name__}\n{traceback.format_exc()}")

    def _options(self, client: Client) -> dict[str, Any]:
        options: dict[str, Any] = {"timeout": 3.0, "require_enable": client.policy}
        return {**options, "start_register": None} if client.start == "flags" else options

    def _threads(self, number: int, client: Client) -> None:
        with urlink.connect(HOST, **self._options(client)) as robot:
            subscription = None
            if client.kind == "threads":
                subscription = robot.realtime.subscribe(lambda state: None, policy=urlink.drop_oldest(8))
            kept: dict[int, Handle] = {}

            def asks(which: int) -> None:
                for place, ask in enumerate(client.asks):
                    if ask.thread == which:
                        _rest(robot, ask, self._until(ask))
                        self._happen(number, place)
                        self._ask(number, client, robot, ask, kept)

            others = [
                threading.Thread(target=asks, args=(which,), name=f"client {number} thread {which}", daemon=True)
                for which in {ask.thread for ask in client.asks} - {0}
            ]
            for other in others:
                other.start()
            asks(0)
            for other in others:
                other.join()
            if subscription is not None:
                subscription.close()
        self._all_over(number, kept)

    def _forget(self, number: int, owner: int, motion: Handle, kept: dict[int, Handle]) -> None:
        """Record a motion that the client does not wait for; it ends at any time."""
        kept[owner] = motion
        motion.add_done_callback(lambda handle: self.end(number, owner, handle.error))

    def _all_over(self, number: int, kept: dict[int, Handle]) -> None:
        """Check that all remaining motions have ended, because the robot was closed."""
        for owner, handle in kept.items():
            if not handle.done:
                self.watch.fault(f"client {number}: {handle.name} has not ended, although the robot was closed")
            self.end(number, owner, handle.error)

    def _ask(self, number: int, client: Client, robot: urlink.Robot, ask: Ask, kept: dict[int, Handle]) -> None:
        error: BaseException | None = None
        owner = None
        self.watch.note(f"client {number} requests {ask.what} ({ask.size:.2f}), then {ask.then}")
        observed, method = self.watch.observed, ask.what.rpartition(".")[2]
        entered = self.sim.now
        try:
            if client.policy != "never" and ask.size > 0.3:
                robot.safety.enable()
            with observed.calling(method) as entered:
                if ask.what in CALL:
                    if ask.what in _LASTING:
                        self.begin(number)
                    with self._signals(robot, ask), self._in_time(number, ask, "takes", _limit(ask)):
                        CALL[ask.what](robot, ask)
                    self._check_effect(robot, ask)
                else:
                    owner = self.begin(number)
                    if ask.what in MOTION:
                        with self._signals(robot, ask), self._in_time(number, ask, "has begun", _limit(ask)):
                            motion = MOTION[ask.what](robot, ask)
                        if method == "stop":
                            observed.has_stopped(entered)
                        if ask.then == "forget":
                            self._forget(number, owner, motion, kept)
                            owner = None
                        else:
                            error = self._then(number, robot, motion, ask)
                            if error is None and ask.then == "wait":
                                self._check_effect(robot, ask)
                    else:
                        with self._signals(robot, ask):
                            error = self._block(number, robot, ask)
        except (Interrupted, KeyboardInterrupt):
            self._abandoned(observed.abandon(entered))
        except LinkError as raised:
            error = raised
            if not (isinstance(error, LinkTimeout) or ADMITS.search(str(error))):  # a wait that times out ends nothing
                self._abandoned(observed.abandon(entered))
        finally:
            self.watch.told(number, ask.what, error)
            if owner is not None:
                self.end(number, owner, error)

    def _abandoned(self, has_any: bool) -> None:
        """Wait after a call that raised and left a program behind, to observe it before the robot is closed."""
        if has_any:
            time.sleep(1.5 * BRAKING)

    def _check_effect(self, robot: urlink.Robot, ask: Ask) -> None:
        """Check the promised effect of a call when it returns, unless other actions can have undone it."""
        if self.is_sequence and ask.what in ACTIONS and ask.then != "signal":
            wrong = acting.effect(robot, self.controller, ask)
            if wrong is not None:
                self.watch.fault(f"{ask.what}: {wrong}")

    def _signals(self, robot: urlink.Robot, ask: Ask) -> contextlib.AbstractContextManager[object]:
        """Return a block in which, for `then="signal"`, a signal comes between two lines of the library."""
        if ask.then != "signal" or ask.thread or self.world.lines:
            return contextlib.nullcontext()
        chance = random.Random(f"signal {ask.size}")
        name = chance.choice(("interrupt", "interrupt", "stop", "cancel", "close"))
        lines = int(math.exp(chance.uniform(math.log(12.0), math.log(4000.0))))

        def handler() -> None:
            self.watch.note(f"a signal comes; its handler does: {name}")
            if name == "interrupt":
                raise KeyboardInterrupt
            # A stop does not affect a call that has not been entered yet, because the robot may be making its parts.
            is_entered = current_call() is not None
            with contextlib.suppress(LinkError), self.watch.observed.calling(f"{name} in a handler") as entered:
                if name == "stop":
                    robot.motion.stop()
                    if is_entered:
                        self.watch.observed.has_stopped(entered)
                elif name == "close":
                    robot.close()
                else:
                    motion = robot.motion.current
                    if motion is not None:
                        motion.cancel()

        return signalled(PREEMPTED, lines, handler)

    def _block(self, number: int, robot: urlink.Robot, ask: Ask) -> BaseException | None:
        """Run a motion that lasts as long as a block; return the error of its handle."""
        block = BLOCK[ask.what](robot, ask)
        try:
            with contextlib.ExitStack() as leaving:
                # The request for the motion is the entry of the block, not its construction.
                with self.watch.observed.calling(ask.what.rpartition(".")[2]):
                    entered = leaving.enter_context(block)
                DURING[ask.what](robot, entered, ask)
                handle = _handle(entered)
                if ask.then == "cancel" and handle is not None:
                    handle.cancel()
                elif ask.then == "wait" and handle is not None:
                    handle.wait(WAIT_IN_BLOCK)
                elif ask.then == "interrupt":
                    raise Interrupted
                else:
                    _rest(robot, ask)
        except LinkError as error:
            if isinstance(block, Handle) and not block.done:
                return self._given_up(number, block, ask) or error
            return error
        return None

    def _then(self, number: int, robot: urlink.Robot, motion: Handle, ask: Ask) -> BaseException | None:
        try:
            if ask.then == "wait":
                with self._in_time(number, ask, "waits", WAIT):
                    motion.wait(WAIT)
            elif ask.then == "wait_briefly":
                with self._in_time(number, ask, "waits", ask.patience):
                    motion.wait(ask.patience)
            elif ask.then == "cancel":
                _rest(robot, ask)
                motion.cancel()
                with self._in_time(number, ask, "waits", WAIT):
                    motion.wait(WAIT)
            else:
                with contextlib.suppress(Interrupted), motion:
                    time.sleep(ask.patience)
                    if ask.then == "interrupt":
                        raise Interrupted
        except LinkError as error:
            if motion.done:
                return error
        return self._given_up(number, motion, ask)

    def _given_up(self, number: int, motion: Handle, ask: Ask) -> BaseException | None:
        """End a motion if it has not ended; return the error of its handle."""
        if not motion.done:
            with contextlib.suppress(LinkError):
                motion.cancel()
            with contextlib.suppress(LinkError), self._in_time(number, ask, "ends", ENDED):
                motion.wait(ENDED)
            if not motion.done:
                self.watch.fault(f"{ask.what} has not ended {ENDED:g} s after it was cancelled")
        return motion.error

    @contextlib.contextmanager
    def _in_time(self, number: int, ask: Ask, what: str, limit: float) -> Iterator[None]:
        begun = self.sim.now
        try:
            yield
        finally:
            took = self.sim.now - begun
            if took > limit + self._held_for(number) + LATE and number not in self.gone:
                self.watch.fault(f"{ask.what}: {what} {took:.2f} s, longer than {limit:g} s")

    def _held_for(self, number: int) -> float:
        """Return the time for which events may suspend the computer of a client, in s."""
        held = ("suspend_client", "hold_client")
        return sum(each.lasts for each in self.world.events if each.client == number and each.what in held)

    # -- clients with tasks --------------------------------------------------------------------------------

    async def _tasks(self, number: int, client: Client) -> None:
        kept: dict[int, Handle] = {}
        self._busy[number] = []
        async with urlink.connect_async(HOST, **self._options(client)) as robot:
            states = await robot.realtime.subscribe(lambda state: None)

            async def asks(which: int) -> None:
                for place, ask in enumerate(client.asks):
                    if ask.thread == which:
                        await asyncio.sleep(self._until(ask))
                        self._happen(number, place)
                        await self._ask_async(number, client, robot, ask, kept)

            await asyncio.gather(*(asks(which) for which in sorted({ask.thread for ask in client.asks})))
            states.close()
            leaving = self.sim.now
        took, held = self.sim.now - leaving, self._held_for(number)
        if took > CLOSED + held + LATE and number not in self.gone:
            self.watch.fault(f"client {number}: leaving the block of its robot took {took:.2f} s")
        await asyncio.gather(*self._busy[number], return_exceptions=True)
        self._all_over(number, kept)

    async def _ask_async(self, number: int, client: Client, robot: Any, ask: Ask, kept: dict[int, Handle]) -> None:
        self.watch.note(f"client {number} requests {ask.what} ({ask.size:.2f}), then {ask.then}, in a task")
        if ask.what == "busy":
            waits = [asyncio.ensure_future(robot.io.wait_digital_in(7, True, 5.0 + ask.size)) for _ in range(BUSY)]
            self._busy[number] += waits
            await asyncio.sleep(ask.patience)
            for each in waits:
                each.cancel()
            return
        owner = None if ask.what in CALL and ask.what not in _LASTING else self.begin(number)
        error: BaseException | None = None
        call = _Awaited(CALL.get(ask.what) or MOTION.get(ask.what) or BLOCK[ask.what], robot, ask)
        observed, method = self.watch.observed, ask.what.rpartition(".")[2]
        entered = self.sim.now
        try:
            if client.policy != "never" and ask.size > 0.3:
                await robot.safety.enable()
            if ask.what == "close":
                await robot.close()
                return
            if ask.what == "iterate":
                await robot.primary.wait(ask.patience)
                return
            with observed.calling(method, in_thread=False) as entered:
                if owner is not None and ask.then == "forget" and ask.what in MOTION:
                    self._forget(number, owner, await call.begun(), kept)
                    owner = None
                    return
                await self._then_async(number, robot, call, ask)
            if ask.what == "motion.stop":
                observed.has_stopped(entered)
        except LinkError as raised:
            error = raised
        except (asyncio.CancelledError, asyncio.TimeoutError, Interrupted):
            if call.made is None:
                has_any = observed.abandon(entered, method)
                await asyncio.sleep(1.5 * BRAKING if has_any else 0.0)
            await self._check_cancelled(ask)
        finally:
            if owner is not None:
                error = await self._ended(call, ask) or error
            self.watch.told(number, ask.what, error)
            if owner is not None and ask.what not in _LASTING:
                self.end(number, owner, error)

    async def _check_cancelled(self, ask: Ask) -> None:
        """Check that a cancelled call leaves no program, if no other call could have started it."""
        if ask.what == "dashboard.play" and self.is_alone:
            await asyncio.sleep(2 * BRAKING)
            if self.controller.is_running_program:
                self.watch.fault("dashboard.play was cancelled, but its program runs")

    async def _then_async(self, number: int, robot: Any, call: _Awaited, ask: Ask) -> None:
        async def whole() -> None:
            if ask.what in BLOCK:
                async with call.block() as entered:
                    if ask.what in ACTIONS:
                        await self._during_async(robot, entered, ask)
                    else:
                        await robot.call(DURING[ask.what], robot._part, entered, ask)
                    if ask.then == "interrupt":
                        raise Interrupted
                    await asyncio.sleep(ask.patience)
            elif ask.what in CALL:
                made = await call.begun()
                if ask.what in ACTIONS:
                    await acting.use_awaited(made, ask)
            elif ask.then == "leave":
                with await call.begun():
                    await asyncio.sleep(ask.patience)
            elif ask.then == "interrupt":
                (await call.begun()).cancel()
            elif round(100 * ask.size) % 2:  # as with wait=True
                await call.done()
            else:
                await (await call.begun())

        task = asyncio.ensure_future(whole())
        if ask.then != "cancel":  # `asyncio.wait_for` would take other steps of the loop since Python 3.12
            await within(ask.patience if ask.then == "wait_briefly" else _limit(ask) + WAIT, task)
        elif ask.size > 0.5:
            await asyncio.sleep(ask.patience)
        else:
            for _ in range(int(40 * ask.size)):
                await asyncio.sleep(0)
        task.cancel()
        with self._in_time(number, ask, "is cancelled", CANCELLED):
            await task

    async def _during_async(self, robot: Any, block: Any, ask: Ask) -> None:
        """Use a block with its asyncio methods; some of these calls are cancelled."""
        for step, (name, often, rest) in enumerate(acting.steps_awaited(block, ask)):
            chance = random.Random(f"cancelled {ask.size} {step}")
            for _ in range(often):
                end = getattr(block, "end", None) if name == "replace" else None
                task = asyncio.ensure_future(acting.during_awaited(robot, block, name, ask, step))
                if often == 1 and chance.random() < 0.5:
                    await asyncio.sleep(chance.choice((0.0, 0.001, 0.005, 0.05)))
                    task.cancel()
                await asyncio.wait({task})
                if not task.cancelled():
                    task.result()
                elif name == "replace":
                    await asyncio.sleep(0.3)
                    if block.end != end:
                        self.watch.fault(f"a cancelled replace was executed: the stream ends at {block.end:.3f} s")
                elif name == "execute":
                    self.watch.observed.pause(block)
                    await asyncio.sleep(1.5 * BRAKING)
                if often > 1:
                    await robot.realtime.wait(2.0)
            await asyncio.sleep(rest)
            if name == "execute":
                self.watch.observed.resume(block)

    async def _ended(self, call: _Awaited, ask: Ask) -> BaseException | None:
        """Wait for the end of the motion that a call has started, and return the error of its handle."""
        until = self.sim.now + ENDED
        await asyncio.sleep(0.01)  # after this time it has started, or it never will
        while call.is_making and self.sim.now < until:
            await asyncio.sleep(0.01)
        if call.is_making:
            self.watch.fault(f"the call of {ask.what} has not ended {ENDED:g} s after it was cancelled")
        if call.error is not None:
            return call.error
        handle = _handle(call.made)
        # A block that was not entered has not started a motion, so nothing ends.
        if handle is None or not handle._life.happened(LifeEvent.SEND):
            return None
        if ask.what in MOTION:
            handle.cancel()
        while not handle.done and self.sim.now < until:
            await asyncio.sleep(0.01)
        if not handle.done:
            self.watch.fault(f"{ask.what} has not ended {ENDED:g} s after its task was")
        return handle.error

    # -- clients that are not `urlink.connect` ---------------------------------------------------------------

    def _ur_rtde(self, number: int, client: Client) -> None:
        with RTDEControlInterface(HOST) as robot:
            self._compatible(number, client, robot, UR_RTDE)
        self._all_end(number)

    def _urx(self, number: int, client: Client) -> None:
        with UrxRobot(HOST) as robot:
            self._compatible(number, client, robot, URX)
        self._all_end(number)

    def _compatible(
        self, number: int, client: Client, robot: Any, calls: dict[str, Callable[[Any, Ask, bool], object]]
    ) -> None:
        for place, ask in enumerate(client.asks):
            time.sleep(self._until(ask))
            self._happen(number, place)
            self.watch.note(f"client {number} requests {ask.what} ({ask.size:.2f}), then {ask.then}")
            owner, lasts = self.begin(number), ask.then in ("forget", "cancel")
            error: BaseException | None = None
            try:
                if calls[ask.what](robot, ask, lasts) is False:
                    error = RemoteError("it returned False: the arm might still move")
            except LinkError as raised:
                error = raised
            self.watch.told(number, ask.what, error)
            if not lasts and ask.what not in _NO_END:
                self.end(number, owner, error)
            if lasts:
                time.sleep(ask.patience)

    def _all_end(self, number: int) -> None:
        """Record the end of all motions of a client, because it has disconnected."""
        for owner in sorted(self.owners[number]):
            self.end(number, owner, RemoteError("the arm might still move"))

    def _foreign(self, number: int, client: Client) -> None:
        for place, ask in enumerate(client.asks):
            time.sleep(self._until(ask))
            self._happen(number, place)
            self.watch.note(f"client {number}, a foreign one: {ask.what} ({ask.size:.2f})")
            try:
                RAW[ask.what](HOST, ask)
            except OSError as error:
                self.watch.note(f"client {number}: {ask.what}: {error}")

    def _mobile(self, number: int, client: Client) -> None:
        with self.sim.on(self.robot):
            base = Base(self.sim, self.watch.fault, is_wheeled=client.asks[0].size > 0.5)
        self._peers[number] = base.computer
        try:
            base.use(client.asks, sum(event.lasts for event in self.world.events))
        finally:
            base.close()

    # -- trials ------------------------------------------------------------------------------------------

    def _bench(self, number: int, ask: Ask, robot: Any, there: Computer) -> Bench:
        chance = random.Random(f"{ask.what} {ask.size}")
        here = self.computers[number]
        return Bench(self.sim, self.controller, HOST, robot, here, there, chance, self.watch.fault, ask.what)

    @contextlib.contextmanager
    def _trying(self, number: int, ask: Ask) -> Iterator[None]:
        """Record a trial, during which the arm may move; an error of the trial is a fault."""
        self.watch.note(f"client {number}: {ask.what} ({ask.size:.4f})")
        owner = self.begin(number)
        error: BaseException | None = None
        try:
            yield
        except Exception as raised:
            error = raised
            where = [each for each in traceback.extract_tb(raised.__traceback__) if "trials" in each.filename]
            line = f"line {where[-1].lineno}: {where[-1].line}" if where else ""
            self.watch.fault(f"{ask.what} raised {raised!r}, {line}")
        self.end(number, owner, error)

    def _trials(self, number: int, client: Client) -> None:
        for ask in client.asks:
            with self._trying(number, ask), urlink.connect(HOST, **self._options(client)) as robot:
                TRIALS[ask.what](self._bench(number, ask, robot, self.robot))
            time.sleep(BRAKING)

    async def _trials_in_tasks(self, number: int, client: Client) -> None:
        for ask in client.asks:
            with self._trying(number, ask):
                async with urlink.connect_async(HOST, **self._options(client)) as robot:
                    await AWAITED[ask.what](self._bench(number, ask, robot, self.robot))
            await asyncio.sleep(BRAKING)

    def _mobile_trials(self, number: int, client: Client) -> None:
        for ask in client.asks:
            there = self.sim.computer(f"mobile{number}", "192.168.0.201")
            with self._trying(number, ask):
                MOBILE[ask.what](self._bench(number, ask, None, there))

    # -- events ------------------------------------------------------------------------------------------

    def _happen(self, client: int, ask: int | None) -> None:
        """Plan the events after a request, or after the start."""
        for event in self.world.events:
            if event.client == client and event.ask == ask:
                self._plan(event)

    def _plan(self, event: Event) -> None:
        def hand() -> None:
            time.sleep(event.at)
            self.watch.note(f"{event.what} ({event.size:.2f}) for {event.lasts:.3f} s")
            at_the_robot(event, self.controller, self.watch, next(self._numbers))

        def happen() -> None:
            self.watch.note(f"{event.what} ({event.size:.2f}), client {event.client}, for {event.lasts:.3f} s")
            client = self.computers[event.client]
            undo = elsewhere(event, self.sim.network, client, self._peers.get(event.client, self.robot))
            if event.what in ("kill_client", "power_client"):
                self.leave(event.client)
            if undo is not None:
                # A client that was killed meanwhile is not resumed, but the robot and the network are.
                is_its_own = event.what in ("suspend_client", "hold_client")
                self.sim.at(self.sim.now + event.lasts, lambda: (is_its_own and event.client in self.gone) or undo())

        if event.what in AT_THE_ROBOT:
            with self.sim.on(self.sim.here):
                self.hands.append(threading.Thread(target=hand, daemon=True, name=event.what))
                self.hands[-1].start()
        else:
            self.sim.at(self.sim.now + event.at, happen)


class _Errors(logging.Handler):
    """Handler that reports unexpected exceptions: uncaught ones in threads, and logged ones with a traceback."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        #: Function that reports a fault. None at the end, when remaining threads of killed computers are ended.
        self.fault: Callable[[str], object] | None = None

    def emit(self, record: logging.LogRecord) -> None:
        lacks = record.exc_info is not None and "can't start new thread" in str(record.exc_info[1])
        if record.exc_info and self.fault is not None and not lacks:
            self.fault(f"logged: {self.format(record)}")

    def uncaught(self, args: threading.ExceptHookArgs) -> None:
        if not issubclass(args.exc_type, SystemExit) and self.fault is not None:
            text = "".join(traceback.format_exception(args.exc_type, args.exc_value, args.exc_traceback))
            self.fault(f"uncaught in {args.thread and args.thread.name}: {args.exc_value!r}\n{text}")


def _handle(entered: Any) -> Handle | None:
    """Return the handle of an entered object (for teaching, its freedrive), or None if it is not a motion."""
    if isinstance(entered, Handle):
        return entered
    freedrive: Handle | None = getattr(entered, "freedrive", None)
    return freedrive


def _is_quiet(world: World) -> bool:
    """Whether the world only has clients that move the arm or do no harm, so no call may report a stop."""
    moves = {*MOTION, *BLOCK, *_HARMLESS} - ACTIONS.keys()
    return not world.events and all(ask.what in moves for client in world.clients for ask in client.asks)


def _rest(robot: urlink.Robot, ask: Ask, seconds: float | None = None) -> None:
    """Wait; half of the requests then wait for a state, as a loop does, so they resume together with other threads."""
    time.sleep(ask.patience if seconds is None else seconds)
    if ask.size > 0.5:
        with contextlib.suppress(LinkError):
            robot.realtime.wait(0.1)


def _limit(ask: Ask) -> float:
    """Return the time limit for the call of a request, in s."""
    return acting.limit(ask) if ask.what in ACTIONS else BEGUN if ask.what in MOTION else WAIT + BEGUN


def _brief(error: BaseException) -> str:
    return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"


def run(world: World) -> Outcome:
    """Run a world; the same world gives the same outcome."""
    outcome = Outcome()
    errors = _Errors()
    root, hook = logging.getLogger(), threading.excepthook
    root.addHandler(errors)
    try:
        with simulated_time(world.seed, latency=world.latency, jitter=world.jitter, limit=LIMIT) as sim:
            try:
                whole = Run(world, sim, outcome)
                errors.fault = whole.watch.fault
                threading.excepthook = errors.uncaught
                with whole.watch.watching():
                    whole.everything()
            except (Deadlock, TimeLimit) as error:
                outcome.faults.append(f"{type(error).__name__}: {error}")
            errors.fault = None
            outcome.trace, outcome.steps, outcome.simulated = sim.trace, sim.steps, sim.now
    finally:
        threading.excepthook = hook
        root.removeHandler(errors)
    if world.events:
        gc.collect()  # so that objects of killed or suspended clients do not appear in another world
    return outcome
