"""The programs that clients have sent, begun in the order in which they came.

Short ones are compiled at once. Long ones take up to seconds, for which the clock would stand still, so they are
compiled in a thread beside it, one after the other, and what comes after one waits for it.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from .urscript import Script, ScriptError, compile_script

if TYPE_CHECKING:
    from urlink.firmware import Firmware

    from .controller import Controller

__all__ = ["Intake"]

#: Characters from which on a program is a long one.
LONG = 1 << 13
#: Characters that may wait.
MOST_WAITING = 1 << 20
#: Seconds that the end of a compilation is waited for; the longest program takes two or three.
PATIENCE = 4.0


class _Compilation(threading.Thread):
    """One long program, being compiled.

    Attributes:
        result: what came of it; None until it is over.
    """

    def __init__(self, text: str, firmware: Firmware, wake: Callable[[], object]) -> None:
        super().__init__(name="urlink sim compiling", daemon=True)
        self.text = text
        self.result: Script | ScriptError | None = None
        self._firmware = firmware
        self._wake = wake

    def run(self) -> None:
        try:
            self.result = compile_script(self.text, self._firmware)
        except ScriptError as error:
            self.result = error
        self._wake()


class Intake:
    """What clients of one controller have sent; all but the compiling is done in the thread that owns the controller.

    Args:
        controller: to run the programs.
        wake: called from another thread when `advance` has something to do.
    """

    def __init__(self, controller: Controller, wake: Callable[[], object]) -> None:
        self._controller = controller
        self._wake = wake
        self._waiting: deque[str] = deque()
        self._compilation: _Compilation | None = None

    def put(self, text: str) -> bool:
        """A whole program, or a line. False if so much waits that it is thrown away."""
        if sum(map(len, self._waiting)) + len(text) > MOST_WAITING:
            return False
        self._waiting.append(text)
        self._go_on()
        return True

    def advance(self) -> None:
        """Begin what has been compiled."""
        compilation = self._compilation
        if compilation is not None and compilation.result is not None:
            self._compilation = None
            self._controller.programs.take(compilation.text, compilation.result)
            self._go_on()

    def clear(self) -> None:
        """Forget all of it: the controller goes down."""
        self._waiting.clear()
        self._compilation = None

    def close(self) -> None:
        """Forget all of it, and wait for the thread."""
        compilation = self._compilation
        self.clear()
        if compilation is not None:
            compilation.join(PATIENCE)

    def _go_on(self) -> None:
        while self._waiting and self._compilation is None:
            text = self._waiting.popleft()
            if len(text) < LONG:
                self._controller.programs.take(text)
            else:
                self._compilation = _Compilation(text, self._controller.firmware, self._wake)
                self._compilation.start()
