"""Functions for time, critical sections, messages and program flow, and names of functions that are not modelled.

A program that calls a function which is not modelled compiles, but the call is a run-time error. When a function is
modelled later, it moves to the module of its family. For functions that are not modelled, the firmware is not checked,
except that CB2 has none of them.
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
    """Wait `t` seconds. The time is rounded up to whole cycles, and is at least one cycle (assumed)."""
    seconds = number(t, "sleep: t")
    if seconds < 0:
        raise Fault("sleep: t must not be negative")
    # Subtract a millionth of a cycle, so that a rounding error does not add a cycle.
    cycles = seconds / thread.world.period - 1e-6
    waited = 0
    while True:
        yield
        waited += 1
        if waited >= cycles:
            return


@declare("exit_critical")
def enter_critical(thread: ScriptThread) -> None:
    """Do nothing; the module `machine` explains why critical sections need no code."""


@declare()
def textmsg(thread: ScriptThread, s1: Any, s2: Any = "") -> None:
    """Convert both arguments with `to_str`, and send them as one text message."""
    thread.world.text_message(made(thread, to_str(s1) + to_str(s2)))


@declare(takes_time=True)
def popup(
    thread: ScriptThread, s: Any, title: Any = "Popup", warning: Any = False, error: Any = False, blocking: Any = False
) -> Waiting:
    """Show a popup on the pendant. If the popup is blocking, wait until it is closed."""
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

    Assumption: if the program continues with statements that take time, it is paused until the stop is unlocked.
    """
    thread.world.protective_stop()


@declare(takes_time=True, in_secondary=False, since="3.0")
def jump_to_label(thread: ScriptThread, label: Any) -> Waiting:
    """Continue at the node of the same function that has this name, or this number (assumed).

    In the text of the program, a label such as `$ 3 "home"` is before each node. The compiler emits an instruction for
    this function, so the Python function is never called.
    """
    yield


# -- interpreter mode --------------------------------------------------------------------------------


@declare(takes_time=True, in_secondary=False, since="5.10")
def interpreter_mode(thread: ScriptThread, clearQueueOnEnter: Any = True, clearOnEnd: Any = True) -> Waiting:
    """Run statements that clients send to port 30020.

    The compiler emits instructions for this function, so the Python function is never called.
    """
    yield


@declare(since="5.10")
def end_interpreter(thread: ScriptThread) -> None:
    """End interpreter mode after this statement."""
    thread.machine.statements.leave()


@declare(since="5.10")
def clear_interpreter(thread: ScriptThread) -> None:
    """Clear the statements that have begun, so that the queue has room for other statements."""
    thread.machine.statements.clear()


#: Reason, as a part of the error message -> functions that are not modelled for this reason.
_UNMODELLED = {
    "EtherNet/IP is": ("eip_reader_factory", "eip_writer_factory"),
    "conveyors are": (
        "encoder_enable_pulse_decode",
        "get_conveyor_tick_count",
        "stop_conveyor_tracking",
        "track_conveyor_linear",
    ),
    # Public programs call this function, but no manual (cited from memory) contains it.
    "its result is unknown, and it is": ("tool_pose",),
}


def _unmodelled(name: str, what: str) -> Callable[..., Any]:
    def stop(thread: ScriptThread, *arguments: Any) -> None:
        raise Fault(f"{name}: {what} not modelled by this simulator")

    return stop


for _what, _names in _UNMODELLED.items():
    for _name in _names:
        declare(name=_name, since="3.0")(_unmodelled(_name, _what))
