"""One world, run in simulated time: its controller, its clients and what happens to them."""

from __future__ import annotations

import contextlib
import threading
import time
import traceback
from collections.abc import Callable
from typing import Any

import urlink
from linkcore.errors import LinkError
from linkcore.simulated import Computer, Deadlock, Simulation, TimeLimit, simulated_time
from urlink.simulator import Controller, Still

from .asked import BEGIN
from .drawn import Ask, Client, Event, World
from .watch import BRAKING, Outcome, Watch

__all__ = ["Outcome", "run"]

#: s: how much longer than its time-out a call may take.
LATE = 1.5
#: s of simulated time for everything.
LIMIT = 300.0


class Run:
    """The clients and the events of one world."""

    def __init__(self, world: World, sim: Simulation, outcome: Outcome) -> None:
        self.world = world
        self.sim = sim
        self.outcome = outcome
        self.robot = sim.computer("robot", "192.168.0.100")
        arm = "UR5e" if urlink.firmware.Firmware.parse(world.firmware).is_e_series else "UR5"
        with sim.on(self.robot):
            self.controller = Controller(
                arm, world.firmware, host="192.168.0.100", ports="standard", motion=Still(), seed=world.seed
            ).start()
        self.watch = Watch(sim, self.controller, outcome)
        self.computers: list[Computer] = []
        self.gone: set[int] = set()
        #: those who press what is at the pendant
        self.hands: list[threading.Thread] = []

    def everything(self) -> None:
        threads = []
        for number, client in enumerate(self.world.clients):
            computer = self.sim.computer(f"client{number}", f"192.168.0.{10 + number}")
            computer.rate += client.drift
            self.computers.append(computer)
            with self.sim.on(computer):
                threads.append(
                    threading.Thread(target=self._client, args=(number, client), name=f"client {number}", daemon=True)
                )
        with self.sim.on(self.robot):
            for event in self.world.events:
                self._plan(event)
        for number, thread in enumerate(threads):
            with self.sim.on(self.computers[number]):
                thread.start()
        for number, thread in enumerate(threads):
            while number not in self.gone and thread.is_alive() and self.sim.now < LIMIT / 2:
                thread.join(1.0)
            if thread.is_alive() and number not in self.gone:
                self.watch.fault(f"client {number} has not come to its end\n{self.sim.stacks()}")
        for hand in self.hands:
            hand.join(60.0)
        time.sleep(2 * BRAKING)
        with self.sim.on(self.robot):
            self.controller.close()
        left = [
            name for name in self.sim.threads if not any(name.startswith(f"client {number}") for number in self.gone)
        ]
        if left and not self.gone:
            self.watch.fault(f"threads are left: {left}")
        self.watch.observed.check_ends(not self.world.events, len(self.world.clients) > 1)
        if not self.gone and self.sim.open_sockets:
            self.watch.fault(f"{self.sim.open_sockets} sockets are left")

    # -- clients -----------------------------------------------------------------------------------------

    def _client(self, number: int, client: Client) -> None:
        try:
            with urlink.connect("192.168.0.100", timeout=3.0) as robot:
                counted: list[int] = [0]
                subscription = robot.realtime.subscribe(lambda state: _count(counted), policy=urlink.drop_oldest(8))
                for ask in client.asks:
                    time.sleep(ask.after)
                    self._ask(number, robot, ask)
                subscription.close()
        except LinkError as error:
            self.watch.note(f"client {number}: {_brief(error)}")
        except Exception as error:
            self.watch.fault(f"client {number}: {type(error).__name__}\n{traceback.format_exc()}")

    def _ask(self, number: int, robot: urlink.Robot, ask: Ask) -> None:
        watch = self.watch
        watch.note(f"client {number} asks for {ask.what} ({ask.size:.2f}), then {ask.then}")
        watch.begin(number)
        error: BaseException | None = None
        try:
            with contextlib.ExitStack() as block:
                motion = BEGIN[ask.what](robot, ask, block)
                if motion is not None:
                    error = self._then(motion, ask)
        except LinkError as raised:
            error = raised
        finally:
            watch.note(f"client {number}: {ask.what} ended: {'well' if error is None else _brief(error)}")
            watch.end(number, error)

    def _then(self, motion: Any, ask: Ask) -> BaseException | None:
        begun = time.monotonic()
        limit = 60.0
        try:
            if ask.then == "wait":
                motion.wait(30.0)
            elif ask.then == "wait_briefly":
                limit = ask.patience
                motion.wait(ask.patience)
            elif ask.then == "cancel":
                time.sleep(ask.patience)
                motion.cancel()
                motion.wait(10.0)
            elif ask.then == "leave":
                limit = 10.0 + ask.patience
                with motion:
                    time.sleep(ask.patience)
            else:
                time.sleep(ask.patience)
        except LinkError as error:
            if time.monotonic() - begun > limit + LATE:
                self.watch.fault(f"{ask.what}: {ask.then} took {time.monotonic() - begun:.2f} s")
            if motion.done:
                return error
        # What the handle says in the end.
        if not motion.done:
            with contextlib.suppress(LinkError):
                motion.cancel()
            try:
                motion.wait(20.0)
            except LinkError as error:
                return error
        return getattr(motion, "error", None)

    # -- events ------------------------------------------------------------------------------------------

    def _plan(self, event: Event) -> None:
        sim, network, robot = self.sim, self.sim.network, self.robot

        def happen() -> None:
            self.watch.note(f"{event.what} ({event.size:.2f}), client {event.client}, for {event.lasts:.3f} s")
            client = self.computers[event.client]
            undo: Callable[[], object] | None = None
            if event.what == "cut":
                network.cut(client, robot)
                undo = lambda: network.mend(client, robot)  # noqa: E731
            elif event.what in ("deaf", "mute"):
                route = network.route(robot, client) if event.what == "deaf" else network.route(client, robot)
                route.is_silent = True
                undo = lambda: network.mend(client, robot)  # noqa: E731
            elif event.what == "reset":
                network.reset(client, robot)
            elif event.what in ("suspend_client", "hold_client"):
                client.suspend()
                undo = lambda: None if event.client in self.gone else client.resume()  # noqa: E731
            elif event.what == "suspend_robot":
                robot.suspend()
                undo = robot.resume
            elif event.what == "kill_client":
                self.gone.add(event.client)
                client.kill()
                self.watch.gone(event.client)
            if undo is not None:
                sim.at(sim.now + event.lasts, undo)

        def at_the_pendant() -> None:
            time.sleep(event.at)
            self.watch.note(f"{event.what} ({event.size:.2f})")
            controller = self.controller
            if event.what == "slider":
                controller.call(lambda: setattr(controller, "speed_fraction", event.size))
            elif event.what == "pendant_stop":
                controller.call(controller.pendant.stop)
            elif event.what == "pendant_pause":
                controller.call(controller.pendant.pause)
                time.sleep(event.lasts)
                controller.call(controller.pendant.play)
            else:
                getattr(controller.faults, event.what)()
                time.sleep(event.lasts)
                controller.faults.clear()

        if event.what in ("protective_stop", "emergency_stop", "pendant_stop", "pendant_pause", "slider"):
            self.hands.append(threading.Thread(target=at_the_pendant, daemon=True, name=event.what))
            self.hands[-1].start()
        else:
            sim.at(event.at, happen)


def _count(counted: list[int]) -> None:
    counted[0] += 1


def _brief(error: BaseException) -> str:
    return f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"


def run(world: World) -> Outcome:
    """Run a world; the same world gives the same outcome."""
    outcome = Outcome()
    with simulated_time(world.seed, latency=world.latency, jitter=world.jitter, limit=LIMIT) as sim:
        try:
            whole = Run(world, sim, outcome)
            with whole.watch.watching():
                whole.everything()
        except (Deadlock, TimeLimit) as error:
            outcome.faults.append(f"{type(error).__name__}: {error}")
        outcome.trace, outcome.steps, outcome.simulated = sim.trace, sim.steps, sim.now
    return outcome
