"""State machine of everything that moves the arm, explored completely: two clients, one controller, and faults.

    client       the phases of its handles (the table of `linkcore.handle`), and whether its interlock is closed
    network      texts to the controller and reports to the client, in order within a connection
    controller   the program that waits or moves, the token in the start place, the stop

Each step of `State.steps` is atomic, and any of them may come next. So a message is in transit for any time, and a
timeout, a cancel or a fault comes at any moment. One stop occurs, which is either a safety stop or a stop at the
pendant. One connection is cut. One text of this connection arrives late, after texts of the next connection.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

from linkcore.handle import TRANSITIONS, Event, Phase

__all__ = ["DEFECTS", "ENDS", "INVARIANTS", "Explored", "State", "begin", "explore", "place"]

T = TypeVar("T")
#: A text is "program", "grant" or "stop"; a report is "asks", "finished", "ended", "expired" or "refused". Each has its
#: handle. A report without a handle is "stop" or "clear".
Message = tuple[str, int]

# Phases by their values, because members of an enumeration are slow to hash. A handle that was not requested has none.
_LIVE = (Phase.SENT.value, Phase.RUNNING.value)
_AFTER = {(before.value, event): after.value for (before, event), after in TRANSITIONS.items()}
#: Replaces a handle that has ended and whose program can no longer arrive, or a missing handle.
_GONE = -1


class State(NamedTuple):
    """One state of the whole system.

    `owners`, `phases`, `asked_anew` and `granted` have one element for each handle. `is_cut`, `is_closed`, `texts` and
    `reports` have one element for each client.

    Attributes:
        owners: Client that requests each handle. The last handle is a script of the user, the others are motions. The
            script might not compile, and is refused then.
        phases: Phase of each handle; None before it is requested.
        asked_anew: Whether the client knew, at the request, that the stop had come and had ended.
        granted: Whether the handle was wanted when its program was granted; None if it was not granted.
        unstopped: Handles that were just cancelled, and whose stop was not sent yet.
        left: Handles that were cancelled, and whose stop is left to the text that was sent after them.
        is_cut: Whether the connection is cut, and the client has not noticed it.
        is_closed: Whether a stop has closed the interlock.
        texts, reports: Messages in transit to the controller and from it.
        late: Remaining text of a cut connection.
        program: Handle whose program is on the controller, and the handle whose grant started it. The second is None
            while the program waits.
        token: Handle whose token is in the start place, while a program waits for its own.
        stop: "to come", "pendant", "holds" or "over"; the last two belong to a safety stop.
        cut: Client whose connection was cut.
    """

    owners: tuple[int, ...]
    phases: tuple[str | None, ...]
    asked_anew: tuple[bool, ...]
    granted: tuple[bool | None, ...]
    unstopped: tuple[int, ...] = ()
    left: tuple[int, ...] = ()
    is_cut: tuple[bool, ...] = (False, False)
    is_closed: tuple[bool, ...] = (False, False)
    texts: tuple[tuple[Message, ...], ...] = ((), ())
    reports: tuple[tuple[Message, ...], ...] = ((), ())
    late: tuple[Message, ...] = ()
    program: tuple[int, int | None] | None = None
    token: int | None = None
    stop: str = "to come"
    cut: int | None = None

    def steps(self, defect: str | None = None) -> Iterator[tuple[str, State]]:
        """Yield each possible next step, named by its actor, and the state after it."""
        for client in sorted({*self.owners}):
            yield from self._user(client)
            yield from self._client(client, defect)
            for kind, handle in self.texts[client][:1]:
                rest = self._replace(texts=_with(self.texts, client, self.texts[client][1:]))
                yield f"controller reads: {kind} {handle}", rest._received(kind, handle)
                if kind == "program" and handle == len(self.owners) - 1:
                    yield f"controller refuses {handle}", rest._report(client, "refused", handle)
            if self.cut is None:
                yield f"fault: client {client} is cut off", self._cut(client, ())
                for kind, handle in self.texts[client]:
                    yield (
                        f"fault: client {client} is cut off, {kind} {handle} is late",
                        self._cut(client, ((kind, handle),)),
                    )
        for kind, handle in self.late:
            yield f"fault: {kind} {handle} comes late", self._replace(late=())._received(kind, handle)
        yield from self._controller(defect)

    # -- users and their clients ---------------------------------------------------------------------

    def _user(self, client: int) -> Iterator[tuple[str, State]]:
        mine = self._handles(client)
        for handle in mine:
            if self.phases[handle] in _LIVE:
                unstopped = (*self.unstopped, handle) if not self.is_cut[client] else self.unstopped
                yield f"user cancels {handle}", self._fire(Event.CANCEL, handle)._replace(unstopped=unstopped)
        new = next((handle for handle in mine if self.phases[handle] is None), None)
        if new is not None and not self.is_closed[client]:
            has_read = all(handle >= 0 for _, handle in self.reports[client])
            asked = self._replace(
                phases=_with(self.phases, new, Phase.SENT.value),
                asked_anew=_with(self.asked_anew, new, self.stop == "over" and has_read),
            )
            yield f"user of client {client} asks for {new}", asked._send("program", new)

    def _client(self, client: int, defect: str | None) -> Iterator[tuple[str, State]]:
        mine = self._handles(client)
        for handle in mine:
            if self.phases[handle] == Phase.SENT.value:
                given_up = self._fire(Event.FAIL, handle)._stop_left(client)
                yield f"client abandons {handle}, which has not begun in time", given_up
        for handle in self.unstopped:
            if handle in mine:
                done = self._replace(unstopped=tuple(each for each in self.unstopped if each != handle))
                is_newest = not any(
                    self.phases[each] in _LIVE or each in self.unstopped for each in mine if each > handle
                )
                if self.is_closed[client] or defect == "cancels without a stop":
                    yield f"client sends no stop of {handle}", done
                elif is_newest or defect == "stops the next motion":
                    yield f"client sends the stop of {handle}", done._without_left(client)._send("stop", handle)
                elif defect == "leaves the motion to a refused script":
                    yield f"client has sent a text that stops {handle} anyway", done
                else:
                    left = done._replace(left=(*done.left, handle))
                    yield f"client has sent a program whose start stops {handle}", left
        for kind, handle in self.reports[client][:1]:
            rest = self._replace(reports=_with(self.reports, client, self.reports[client][1:]))
            name = kind if handle == _GONE else f"{handle} {kind}"
            yield f"client {client} reads: {name}", rest._read(client, kind, handle, defect)
        if self.is_cut[client] and defect != "does not notice a lost connection":
            lost = self._without_left(client)._fire(Event.FAIL, *mine)
            yield (
                f"client {client} notices the loss, and connects again",
                lost._replace(
                    is_cut=_with(self.is_cut, client, False),
                    is_closed=_with(self.is_closed, client, self.stop == "holds"),
                ),
            )

    def _read(self, client: int, kind: str, handle: int, defect: str | None) -> State:
        mine = self._handles(client)
        if kind == "stop":
            script, begun = len(self.owners) - 1, Phase.RUNNING.value
            ends = [each for each in mine if self.phases[each] != begun or each != script]
            if defect == "a stop keeps motions that have not begun":
                ends = [each for each in ends if self.phases[each] == begun]
            stopped = self._without_left(client)._fire(Event.FAIL, *ends)
            return stopped._replace(is_closed=_with(self.is_closed, client, True))
        if kind == "clear":
            return self._replace(is_closed=_with(self.is_closed, client, False))
        if kind == "refused":
            return self._fire(Event.FAIL, handle)._stop_left(client)
        if kind != "asks":
            return self._fire(Event.FINISH if kind == "finished" else Event.FAIL, handle)
        is_wanted = self.phases[handle] in _LIVE
        if not is_wanted and defect != "grants an abandoned motion":
            return self
        begun_now = self._without_left(client)._fire(Event.BEGIN, handle)
        begun_now = begun_now._fire(Event.CANCEL, *(each for each in mine if each < handle))
        if self.is_closed[client]:
            return begun_now._fire(Event.FAIL, handle)
        if self.granted[handle] is None and not self.is_cut[client]:
            begun_now = begun_now._replace(granted=_with(self.granted, handle, is_wanted))
        return begun_now._send("grant", handle)

    # -- the controller ------------------------------------------------------------------------------

    def _received(self, kind: str, handle: int) -> State:
        if kind == "grant":
            waits = self.program is not None and self.program[1] is None
            return self._replace(token=handle) if waits else self  # each program clears the token first
        if self.stop == "holds":
            return self  # the controller refuses programs
        ended = self._without_program("ended")
        return ended if kind == "stop" else ended._begun(handle)

    def _controller(self, defect: str | None) -> Iterator[tuple[str, State]]:
        if self.program is not None:
            handle, granted_by = self.program
            if granted_by is not None:
                yield f"controller: {handle} comes to its end", self._without_program("finished")
            else:
                yield f"controller: {handle} was not granted in time", self._without_program("expired")
                if self.token == handle or (self.token is not None and defect == "one flag for all programs"):
                    yield f"controller: {handle} moves the arm", self._replace(program=(handle, self.token), token=None)
                elif self.token is not None:
                    yield f"controller: {handle} finds another token, and asks again", self._begun(handle)
        if self.stop == "to come":
            yield "person stops the program at the pendant", self._replace(stop="pendant")._without_program("ended")
            stopped = self._replace(stop="holds")._report(0, "stop")._report(1, "stop")
            yield "person makes a safety stop", stopped._without_program("ended")
        elif self.stop == "holds":
            yield "controller: the stop is over", self._replace(stop="over")._report(0, "clear")._report(1, "clear")

    def _begun(self, handle: int) -> State:
        """Start the program of a handle, which clears the start place and asks for its grant."""
        return self._replace(program=(handle, None), token=None)._report(self.owners[handle], "asks", handle)

    def _without_program(self, why: str) -> State:
        if self.program is None:
            return self
        handle, _ = self.program
        return self._replace(program=None, token=None)._report(self.owners[handle], why, handle)

    # -- the network ---------------------------------------------------------------------------------

    def _send(self, kind: str, handle: int) -> State:
        client = self.owners[handle]
        if self.is_cut[client]:
            return self
        return self._replace(texts=_with(self.texts, client, (*self.texts[client], (kind, handle))))

    def _report(self, client: int, kind: str, handle: int = _GONE) -> State:
        if self.is_cut[client]:
            return self
        return self._replace(reports=_with(self.reports, client, (*self.reports[client], (kind, handle))))

    def _cut(self, client: int, late: tuple[Message, ...]) -> State:
        return self._replace(
            cut=client,
            late=late,
            is_cut=_with(self.is_cut, client, True),
            texts=_with(self.texts, client, ()),
            reports=_with(self.reports, client, ()),
            unstopped=tuple(each for each in self.unstopped if self.owners[each] != client),  # no stop can be sent
        )

    # -- parts ---------------------------------------------------------------------------------------

    def _handles(self, client: int) -> list[int]:
        return [handle for handle, owner in enumerate(self.owners) if owner == client]

    def _without_left(self, client: int) -> State:
        return self._replace(left=tuple(each for each in self.left if self.owners[each] != client))

    def _stop_left(self, client: int) -> State:
        """Stop motions that were left to a program that did not begin, unless another sent program stops them."""
        mine = self._handles(client)
        left = [each for each in mine if each in self.left]
        if not left or any(self.phases[each] in _LIVE or each in self.unstopped for each in mine if each > left[0]):
            return self
        return self._without_left(client)._send("stop", left[-1])

    def _fire(self, event: Event, *handles: int) -> State:
        """Apply an event to handles, according to the table of `linkcore.handle`."""
        phases = self.phases
        for handle in handles:
            after = _AFTER.get((phases[handle] or "", event))
            phases = phases if after is None else _with(phases, handle, after)
        return self._replace(phases=phases)

    def essence(self, defect: str | None = None) -> State:
        """Return the state without irrelevant details: how handles ended, and remains of ended handles."""
        is_over = [phase is not None and phase not in _LIVE for phase in self.phases]
        if True not in is_over:
            return self
        coming = {handle for texts in (*self.texts, self.late) for kind, handle in texts if kind == "program"}
        if self.program is not None:
            coming.add(self.program[0])
        gone = {handle for handle, over in enumerate(is_over) if over and handle not in coming}

        def without_gone(texts: tuple[Message, ...]) -> tuple[Message, ...]:
            return tuple([(kind, _GONE if handle in gone else handle) for kind, handle in texts]) if gone else texts

        reports = self.reports
        if defect != "grants an abandoned motion":  # without this defect, these reports have no effect
            reports = tuple([tuple([m for m in some if m[1] == _GONE or not is_over[m[1]]]) for some in reports])
        ended = Phase.FAILED.value
        return self._replace(
            phases=tuple([ended if over else phase for phase, over in zip(self.phases, is_over, strict=True)]),
            asked_anew=tuple([anew and handle not in gone for handle, anew in enumerate(self.asked_anew)]),
            granted=tuple([None if handle in gone else granted for handle, granted in enumerate(self.granted)]),
            left=tuple([handle for handle in self.left if handle not in gone]) if self.left else (),
            texts=tuple([without_gone(texts) for texts in self.texts]),
            late=without_gone(self.late),
            reports=reports,
            token=_GONE if self.token in gone else self.token,
        )


def begin(*owners: int) -> State:
    """Return the initial state, without requests; `owners` lists the clients in the order of their requests."""
    return State(owners, (None,) * len(owners), (False,) * len(owners), (None,) * len(owners))


def _with(values: tuple[T, ...], place: int, value: T) -> tuple[T, ...]:
    return (*values[:place], value, *values[place + 1 :])


# -- invariants of each state ------------------------------------------------------------------------


def _moving(state: State) -> tuple[int, int] | None:
    """Return the handle whose program moves the arm, and the handle whose grant started it."""
    if state.program is None or state.program[1] is None:
        return None
    return state.program[0], state.program[1]


def _granted_by_its_own(state: State) -> bool:
    moving = _moving(state)
    return moving is None or moving[0] == moving[1]


def _granted_while_wanted(state: State) -> bool:
    moving = _moving(state)
    return moving is None or bool(state.granted[moving[0]])


def _ends_with_its_handle(state: State) -> bool:
    """Whether a moving handle has not ended, or its stop follows in the same connection, or this was cut."""
    moving = _moving(state)
    if moving is None:
        return True
    handle, client = moving[0], state.owners[moving[0]]
    if state.phases[handle] in _LIVE or state.cut == client:
        return True
    if any(state.owners[other] == client and other >= handle for other in state.unstopped):
        return True  # its own stop will be sent, or the stop of a later handle
    under_way = *state.texts[client], *state.reports[client]
    return any(kind == "stop" or (kind in ("program", "refused") and other >= handle) for kind, other in under_way)


def _stops_in_order(state: State) -> bool:
    for texts in state.texts:
        stopped = [(place, handle) for place, (kind, handle) in enumerate(texts) if kind == "stop"]
        for place, handle in stopped:
            before = [other for kind, other in texts[:place] if kind == "program"]
            if any(other > handle and state.phases[other] in _LIVE for other in before):
                return False
    return True


def _asked_anew(state: State) -> bool:
    moving = _moving(state)
    return moving is None or state.stop not in ("holds", "over") or state.asked_anew[moving[0]]


INVARIANTS: Mapping[str, Callable[[State], bool]] = {
    "no program starts with the grant of another one": _granted_by_its_own,
    "a moving program was wanted when it was granted": _granted_while_wanted,
    "an abandoned motion does not continue": _ends_with_its_handle,
    "no stop is sent after the next motion": _stops_in_order,
    "after a stop only newly requested motions move": _asked_anew,
}
#: Invariant of a state from which clients and controller alone, without users and faults, can end all handles.
ENDS = "each handle can reach an end"

#: For each defect, the owners of the handles, and the invariant that it violates.
DEFECTS: Mapping[str, tuple[tuple[int, ...], str]] = {
    "one flag for all programs": ((0, 1), "no program starts with the grant of another one"),
    "grants an abandoned motion": ((0, 1), "a moving program was wanted when it was granted"),
    "cancels without a stop": ((0, 1), "an abandoned motion does not continue"),
    "leaves the motion to a refused script": ((0, 0), "an abandoned motion does not continue"),
    "stops the next motion": ((0, 0), "no stop is sent after the next motion"),
    "a stop keeps motions that have not begun": ((0, 1), "after a stop only newly requested motions move"),
    "does not notice a lost connection": ((0,), ENDS),
}

# -- all states --------------------------------------------------------------------------------------


@dataclass
class Explored:
    """Result of the exploration.

    Attributes:
        states, steps: Numbers of states and steps. States that differ only in irrelevant details count once.
        transitions: Phases of handles before and after each transition.
        places: `place` of handles before and after each step.
        violated: Shortest sequence of steps to a state that violates each invariant.
    """

    states: int = 0
    steps: int = 0
    transitions: set[tuple[str | None, str | None]] = field(default_factory=set)
    places: set[tuple[tuple[str, str], tuple[str, str]]] = field(default_factory=set)
    violated: dict[str, list[str]] = field(default_factory=dict)


def place(state: State, handle: int) -> tuple[str, str]:
    """Return the phase of a handle, or "over", and the state of its program: "none", "waits" or "moves"."""
    phase = state.phases[handle] or ""
    where = "none"
    if state.program is not None and state.program[0] == handle:
        where = "waits" if state.program[1] is None else "moves"
    return phase if phase in ("", *_LIVE) else "over", where


def explore(start: State, defect: str | None = None, until: Collection[str] = ()) -> Explored:
    """Explore all states breadth first, or until all invariants in `until` have been violated."""
    found = Explored()
    number = {start: 0}
    states = [start]
    came: list[tuple[int, str]] = [(0, "")]
    before: list[list[int]] = [[]]  # previous states from which clients and controller alone reach each state

    def way(to: int) -> list[str]:
        steps = []
        while to:
            to, step = came[to]
            steps.append(step)
        return steps[::-1]

    for here, state in enumerate(states):  # the list grows during the loop
        for name, holds in INVARIANTS.items():
            if name not in found.violated and not holds(state):
                found.violated[name] = way(here)
        if until and found.violated.keys() >= set(until):
            break
        for step, after in state.steps(defect):
            found.steps += 1
            if after.phases != state.phases:
                found.transitions.update(zip(state.phases, after.phases, strict=True))
            if after.phases != state.phases or after.program != state.program:
                for handle in range(len(state.owners)):
                    found.places.add((place(state, handle), place(after, handle)))
            after = after.essence(defect)
            there = number.setdefault(after, len(states))
            if there == len(states):
                states.append(after)
                came.append((here, step))
                before.append([])
            if step.startswith(("client", "controller")):
                before[there].append(here)
    else:
        can_end = [not any(phase in _LIVE for phase in state.phases) for state in states]
        todo = [here for here, ends in enumerate(can_end) if ends]
        for there in todo:
            for here in before[there]:
                if not can_end[here]:
                    can_end[here] = True
                    todo.append(here)
        if not all(can_end):
            found.violated[ENDS] = way(can_end.index(False))
    found.states = len(states)
    return found
