"""One world, run in simulated time, and what must be true of it.

The arm is looked at in each cycle. It may move only while somebody wants it to: from the moment at which a client asks
until it has been told of the end, and for as long as an arm takes to brake. Where the error of a call says that the arm
may still move, it may, until the program on the controller is over.
"""

from __future__ import annotations

import contextlib
import re
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import urlink
from linkcore.errors import LinkError
from linkcore.simulated import Computer, Deadlock, Simulation, TimeLimit, simulated_time
from urlink.simulator import Controller, Still

from .drawn import Ask, Client, Event, World

__all__ = ["Outcome", "run"]

#: rad/s above which the arm moves, and seconds in which it comes to rest once it is told to.
MOVES, BRAKING = 0.01, 1.0
#: s: the least watchdog that is drawn, and how much longer than it said a call may take.
WATCHDOG, LATE = 0.3, 1.5
#: s of simulated time for everything.
LIMIT = 300.0
READY = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
#: An error that admits that the arm may go on.
_ADMITS = re.compile(r"may still|may go on|to the end of")


@dataclass
class Outcome:
    """What a run has shown.

    Attributes:
        faults: what was not as it must be, in words; none in a good run.
        trace, steps: of the scheduler.
        moved: seconds for which the arm moved.
        simulated: seconds that passed.
        log: what was asked, what happened and what came of it, by its time.
    """

    faults: list[str] = field(default_factory=list)
    trace: int = 0
    steps: int = 0
    moved: float = 0.0
    simulated: float = 0.0
    log: list[str] = field(default_factory=list)


class Watch:
    """Looks at the arm in every cycle."""

    def __init__(self, sim: Simulation, controller: Controller, outcome: Outcome) -> None:
        self._sim = sim
        self._controller = controller
        self._outcome = outcome
        #: the clients that want the arm to move, and until when it may although none does
        self.wanting: set[int] = set()
        self._until = 0.0
        self._is_admitted = False
        self._is_reported = False
        self._q = np.array(controller.arm.setpoint.q)
        advance = controller._control.advance

        def observed() -> None:
            advance()
            self._look()

        controller._control.advance = observed  # type: ignore[method-assign]

    def note(self, text: str) -> None:
        self._outcome.log.append(f"{self._sim.now:10.6f} {text}")

    def fault(self, text: str) -> None:
        self.note(f"FAULT: {text}")
        self._outcome.faults.append(text)

    def begin(self, client: int) -> None:
        """A client asks for something."""
        self.wanting.add(client)

    def end(self, client: int, error: BaseException | None) -> None:
        """It has been told of the end, unless it is gone."""
        if client in self.wanting:
            self.wanting.discard(client)
            self._until = max(self._until, self._sim.now + BRAKING)
            if error is not None and _ADMITS.search(str(error)):
                self._is_admitted = True

    def gone(self, client: int) -> None:
        """A client is killed: what runs on the robot by itself may come to its end."""
        self.wanting.discard(client)
        self._is_admitted = True

    def _look(self) -> None:
        controller = self._controller
        setpoint = controller.arm.setpoint
        speed = float(np.max(np.abs(setpoint.qd)))
        q = np.array(setpoint.q)
        period = 1.0 / controller.firmware.rate
        if np.max(np.abs(q - self._q)) > 1.2 * period * 3.5:  # rad/s: above each joint's limit of 3.34
            self._once(f"a leap of {np.max(np.abs(q - self._q)):.4f} rad in one cycle")
        self._q = q
        if speed <= MOVES:
            if not controller.is_running_program:
                self._is_admitted = False
            return
        self._outcome.moved += period
        if not self.wanting and self._sim.now > self._until and not self._is_admitted:
            self._once(f"the arm moves at {speed:.3f} rad/s, and nobody wants it to: {controller.program_name}")

    def _once(self, text: str) -> None:
        if not self._is_reported:
            self._is_reported = True
            self.fault(text)


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
                motion = _BEGIN[ask.what](robot, ask, block)
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


# -- what is asked for ---------------------------------------------------------------------------------


def _move_joints(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.motion.move_joints(READY + 0.4 * ask.size, speed=0.2 + ask.size)


def _move_linear(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    pose = robot.realtime.wait(2.0).tool_vector_actual.copy()
    pose[2] += 0.1 * (ask.size - 0.5)
    return robot.motion.move_linear(pose, speed=0.05 + 0.1 * ask.size)


def _path(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.motion.path([urlink.Joint(READY + 0.2), urlink.Joint(READY + 0.3 * ask.size)], speed=0.3)


def _speed_joints(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.motion.speed_joints([0.3 * (ask.size - 0.5)] * 6, duration=0.5 * ask.size + 0.05)


def _speed_linear(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.motion.speed_linear([0, 0, 0.1 * (ask.size - 0.5), 0, 0, 0], duration=0.5 * ask.size + 0.05)


def _follow(robot: Any, ask: Ask, block: contextlib.ExitStack, **how: Any) -> Any:
    q = robot.realtime.wait(2.0).q_target
    way = np.array([q, q + 0.1 * ask.size, q + 0.2 * ask.size])
    return robot.motion.follow(urlink.Trajectory.from_arrays([0.0, 0.5, 1.0], way), watchdog=WATCHDOG, **how)


def _servo(robot: Any, ask: Ask, block: contextlib.ExitStack, **how: Any) -> Any:
    servo = block.enter_context(robot.motion.servo(watchdog=WATCHDOG, **how))
    q = robot.realtime.wait(2.0).q_target
    for step in range(int(100 * ask.size)):
        servo.send(q + 0.0005 * step)
        robot.realtime.wait(2.0)
    return servo


def _jog(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    jog = block.enter_context(robot.motion.jog("base", timeout=0.5, watchdog=WATCHDOG))
    jog.move([0, 0, 0.1 * (ask.size - 0.5), 0, 0, 0])
    time.sleep(ask.size)
    return jog


def _force_mode(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    down = [0, 0, 1, 0, 0, 0], [0, 0, -10.0, 0, 0, 0], [0.05] * 6
    return block.enter_context(robot.motion.force_mode("base", *down, watchdog=WATCHDOG))


def _script(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.script.run(f"def p():\n  movej({(READY + 0.2 * ask.size).tolist()}, v=0.5)\nend\n")


def _output(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    robot.io.set_digital_out(0, ask.size > 0.5)
    return None


_BEGIN: dict[str, Callable[[Any, Ask, contextlib.ExitStack], Any]] = {
    "move_joints": _move_joints,
    "move_linear": _move_linear,
    "path": _path,
    "speed_joints": _speed_joints,
    "speed_linear": _speed_linear,
    "follow": _follow,
    "follow_rtde": lambda robot, ask, block: _follow(robot, ask, block, link="rtde"),
    "servo": _servo,
    "servo_rtde": lambda robot, ask, block: _servo(robot, ask, block, link="rtde"),
    "jog": _jog,
    "force_mode": _force_mode,
    "script": _script,
    "output": _output,
}


def run(world: World) -> Outcome:
    """Run a world; the same world gives the same outcome."""
    outcome = Outcome()
    with simulated_time(world.seed, latency=world.latency, jitter=world.jitter, limit=LIMIT) as sim:
        try:
            Run(world, sim, outcome).everything()
        except (Deadlock, TimeLimit) as error:
            outcome.faults.append(f"{type(error).__name__}: {error}")
        outcome.trace, outcome.steps, outcome.simulated = sim.trace, sim.steps, sim.now
    return outcome
