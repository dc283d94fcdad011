"""Functions of the program itself (time, critical sections, messages), and unmodelled functions.

A program with a function that is not modelled compiles, but calling the function is a run-time error. A function that
becomes modelled moves to its family. The firmware that introduced each function is not checked, except that CB2
certainly has none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import Fault
from ..machine import ScriptThread, Waiting
from ..values import to_str
from .declaration import boolean, declare, number
from .mathematics import made


@declare(takes_time=True, in_secondary=False)
def sync(thread: ScriptThread) -> Waiting:
    """Wait for the next cycle."""
    yield


@declare(takes_time=True, in_secondary=False)
def sleep(thread: ScriptThread, t: Any) -> Waiting:
    """Wait `t` seconds, rounded up to whole cycles, at least one (assumed)."""
    seconds = number(t, "sleep: t")
    if seconds < 0:
        raise Fault("sleep: t must not be negative")
    # A millionth of a cycle is a rounding error.
    cycles = seconds / thread.world.period - 1e-6
    waited = 0
    while True:
        yield
        waited += 1
        if waited >= cycles:
            return


@declare("exit_critical")
def enter_critical(thread: ScriptThread) -> None:
    """Do nothing; see `machine`."""


@declare()
def textmsg(thread: ScriptThread, s1: Any, s2: Any = "") -> None:
    """Send both arguments, converted by `to_str`, as one text."""
    thread.world.text_message(made(thread, to_str(s1) + to_str(s2)))


@declare(takes_time=True)
def popup(
    thread: ScriptThread, s: Any, title: Any = "Popup", warning: Any = False, error: Any = False, blocking: Any = False
) -> Waiting:
    """Show a popup. If it is blocking, wait until it is closed."""
    waits = boolean(blocking, "popup: blocking")
    thread.world.popup(
        made(thread, to_str(s)),
        made(thread, to_str(title)),
        boolean(warning, "popup: warning"),
        boolean(error, "popup: error"),
        waits,
    )
    while waits and thread.world.has_popup:
        yield


@declare(since="3.8/5.0")
def protective_stop(thread: ScriptThread) -> None:
    """Make a protective stop.

    Assumption: if the program has more statements that take time, it is paused until the stop is unlocked.
    """
    thread.world.protective_stop()


@declare(takes_time=True, in_secondary=False, since="3.0")
def jump_to_label(thread: ScriptThread, label: Any) -> Waiting:
    """Continue at the node of the same function with this name, or number (assumed).

    A node is marked by a label such as `$ 3 "home"` before it in the text. The compiler emits an instruction instead,
    so this function is never called.
    """
    yield


# -- interpreter mode --------------------------------------------------------------------------------


@declare(takes_time=True, in_secondary=False, since="5.10")
def interpreter_mode(thread: ScriptThread, clearQueueOnEnter: Any = True, clearOnEnd: Any = True) -> Waiting:
    """Run statements from clients of port 30020.

    The compiler emits instructions instead, so this function is never called.
    """
    yield


@declare(since="5.10")
def end_interpreter(thread: ScriptThread) -> None:
    """Leave interpreter mode after this statement."""
    thread.machine.statements.leave()


@declare(since="5.10")
def clear_interpreter(thread: ScriptThread) -> None:
    """Clear the statements that have begun, which makes room for others."""
    thread.machine.statements.clear()


#: Reason -> functions that are not modelled.
_UNMODELLED = {
    "EtherNet/IP is": ("eip_reader_factory", "eip_writer_factory"),
    "conveyors are": (
        "encoder_enable_pulse_decode",
        "get_conveyor_tick_count",
        "stop_conveyor_tracking",
        "track_conveyor_linear",
    ),
    # It occurs in public programs, but in no manual (cited from memory).
    "its result is unknown, and it is": ("tool_pose",),
}


def _unmodelled(name: str, what: str) -> Callable[..., Any]:
    def stop(thread: ScriptThread, *arguments: Any) -> None:
        raise Fault(f"{name}: {what} not modelled by this simulator")

    return stop


for _what, _names in _UNMODELLED.items():
    for _name in _names:
        declare(name=_name, since="3.0")(_unmodelled(_name, _what))
