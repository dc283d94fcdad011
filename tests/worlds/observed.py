"""Observation of the library and the controller in a world, step by step, and checks of their actions.

While a world runs, wrappers surround the methods that send programs, permissions and messages of a client, and the
methods with which the controller starts and ends programs. So the sender of each program is known, the state of its
handle, the sender of its permission, and the times at which it moved the arm. The library's own records are not used.
"""

from __future__ import annotations

import contextlib
import math
import re
import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from threading import get_ident
from typing import Any, cast

from linkcore.handle import Event, Handle, Lifecycle, Phase
from linkcore.pending_call import current_call
from linkcore.simulated import Computer, Simulation
from linkcore.simulated.scheduler import current
from linkcore.streaming.connection import Connection
from linkcore.streaming.fanout import FanOut
from urlink.command.channel import CommandChannel
from urlink.command.programs import Programs
from urlink.motion.links.register_link import RegisterLink
from urlink.motion.links.reverse import ReverseLink
from urlink.motion.servo.linked_program import LinkedProgram
from urlink.protocol.primary.robot_state import RobotState
from urlink.protocol.realtime.packets import RealtimeState
from urlink.robot import Robot
from urlink.rtde import Rtde
from urlink.script import wrapping
from urlink.script.messages import MESSAGE_SIZE, STOP_MESSAGE, WAIT_MESSAGE
from urlink.script.wrapping import Wrapped
from urlink.simulator import Controller
from urlink.simulator.interfaces.interface import ScriptReceiver
from urlink.simulator.programs.pendant import Pendant
from urlink.simulator.programs.program_world import ProgramWorld

__all__ = ["ADMITS", "BRAKING", "Observed", "Sent", "here", "replaced"]

#: Text of an error that states that the arm might continue.
ADMITS = re.compile(r"(?:may|might) (?:still|continue|go on|resume)|to the end of")
#: Time for an arm to come to rest after a stop, in s on the controller's clock.
BRAKING = 1.0
#: Time after which an arm must not become faster, in s on the controller's clock. It exceeds a watchdog of `asked`.
_OBEYING = 0.5
#: Time for which a speed motion may continue after its client has disconnected, in s.
_SPEED = 0.5
#: Time after the end of a stop in which a client stops the program that the controller has kept, in s: two states.
_KEPT = 0.3
#: Time after local control in which an ignored stop is sent again while the robot object is open, in s.
_RESENT = 0.5
#: Time that a wait may exceed its timeout, in s.
_LATE = 1.5
#: Age of states above which the interlock permits nothing, in s.
_STALE = 1.0


@dataclass(eq=False)
class Sent:
    """Program of the library, observed from the client and from the controller. All times are in s.

    Attributes:
        computer: Computer that sent it.
        wrapped, life: Arguments of `Programs.start`.
        is_stop, is_linked: Arguments of `Programs.start`.
        asked: Time at which its text was sent; before that, the time of the request.
        entered: Time at which the call that sent it was entered.
        thread: Number of the thread that sent it.
        abandoned: Time at which this call raised and left no handle; None otherwise.
        ended, error: Time of the end of its handle, and its error.
        begun: Time at which the controller started it; None before.
        over: Time at which the controller ended it.
        is_finished: Whether it has reported its own end.
        granted: Time at which its start permission arrived from its client; None without a permission.
        moved: Whether it has moved the arm.
        place: Newest of `Observed.places`.
        rests: Number of cycles in which it may continue to brake, since the end of its handle.
        ignored: Time at which the controller was last in local control.
    """

    computer: Computer
    wrapped: Wrapped
    life: Lifecycle
    is_stop: bool
    is_linked: bool
    asked: float
    entered: float
    thread: int
    abandoned: float | None = None
    ended: float | None = None
    error: BaseException | None = None
    begun: float | None = None
    over: float | None = None
    is_finished: bool = False
    granted: float | None = None
    rests: int = 0
    ignored: float = -math.inf
    moved: bool = False
    place: tuple[str, str] = ("", "none")

    @property
    def unwanted(self) -> float | None:
        """Time since which it is unwanted, in s: its handle ended, or the call that should return it raised."""
        times = [each for each in (self.ended, self.abandoned) if each is not None]
        return min(times) if times else None

    @property
    def is_admitted(self) -> bool:
        """Whether its error states that the arm might continue."""
        return self.error is not None and ADMITS.search(str(self.error)) is not None

    @property
    def grant(self) -> str | None:
        """Text of its start permission."""
        return None if self.wrapped.permission is None else wrapping.grant(self.wrapped.permission)


