"""Console input with a timeout: lines of stdin and single keys of a terminal, on POSIX systems and on Windows.

On Windows, `select` accepts sockets only. There, a thread reads the lines of stdin, and `msvcrt` reads the keys.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
from collections.abc import Callable, Iterator
from queue import Empty, SimpleQueue

from .. import clock
from ..errors import LocalError
from ..threads import started

#: Time in s between two checks for a key on Windows, because no call there waits for a key with a timeout.
_POLL = 0.01

#: Function that reads bytes. It returns None if none arrive within the given seconds, and b"" at the end of the input.
Reader = Callable[[float], "bytes | None"]


def read_stdin(timeout: float) -> bytes | None:
    """Read the next bytes of stdin.

    Return None if none arrive within `timeout` seconds, and b"" at the end of stdin.

    Raises:
        LocalError: If this system cannot wait for stdin with a timeout.
    """
    if sys.platform == "win32":
        try:
            return clock.get(_chunks(), timeout)
        except Empty:
            return None
    else:
        try:
            is_ready = bool(select.select([sys.stdin], [], [], timeout)[0])
        except (OSError, ValueError) as error:
            raise LocalError(f"cannot wait for stdin: {error}") from None
        return os.read(sys.stdin.fileno(), 1024) if is_ready else None


def lines(is_wanted: Callable[[], bool], pause: float = 0.05) -> Iterator[str | None]:
    """Yield the lines of stdin without line ends, until stdin ends.

    Args:
        is_wanted: Function that returns False to end the iteration. It is called before each line and each pause.
        pause: Time in s without input after which None is yielded.

    Raises:
        LocalError: If this system cannot wait for stdin with a timeout.
    """
    rest = b""
    while is_wanted():
        read = read_stdin(pause)
        if read is None:
            yield None
            continue
        *whole, rest = (rest + read).split(b"\n")
        for line in whole:
            yield line.decode(errors="replace").strip()
        if not read:
            return


@contextlib.contextmanager
def keys() -> Iterator[Reader]:
    """Set the terminal to send single keys without showing them; restore it afterwards.

    The block gets a function that reads the pressed keys.

    Raises:
        LocalError: If stdin is not a terminal, or if this system cannot read single keys.
    """
    if not sys.stdin.isatty():
        raise LocalError("stdin is not a terminal; keys can only be read from a terminal")
    if sys.platform == "win32":
        yield _pressed
    else:
        try:
            import termios
            import tty
        except ImportError:
            raise LocalError("this system cannot read single keys from a terminal (no termios)") from None
        terminal = sys.stdin.fileno()
        before = termios.tcgetattr(terminal)
        tty.setcbreak(terminal)
        try:
            yield read_stdin
        finally:
            termios.tcsetattr(terminal, termios.TCSADRAIN, before)


if sys.platform == "win32":
    import functools
    import msvcrt

    def _pressed(timeout: float) -> bytes | None:
        until = clock.now() + timeout
        while not msvcrt.kbhit():
            if clock.now() >= until:
                return None
            clock.sleep(_POLL)
        key = msvcrt.getch()
        if key in (b"\x00", b"\xe0"):  # an arrow or a function key, whose code follows
            msvcrt.getch()
            return None
        return key

    @functools.cache
    def _chunks() -> SimpleQueue[bytes]:
        """Start a thread that reads stdin, and return the queue of the bytes; b"" marks the end of stdin."""
        chunks: SimpleQueue[bytes] = SimpleQueue()
        try:
            number = sys.stdin.fileno()
        except (OSError, ValueError) as error:
            raise LocalError(f"cannot wait for stdin: {error}") from None

        def read() -> None:
            # Do not use `sys.stdin.buffer`, because this thread would hold its lock when the interpreter exits.
            while chunk := _read(number):
                chunks.put(chunk)
            chunks.put(b"")

        started(threading.Thread(target=read, name="linkcore stdin", daemon=True))
        return chunks

    def _read(number: int) -> bytes:
        try:
            return os.read(number, 1024)
        except OSError:  # stdin was closed
            return b""
