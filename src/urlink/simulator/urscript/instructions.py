"""Functions that make the instructions of the machine.

An instruction is a Python function. It returns the number of the next instruction, which is usually `after`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from . import values
from .errors import Fault, type_error
from .machine import ENDED, GLOBALS, THREAD, Code, Frame, Instruction, ScriptThread, StatementCode, Waiting
from .operations import Function
from .values import NUMBERS, UNSET

# Maximum length of a list whose copy is not counted as work.
_SHORT = 32


class Label:
    """Target of a jump. The position of the target is set later.

    Attributes:
        at: Number of the instruction.
    """

    def __init__(self) -> None:
        self.at = -1


def evaluate(value: Function, after: int) -> Instruction:
    """Evaluate an expression and discard its value."""

    def run(f: Frame, value: Function = value, after: int = after) -> int:
        value(f)
        return after

    return run


def spend(work: int, after: int) -> Instruction:
    """Count the additional work of the next instruction."""

    def run(f: Frame) -> int:
        f[THREAD].machine.spend(work)
        return after

    return run


def store(is_global: bool, slot: int, value: Function, after: int) -> Instruction:
    """Assign to a variable."""
    if is_global:

        def run_global(f: Frame, slot: int = slot, value: Function = value, after: int = after) -> int:
            f[GLOBALS][slot] = value(f)
            return after

        return run_global

    def run(f: Frame, slot: int = slot, value: Function = value, after: int = after) -> int:
        f[slot] = value(f)
        return after

    return run


def store_element(
    is_global: bool, slot: int, name: str, indices: Sequence[Function], value: Function, after: int
) -> Instruction:
    """Assign to an element of a variable."""
    if len(indices) == 1:
        return _store_one(is_global, slot, name, indices[0], value, after)

    def run(f: Frame) -> int:
        at = [index(f) for index in indices]
        new = value(f)
        place = f[GLOBALS] if is_global else f
        old = place[slot]
        if old is UNSET:
            raise Fault(f"The variable '{name}' has no value")
        place[slot] = values.replaced(old, at, new, f[THREAD].machine.charge)
        return after

    return run


def _store_one(is_global: bool, slot: int, name: str, index: Function, value: Function, after: int) -> Instruction:
    def run(f: Frame) -> int:
        at, new = index(f), value(f)
        place = f[GLOBALS] if is_global else f
        old = place[slot]
        if old.__class__ is tuple and at.__class__ is int and new.__class__ in NUMBERS and 0 <= at < len(old) <= _SHORT:
            items = list(old)
            items[at] = new
            place[slot] = tuple(items)
        elif old is UNSET:
            raise Fault(f"The variable '{name}' has no value")
        else:
            place[slot] = values.replaced(old, (at,), new, f[THREAD].machine.charge)
        return after

    return run


def jump(label: Label) -> Instruction:
    """Jump to a label."""
    at = label.at
    return lambda f: at


def jump_to_label(labels: Mapping[str | int, Label], wanted: Function) -> Instruction:
    """Jump to the node of this function that has this name or number."""
    places = {name: label.at for name, label in labels.items()}

    def run(f: Frame) -> int:
        name = wanted(f)
        at = places.get(name) if name.__class__ is str or name.__class__ is int else None
        if at is None:
            raise Fault(f"jump_to_label: there is no label '{values.to_str(name)}' in this function")
        return at

    return run


def branch(condition: Function, otherwise: Label, after: int) -> Instruction:
    """Jump to a label if the condition is false."""
    away = otherwise.at

    def run(f: Frame) -> int:
        value = condition(f)
        if value is True:
            return after
        if value is False:
            return away
        return after if values.truth(value) else away

    return run


def skip_if_set(slot: int, label: Label, after: int) -> Instruction:
    """Jump to a label if a parameter was given."""
    away = label.at
    return lambda f: after if f[slot] is UNSET else away


def call(code: Code, arguments: Sequence[Function], destination: int, after: int) -> Instruction:
    """Call a function of the program."""

    def run(f: Frame) -> int:
        thread: ScriptThread = f[THREAD]
        return thread.call(code, _frame(code, arguments, f), after, destination)

    return run


def leave(value: Function | None) -> Instruction:
    """Return from a function."""

    def run(f: Frame) -> int:
        thread: ScriptThread = f[THREAD]
        return thread.leave(None if value is None else value(f))

    return run


def await_builtin(
    function: Callable[..., Waiting], arguments: Sequence[Function], destination: int, after: int
) -> Instruction:
    """Call a built-in function that takes time."""

    def run(f: Frame) -> int:
        thread: ScriptThread = f[THREAD]
        return thread.await_(function(thread, *[argument(f) for argument in arguments]), after, destination)

    return run


def enter_interpreter(
    statement: Callable[[str], StatementCode], clear_on_enter: Function, clear_on_end: Function, after: int
) -> Instruction:
    """Begin interpreter mode; `statement` compiles a statement."""

    def run(f: Frame) -> int:
        thread: ScriptThread = f[THREAD]
        machine = thread.machine
        if machine.main is not thread:
            raise Fault("interpreter_mode() must be called in the main thread")
        if machine.statements.is_on:
            raise Fault("interpreter_mode() was called in interpreter mode")
        machine.statements.enter(statement, values.truth(clear_on_enter(f)), values.truth(clear_on_end(f)))
        return after

    return run


def interpret(destination: int, after: int) -> Instruction:
    """Run the next statement, or wait for one. Continue at `after` when interpreter mode has ended."""
    here = after - 1

    def wait() -> Waiting:
        yield

    def run(f: Frame) -> int:
        thread: ScriptThread = f[THREAD]
        statements = thread.machine.statements
        if not statements.is_on:
            return after
        taken = statements.take()
        if taken is None:
            return thread.await_(wait(), here, destination)
        # The statement runs in the frame of this function. Extend the frame if the statement has added variables.
        f.extend([UNSET] * (taken.code.size - len(f)))
        f[GLOBALS].extend([UNSET] * (taken.n_globals - len(f[GLOBALS])))
        return thread.call(taken.code, f, here, destination)

    return run


def start(code: Code, arguments: Sequence[Function]) -> Function:
    """Return a function for `run`. It starts a thread, and returns the thread as its value."""

    def run(f: Frame) -> ScriptThread:
        thread: ScriptThread = f[THREAD]
        return thread.machine.start(code, _frame(code, arguments, f))

    return run


def kill(handle: Function, after: int) -> Instruction:
    """End a thread. It can be the calling thread, or a thread that has already ended."""

    def run(f: Frame) -> int:
        thread = _thread(handle(f))
        if thread is not None:
            thread.end()
        return ENDED if thread is f[THREAD] else after

    return run


def join(handle: Function, destination: int, after: int) -> Instruction:
    """Wait until a thread has ended."""

    def wait(thread: ScriptThread | None) -> Waiting:
        while thread is not None and not thread.is_over:
            yield

    def run(f: Frame) -> int:
        thread: ScriptThread = f[THREAD]
        return thread.await_(wait(_thread(handle(f))), after, destination)

    return run


def halt() -> Instruction:
    """End the program; any thread can do this."""

    def run(f: Frame) -> int:
        thread: ScriptThread = f[THREAD]
        thread.machine.main.end()
        return ENDED

    return run


def _frame(code: Code, arguments: Sequence[Function], f: Frame) -> Frame:
    """Return the frame for a called function: the arguments, and `UNSET` for all other variables."""
    frame = [f[GLOBALS], f[THREAD], *[argument(f) for argument in arguments]]
    frame.extend([UNSET] * (code.size - len(frame)))
    return frame


def _thread(value: Any) -> ScriptThread | None:
    """Return the thread of a handle; None for an integer.

    Integers are accepted because programs of drivers kill and join variables that still contain 0.
    """
    if isinstance(value, ScriptThread):
        return value
    if value.__class__ is int:
        return None
    raise type_error(f"the value has the type {values.type_name(value)}; expected a thread handle")