@dataclass
class _Known:
    """Knowledge of a client from completely handled states, which are the states before the newest batch.

    Attributes:
        stopped: Number of consecutive cycles with a stop.
        at: Arrival time of the newest batch; None while the client is not connected.
    """

    stopped: int = 0
    at: float | None = None
    next_stopped: int = 0


@contextlib.contextmanager
def replaced(owner: Any, name: str, around: Callable[[Any], Any]) -> Iterator[None]:
    """Replace a method or property of a class, or a method of an object, by `around(it)` while the block lasts."""
    had = name in vars(owner)
    method = getattr(owner, name)
    setattr(owner, name, around(method))
    try:
        yield
    finally:
        if had:
            setattr(owner, name, method)
        else:
            delattr(owner, name)


def here() -> Computer:
    """Return the computer of the running thread."""
    scheduler = current()
    assert scheduler is not None
    return cast("Computer", scheduler.running.computer)


class Observed:
    """Programs, permissions, messages and ends of one world.

    Args:
        sim: Simulation of the world.
        controller: Controller of the world.
        fault: Function that reports a fault.

    Attributes:
        programs: Sent programs by name.
        transitions: Phases of handles before and after each transition.
        places: `model.place` of programs with a start permission, before and after each step.
    """

    def __init__(self, sim: Simulation, controller: Controller, fault: Callable[[str], object]) -> None:
        self.programs: dict[str, Sent] = {}
        self.transitions: set[tuple[str, str]] = set()
        self.places: set[tuple[tuple[str, str], tuple[str, str]]] = set()
        self._sim = sim
        self._controller = controller
        self._fault = fault
        self._linked: list[LinkedProgram] = []
        self._farewells: set[int] = set()
        self._links: list[object] = []  # keeps the links alive, because their ids are keys
        #: Times at which program connections of a computer were lost.
        self._lost: dict[Computer, list[float]] = {}
        self._known: dict[Computer, _Known] = {}
        self._held: dict[Computer, float] = {}
        self._since: dict[Computer, float] = {}
        self._dead: set[Computer] = set()
        #: Time at which a robot object of each computer was last closed.
        self._closed: dict[Computer, float] = {}
        #: Cycles of the controller since its boot in which a stop was active.
        self.stops: dict[int, bool] = {}
        #: Start and end of each stop, in s.
        self.stopped: list[list[float]] = []
        #: Running calls: computer, method, and time of entry in s.
        self.calls: list[tuple[Computer, str, float]] = []
        #: Time of entry of the running call of each thread.
        self._call_of: dict[int, float] = {}
        #: Stops of a client that have returned: times of entry and of return, in s.
        self._stops: dict[Computer, list[tuple[float, float]]] = {}
        #: Channels of robots whose `close` has returned.
        self._left: weakref.WeakSet[CommandChannel] = weakref.WeakSet()
        #: Times at which a person or a client resumed a paused program.
        self.played: list[float] = []
        self.stop_holds = False
        self._counted = 0.0
        #: RTDE client that each robot returned first.
        self._rtdes: weakref.WeakKeyDictionary[Robot, Rtde] = weakref.WeakKeyDictionary()

    # -- wrapped methods -------------------------------------------------------------------------------

    @contextlib.contextmanager
    def watching(self) -> Iterator[None]:
        """Observe while the block lasts."""
        runner = self._controller._runner
        around: list[tuple[Any, str, Callable[[Any], Any]]] = [
            (Programs, "start", self._start),
            (Programs, "close", self._close),
            (CommandChannel, "_send_some", self._text),
            (LinkedProgram, "begin", self._link_begins),
            (ReverseLink, "send", self._sending),
            (RegisterLink, "send", self._sending),
            (Lifecycle, "fire", self._fire),
            (Handle, "wait", self._wait),
            (Robot, "rtde", self._rtde),
            (Robot, "close", self._leave),
            (FanOut, "publish", self._publish),
            (Connection, "_disconnected", self._disconnected),
            (Computer, "suspend", self._suspend),
            (Computer, "resume", self._resume),
            (Computer, "kill", self._die),
            (Computer, "power_off", self._die),
            (ProgramWorld, "text_message", self._message),
            (Pendant, "play", self._play),
            (runner, "start", self._begun),
            (runner, "_ended", self._over),
            (ScriptReceiver, "__init__", self._receiver),
        ]
        with contextlib.ExitStack() as stack:
            for owner, name, wrap in around:
                stack.enter_context(replaced(owner, name, wrap))
            yield

    # -- clients -----------------------------------------------------------------------------------------

    def _start(self, start: Callable[..., None]) -> Callable[..., None]:
        def wrapped(programs: Programs, text: Wrapped, life: Lifecycle, **how: Any) -> None:
            is_stop, is_linked = how.get("is_stop", False), how.get("is_linked", False)
            entered, ident = self._entered(life.name), get_ident()
            sent = Sent(here(), text, life, is_stop, is_linked, self._sim.now, entered, ident)
            self.programs[text.name] = sent
            self._step(sent)
            life.on_end(lambda: self._ended(sent))
            start(programs, text, life, **how)

        return wrapped

    # -- calls -------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def calling(self, name: str, *, in_thread: bool = True) -> Iterator[float]:
        """Record that a client makes a call while the block lasts; yield the time of its entry.

        Args:
            name: Name of the method.
            in_thread: Whether the calling thread makes the call, rather than a worker thread for a task.
        """
        entered, client, ident = self._sim.now, here(), get_ident()
        call = client, name, entered
        self.calls.append(call)
        before = self._call_of.get(ident)
        if in_thread:
            self._call_of[ident] = entered
        try:
            yield entered
        finally:
            self.calls.remove(call)
            self._call_of.pop(ident, None)
            if before is not None:
                self._call_of[ident] = before

    def _entered(self, name: str) -> float:
        """Return the time of entry of the call that starts a program of this name."""
        found = self._call_of.get(get_ident())
        if found is None:
            found = max((at for who, what, at in self.calls if who is here() and what == name), default=self._sim.now)
        return found

    def has_stopped(self, entered: float) -> None:
        """Record the return of a stop that was entered then: programs requested earlier must not be sent."""
        self._stops.setdefault(here(), []).append((entered, self._sim.now))

    def abandon(self, entered: float, name: str | None = None) -> bool:
        """Record that a call which was entered then has raised without a handle: its programs must not continue.

        Args:
            entered: Time of entry of the call, in s.
            name: Name of the method, if another thread made the call.

        Returns:
            Whether there is such a program.
        """
        has_any = False
        for sent in self._of(here()):
            is_its = sent.thread == get_ident() if name is None else sent.life.name == name
            if is_its and sent.entered >= entered and not sent.is_stop and not sent.life.is_over:
                sent.abandoned = self._sim.now
                has_any = True
        return has_any

    def pause(self, block: Any) -> None:
        """Record that a block has no wanted motion now, because its request was cancelled."""
        for sent in self._of(here()):
            if sent.life is block._part._life:
                sent.abandoned = self._sim.now

    def resume(self, block: Any) -> None:
        """Record that a block gets requests again."""
        for sent in self._of(here()):
            if sent.life is block._part._life:
                sent.abandoned, sent.rests = None, 0

    def _leave(self, close: Callable[..., None]) -> Callable[..., None]:
        def wrapped(robot: Robot, *arguments: Any, **options: Any) -> None:
            close(robot, *arguments, **options)
            control = robot._control.made
            if control is not None:
                self._left.add(control.script._channel)

        return wrapped

    def _overtaken(self, sent: Sent, stops: int) -> str | None:
        """Return the reason why a program must not be sent after the first `stops` stops, or None."""
        for entered, returned in self._stops.get(sent.computer, [])[:stops]:
            if sent.entered < entered and not sent.is_stop:
                return f"was requested at {sent.entered:.6f} s, before the stop that returned at {returned:.6f} s"
        return None

    def _ended(self, sent: Sent) -> None:
        sent.ended, sent.error = self._sim.now, sent.life.error
        self._step(sent)

    def _step(self, sent: Sent) -> None:
        """Record a change of the place of a program with a start permission."""
        if sent.wrapped.permission is None:
            return
        phase = "over" if sent.life.is_over else sent.life.phase.value
        is_there = sent.begun is not None and sent.over is None
        after = phase, ("moves" if sent.moved else "waits") if is_there else "none"
        if after != sent.place:
            self.places.add((sent.place, after))
            sent.place = after

    def _text(self, send: Callable[..., None]) -> Callable[..., None]:
        def wrapped(channel: CommandChannel, text: Any, decide: Callable[[], object]) -> None:
            was_begun, whole = text.is_begun, bytes(text.rest).decode()
            is_permission = whole.startswith("sec urlink_permission")
            refusal = None if was_begun else self._refusal()
            call = current_call()
            is_given_up = call is not None and call.is_given_up
            permitted = [sent for sent in self._of(here()) if is_permission and sent.grant == whole]
            is_wanted = not permitted or any(not sent.life.is_over for sent in permitted)
            # If a signal handler stops the robot during this call, the text is still sent. It moves nothing without a
            # permission (urlink.command.section).
            stops = len(self._stops.get(here(), ()))
            send(channel, text, decide)
            if was_begun or not text.is_begun:
                return
            for sent in self._of(here()):
                if sent.wrapped.text == whole:
                    sent.asked = self._sim.now
                    overtaken = self._overtaken(sent, stops)
                    if overtaken is not None:
                        self._fault(f"{here().name} sent {sent.wrapped.name} ({sent.life.name}), which {overtaken}")
            if channel in self._left:
                self._fault(f"{here().name} sent {whole.splitlines()[0]} after its robot was closed")
            if refusal is not None and (is_permission or whole.startswith("def ")):
                self._fault(f"{here().name} sent {whole.splitlines()[0]} although {refusal}")
            if is_given_up:
                self._fault(f"{here().name} sent {whole.splitlines()[0]} for a cancelled task")
            if not is_wanted:
                self._fault(f"{here().name} permitted {permitted[-1].wrapped.name}, whose handle had ended")

        return wrapped

    def _link_begins(self, begin: Callable[..., None]) -> Callable[..., None]:
        def wrapped(program: LinkedProgram) -> None:
            self._linked.append(program)
            begin(program)

        return wrapped

    def _sending(self, send: Callable[..., None]) -> Callable[..., None]:
        def wrapped(link: object, data: bytes) -> None:
            message = data[:MESSAGE_SIZE]
            leads = len(data) > MESSAGE_SIZE and message not in (STOP_MESSAGE, WAIT_MESSAGE)
            refusal = self._refusal() if leads else None
            send(link, data)
            if message == STOP_MESSAGE:
                self._farewells.add(id(link))
                self._links.append(link)
            elif id(link) in self._farewells:
                self._fault(f"{here().name} sent a message to a program after the one that ends it")
            elif refusal is not None:
                self._fault(f"{here().name} sent a set-point although {refusal}")

        return wrapped

    def _fire(self, fire: Callable[..., bool]) -> Callable[..., bool]:
        def wrapped(life: Lifecycle, event: Event, *rest: Any, **named: Any) -> bool:
            before = life.phase
            has_happened = fire(life, event, *rest, **named)
            if life.phase is not before:
                self.transitions.add((before.value, life.phase.value))
                for sent in tuple(self.programs.values()):
                    if sent.life is life:
                        self._step(sent)
            elif event in (Event.FINISH, Event.CANCEL, Event.FAIL) and not life.is_over:
                self._fault(f"{life.name} is {life.phase.value} after {event.value}")
            return has_happened

        return wrapped

    def _wait(self, wait: Callable[..., None]) -> Callable[..., None]:
        def wrapped(handle: Handle, timeout: float = 60.0, **how: Any) -> None:
            computer, begun = here(), self._sim.now
            held = self._held_of(computer)
            try:
                wait(handle, timeout, **how)
            finally:
                took = self._sim.now - begun - (self._held_of(computer) - held)
                if took > timeout * 1.001 + _LATE and computer not in self._dead:
                    self._fault(f"{handle.name}: wait({timeout:g}) took {took:.2f} s")

        return wrapped

    def _rtde(self, rtde: property) -> property:
        def made(robot: Robot) -> Rtde:
            assert rtde.fget is not None
            one: Rtde = rtde.fget(robot)
            if self._rtdes.setdefault(robot, one) is not one:
                self._fault(f"{here().name}: a robot has two RTDE clients with separate claims")
            return one

        return property(made)

    def _publish(self, publish: Callable[..., None]) -> Callable[..., None]:
        def wrapped(fan_out: FanOut, packets: Any, is_steady: bool = False) -> None:
            states = [packet for packet in packets if type(packet) is RealtimeState]
            if states:
                known = self._known.setdefault(here(), _Known())
                known.stopped = known.next_stopped
                known.at = self._sim.now
                for state in states:
                    if state.robot_mode is None:
                        continue  # 1.5 reports stops only on the primary interface, ten times per second
                    holds = self.stops.get(round(state.time * self._controller.firmware.rate), False)
                    known.next_stopped = known.next_stopped + 1 if holds else 0
                if not known.next_stopped:
                    known.stopped = 0
            publish(fan_out, packets, is_steady)

        return wrapped

    def _disconnected(self, disconnected: Callable[..., None]) -> Callable[..., None]:
        def wrapped(connection: Connection, error: Exception | None) -> None:
            if not connection.is_over and connection.fan_out.carries(RobotState):
                self._lost.setdefault(here(), []).append(self._sim.now)
            disconnected(connection, error)

        return wrapped

    def _refusal(self) -> str | None:
        """Return the reason why the client of the running thread must not move the arm, or None."""
        known = self._known.get(here())
        if known is None or known.at is None:
            return None
        if known.stopped > 3:
            return f"it knew of a stop for {known.stopped} states"
        return None

    # -- computers ---------------------------------------------------------------------------------------

    def _suspend(self, suspend: Callable[..., None]) -> Callable[..., None]:
        def wrapped(computer: Computer) -> None:
            self._since.setdefault(computer, self._sim.now)
            suspend(computer)

        return wrapped

    def _resume(self, resume: Callable[..., None]) -> Callable[..., None]:
        def wrapped(computer: Computer) -> None:
            resume(computer)
            self._held[computer] = self._held_of(computer)
            self._since.pop(computer, None)

        return wrapped

    def _die(self, die: Callable[..., None]) -> Callable[..., None]:
        def wrapped(computer: Computer) -> None:
            self._dead.add(computer)
            die(computer)

        return wrapped

    def _held_of(self, computer: Computer) -> float:
        since = self._since.get(computer)
        return self._held.get(computer, 0.0) + (0.0 if since is None else self._sim.now - since)

    def is_held(self, computer: Computer) -> bool:
        """Whether a computer is suspended."""
        return computer in self._since

    def lost_since(self, computer: Computer, moment: float) -> bool:
        """Whether a connection of a computer was lost after `moment`."""
        return any(at >= moment for at in self._lost.get(computer, ()))

    def has_arrived(self, computer: Computer) -> bool:
        """Whether all data sent by a computer has arrived."""
        return not any(end.unacknowledged for end in computer.ends)

    def _of(self, computer: Computer) -> list[Sent]:
        return [sent for sent in self.programs.values() if sent.computer is computer]

    # -- the controller ----------------------------------------------------------------------------------

    def _receiver(self, make: Callable[..., None]) -> Callable[..., None]:
        def wrapped(receiver: ScriptReceiver, client: Any, counters: Any, on_line: Any, on_program: Any) -> None:
            host = client.connection.peer[0]

            def taken(text: str) -> bool:
                if text.startswith("sec urlink_permission"):
                    for sent in self.programs.values():
                        if self._permits(text, host, sent) and sent.begun is not None and sent.over is None:
                            sent.granted = self._sim.now
                has_taken: bool = on_program(text)
                return has_taken

            make(receiver, client, counters, on_line, taken)

        return wrapped

    @staticmethod
    def _permits(text: str, host: str, sent: Sent) -> bool:
        """Whether a text permits a program: it comes from its client, or flags are used.

        On flags, two programs can have the same token by chance (docs/motion-ends.md).
        """
        permission = sent.wrapped.permission
        is_unique = permission is not None and permission.place.register is not None
        return sent.grant == text and (sent.computer.address == host or not is_unique)

    def _begun(self, start: Callable[..., None]) -> Callable[..., None]:
        def wrapped(script: Any) -> None:
            main = self._controller._runner.main
            before = self.programs.get(main.name) if main is not None and main.is_program else None
            match = re.fullmatch(r"urlink_stop_(\w+)_\d+", script.name)
            if match is not None and before is not None and f"_{match[1]}_" in before.wrapped.name:
                # In local control, the controller may have ignored a later program that should have replaced it.
                is_replaced = any(
                    sent.asked > before.asked and sent.life.is_over and not sent.wrapped.is_secondary
                    for sent in self.programs.values()
                    if f"_{match[1]}_" in sent.wrapped.name
                )
                if not (is_replaced or before.life.is_over or self.lost_since(before.computer, before.asked)):
                    self._fault(f"{script.name} stops {before.wrapped.name}, which was not cancelled")
            sent = self.programs.get(script.name)
            if sent is not None:
                sent.begun = self._sim.now
                self._step(sent)
            start(script)

        return wrapped

    def _over(self, ended: Callable[..., None]) -> Callable[..., None]:
        def wrapped(program: Any) -> None:
            sent = self.programs.get(program.name)
            if sent is not None:
                sent.over = self._sim.now
                self._step(sent)
            ended(program)

        return wrapped

    def _close(self, close: Callable[[Programs, float], None]) -> Callable[[Programs, float], None]:
        def wrapped(programs: Programs, timeout: float) -> None:
            client, network = here(), self._sim.network
            self._closed[client] = self._sim.now
            close(programs, timeout)
            robot = network.find(self._controller.host, client)

            def look() -> None:
                if robot is not None and not network.carries(client, robot):
                    self._lost.setdefault(client, []).append(self._sim.now)

            # Data that is not acknowledged within 0.7 s after the last text of `close` is discarded.
            for tenths in range(8):
                self._sim.at(self._sim.now + tenths / 10, look)

        return wrapped

    def _play(self, play: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(pendant: Pendant) -> Any:
            self.played.append(self._sim.now)
            return play(pendant)

        return wrapped

    def _message(self, message: Callable[..., None]) -> Callable[..., None]:
        def wrapped(world: ProgramWorld, text: str) -> None:
            sent = self.programs.get(text.removesuffix(" finished"))
            if sent is not None and text.endswith(" finished"):
                sent.is_finished = True
            message(world, text)

        return wrapped

    # -- in each cycle -----------------------------------------------------------------------------------

    def count_rests(self) -> None:
        """Count the cycles in which programs may continue after the end of their handles.

        A suspended controller catches up on its cycles before it reads new data, so these cycles count once.
        """
        if self._sim.now - self._counted < 0.5 / self._controller.firmware.rate:
            return
        self._counted = self._sim.now
        for sent in self.programs.values():
            if not self._controller.remote_control:
                sent.rests, sent.ignored = 0, self._sim.now  # local control ignores a stop, which is sent again
                continue
            is_ending = sent.unwanted is not None and not self.is_held(sent.computer)
            if sent.over is None and (sent.computer in self._dead or (is_ending and self.has_arrived(sent.computer))):
                sent.rests += 1

    def waits(self, sent: Sent) -> bool:
        """Whether a program has started, has not ended, and must not move the arm before its client permits it."""
        is_under_way = sent.begun is not None and sent.over is None
        return is_under_way and sent.wrapped.permission is not None and sent.granted is None

    def why_not(self, sent: Sent, is_faster: bool) -> str | None:
        """Return the reason why this program must not move the arm in this cycle, or None.

        Args:
            sent: Program on the controller.
            is_faster: Whether it does more than braking.
        """
        rate = self._controller.firmware.rate
        braking = (_OBEYING if is_faster else BRAKING) * rate
        now, is_dead = self._sim.now, sent.computer in self._dead
        if self.waits(sent) and (is_faster or now > (sent.begun or 0.0) + BRAKING):
            return "which has no permission from its own client"
        if self.stopped and not sent.is_stop and is_faster and not any(at > self.stopped[-1][0] for at in self.played):
            begun, over = self.stopped[-1]
            if sent.asked < over:
                return f"which was requested at {sent.asked:.3f} s, before the stop of {begun:.3f} s had ended"
        if is_dead and (sent.is_linked or sent.life.name.startswith("speed")) and sent.rests > braking + _SPEED * rate:
            return "whose client has disconnected"
        if is_faster and not sent.moved:
            sent.moved = True
            self._step(sent)
        is_gone = is_dead or not sent.computer.is_running
        unwanted = sent.unwanted
        if unwanted is None or sent.is_stop or is_gone or sent.is_admitted or sent.rests <= braking:
            return None
        if not sent.is_linked and self.lost_since(sent.computer, unwanted - 1.0):
            return None  # its stop may be lost with the connection
        if self._is_kept(sent) or self._closed.get(sent.computer, math.inf) <= sent.ignored + _RESENT:
            return None
        if sent.ended is None:
            return f"whose call raised at {unwanted:.3f} s"
        return f"whose handle ended at {sent.ended:.3f} s: {sent.error}"

    def _is_kept(self, sent: Sent) -> bool:
        """Whether the controller has kept a program that was abandoned during a stop, and has resumed it.

        During a stop, the controller accepts no program. A person or the end of the stop may resume the kept program.
        Its client stops it within `_KEPT` of that. The client cannot do so if it was closed earlier, or if the network
        was cut and it has only read about the stop; docs/safety.md describes this.
        """
        ended = sent.unwanted
        assert ended is not None
        closed, known = self._closed.get(sent.computer, math.inf), self._known.get(sent.computer)
        is_unaware = known is not None and known.next_stopped > 0
        until = ended + _KEPT  # at a later stop, the program is stopped already, unless two stops follow each other
        for begun, over in self.stopped:
            if begun <= until and ended <= over + _KEPT:
                until = max(until, over + _KEPT)
                is_in_time = is_unaware or min(closed, self._sim.now) <= over + _KEPT
                if is_in_time and self.played[-1:] > [over]:
                    return True
        return False

    # -- at the end --------------------------------------------------------------------------------------

    def check_ends(self) -> None:
        """Check that the end of each handle agrees with the actions of the controller."""
        for name, sent in self.programs.items():
            phase = sent.life.phase
            if sent.computer.is_running and not sent.life.is_over:
                self._fault(f"{name} is {phase.value} after the end of its client")
            if phase is Phase.DONE and not (sent.is_finished or sent.is_linked or sent.wrapped.is_secondary):
                self._fault(f"{name} is done, but the controller has not finished it")
