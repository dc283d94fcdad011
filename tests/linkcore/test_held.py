"""A lock that is held for a block is free afterwards, even if Ctrl-C interrupts the block at any moment."""

from __future__ import annotations

import dis
import itertools
import sys
import threading
from collections.abc import Callable
from types import BuiltinFunctionType, FrameType, MethodDescriptorType
from typing import Any

import pytest

from linkcore.errors import LinkTimeout
from linkcore.threads import acquired, held
from urlink.command.section import Section


class Interrupter:
    """Trace function that raises KeyboardInterrupt at the n-th check for signals in a function.

    The interpreter checks for signals after a call, and when a function or a generator starts or continues.
    """

    def __init__(self, code: Any, at: int) -> None:
        self._code = code
        self._left = at
        instructions = list(dis.get_instructions(code))
        looks = ("CALL", "RESUME", "JUMP_BACKWARD", "GEN_START", "YIELD")
        self._moments = {
            after.offset for before, after in itertools.pairwise(instructions) if before.opname.startswith(looks)
        }
        self.has_raised = False

    def trace(self, frame: FrameType, event: str, argument: object) -> Callable[..., Any] | None:
        if frame.f_code is not self._code:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode" and frame.f_lasti in self._moments:
            self._left -= 1
            if self._left < 0 and not self.has_raised:
                self.has_raised = True
                raise KeyboardInterrupt
        return self.trace


def use(lock: threading.Lock) -> None:
    with acquired(lock, 1.0) as is_held:
        assert is_held


def interrupted_at(at: int, lock: threading.Lock) -> bool:
    """Whether the function has so many checks for signals, and was interrupted at this one."""
    interrupter = Interrupter(acquired.__wrapped__.__code__, at)  # type: ignore[attr-defined]
    before = sys.gettrace()
    sys.settrace(interrupter.trace)
    try:
        use(lock)
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(before)
    return interrupter.has_raised


def test_lock_is_free_after_an_interrupt_at_any_moment() -> None:
    at, lock = 0, threading.Lock()
    while interrupted_at(at, lock):
        assert lock.acquire(blocking=False), f"held after an interrupt at moment {at}"
        lock.release()
        at += 1
    assert at > 2


def test_held_raises_when_another_thread_keeps_the_lock() -> None:
    lock = threading.Lock()
    with held(lock, 1.0, "first"), pytest.raises(LinkTimeout, match="kept"), held(lock, 0.0, "kept"):
        pass
    assert lock.acquire(blocking=False)


@pytest.mark.simulated_time
def test_acquired_yields_true_only_if_the_lock_was_acquired() -> None:
    lock = threading.Lock()
    with acquired(lock, 3.5) as first, acquired(lock, 3.5) as second:
        assert (first, second) == (True, False)
    lock.acquire()
    threading.Timer(2.5, lock.release).start()
    with acquired(lock, 3.5) as later:
        assert later
    assert not lock.locked()


def test_section_lock_enter_is_implemented_in_c() -> None:
    """With an `__enter__` in Python, Ctrl-C could come between the acquisition and the block."""
    lock = Section().lock
    assert isinstance(type(lock).__enter__, MethodDescriptorType | BuiltinFunctionType)
    assert not hasattr(Section, "__enter__")
