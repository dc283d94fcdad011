"""The clock of a simulated controller whose time passes only by calls, while its ports are served."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

from linkcore.arguments import check_seconds
from linkcore.errors import LinkTimeout
from linkcore.threads import started

__all__ = ["SteppedClock", "passing"]

#: Seconds of robot time that `passing` advances at once: some packets, then what clients have sent is read.
_SLICE = 0.01


class SteppedClock:
    """Seconds that stand still until `advance`.

    Args:
        rate: cycles a second of the controller.
    """

    def __init__(self, rate: int) -> None:
        self._rate = rate
        self._cycles = 0

    def __call__(self) -> float:
        # In the middle of a cycle, so that rounding never counts one too few.
        return (self._cycles + 0.5) / self._rate if self._cycles else 0.0

    def advance(self, cycles: int) -> None:
        """Advance by this many cycles."""
        self._cycles += cycles


@contextlib.contextmanager
def passing(step: Callable[[int], object], rate: int, speed: float) -> Iterator[None]:
    """Let time pass, in a thread, until the block is left.

    Args:
        step: advances by a number of cycles.
        rate: cycles a second.
        speed: factor of real time; less if the machine is too slow.
    """
    speed = check_seconds(speed, "speed", positive=True, finite=True)
    over = threading.Event()
    cycles = max(round(_SLICE * rate), 1)

    def run() -> None:
        due = time.monotonic()
        while not over.wait(max(due - time.monotonic(), 0.0)):
            # The thread that serves may get no processor time for seconds: time stands still then, and goes on.
            with contextlib.suppress(LinkTimeout):
                step(cycles)
            due = max(due + cycles / rate / speed, time.monotonic() - 1.0)

    thread = started(threading.Thread(target=run, name="urlink sim time", daemon=True))
    try:
        yield
    finally:
        over.set()
        thread.join()
