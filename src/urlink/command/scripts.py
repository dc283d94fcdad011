"""`robot.script`: programs and lines of URScript, as users send them."""

from __future__ import annotations

import os
import re
from collections import deque
from collections.abc import Callable
from pathlib import Path

from linkcore.arguments import check_callable, check_wait
from linkcore.errors import BadValue
from linkcore.handle import Handle, Lifecycle, waited
from linkcore.names import StrictAttributes
from linkcore.pending_call import starts_motion
from linkcore.threads import CallbackThread

from .channel import CommandChannel
from .programs import Programs

#: The name of a file of URScript, which is not a program.
_FILE = re.compile(r"[^\n()=\"]+\.(script|urscript|urp|txt)")
#: Lines of `textmsg` that are kept of a program.
_TEXTS = 1000


class Program(Handle):
    """A program that was sent to the controller; made by `robot.script.run`."""

    def __init__(self, life: Lifecycle) -> None:
        super().__init__(life)
        self._texts: deque[str] = deque(maxlen=_TEXTS)

    @property
    def texts(self) -> tuple[str, ...]:
        """The lines that its `textmsg` sent, the last thousand.

        A controller does not say which program a line is from: those of a `sec` that runs beside are here too.
        """
        return tuple(self._texts.copy())  # in one step: another thread may be adding

    def _receiver(self, callbacks: CallbackThread, on_text: Callable[[str], object] | None) -> Callable[[str], object]:
        """What receives these lines; it refers to no more of the program than them."""
        texts = self._texts

        def receive(text: str) -> None:
            texts.append(text)
            if on_text is not None:
                callbacks.call(on_text, text)

        return receive


class Scripts(StrictAttributes):
    """Sends URScript."""

    def __init__(self, programs: Programs, channel: CommandChannel, callbacks: CallbackThread) -> None:
        self._programs = programs
        self._channel = channel
        self._callbacks = callbacks

    @starts_motion
    def run(
        self,
        source: str | os.PathLike[str],
        *,
        wait: bool | float = False,
        detached: bool = False,
        on_text: Callable[[str], object] | None = None,
    ) -> Program:
        """Send a program; it preempts the one that runs, unless it is a `sec`, which runs beside it.

        Args:
            source: URScript as a string, or the path of a file with it as a `pathlib.Path`: a whole ``def``, a ``sec``,
                or bare statements. Where the last thing at the top is a ``def``, which may take no arguments, it is
                called after what stands above it. Functions above it are for it to call: if none of them is called, the
                text is rejected, since only the last would run.
            wait: until it is over: False not at all, True for up to 60 s, a number for so many seconds.
            detached: Whether the program keeps running when the robot object is closed or this process ends. By default
                it is stopped then, and the arm brakes, as a motion does.
            on_text: called with each line of its `textmsg`, in the robot's thread for callbacks, so for the last lines
                perhaps after `wait` has returned; `texts` has them by then. Not for a `sec`: a message does not say
                which program it is of, and the program beside which it runs may say something too.

        Returns:
            the handle. Lines in its errors are those of `source`.

        Raises:
            BadValue: it cannot be a program, or the file cannot be read: nothing was sent.
            SafetyStop, NotRunning: the arm may not be moved now: nothing was sent.
            LinkError: it could not be sent; with `wait`, also what ended it.
        """
        seconds = check_wait(wait)
        if on_text is not None:
            check_callable(on_text, "on_text")
        wrapped = self._programs.wrap(_text(source))
        life = self._programs.life(wrapped.name)
        program = Program(life)
        receive = program._receiver(self._callbacks, on_text)
        self._programs.start(
            wrapped, life, is_motion=False, is_detached=detached, left_alone="it may still run", on_text=receive
        )
        return waited(program, seconds)

    @starts_motion
    def send_line(self, line: str) -> None:
        """Send one line as it is, such as ``set speed 0.5``; what the controller makes of it is not reported.

        It goes through the interlock as programs do, since it may move the arm. It asks nobody before it does, and has
        no answer: where the controller hangs, this returns, and the line **may still be carried out** when it goes on.

        Raises:
            BadValue: it is not one line.
            SafetyStop, NotRunning: the arm may not be moved now: nothing was sent.
            RemoteError: it could not be sent.
        """
        if not isinstance(line, str) or not line.strip():
            raise BadValue(f"{line!r} is no line of URScript")
        if not all(character == "\t" or character.isprintable() for character in line):
            raise BadValue(f"{line!r} holds a line break or a control character; expected one line")
        self._channel.motion(line)

    def __repr__(self) -> str:
        return "<Scripts: run() sends a program, send_line() a line>"


def _text(source: str | os.PathLike[str]) -> str:
    if not isinstance(source, os.PathLike):
        if isinstance(source, str) and _FILE.fullmatch(source.strip()):
            raise BadValue(
                f"{source!r} is the name of a file, and a string is the text of a program; "
                f"pass pathlib.Path({source!r})"
            )
        return source
    path = source
    try:
        return Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise BadValue(f"{path} is no text: {error.reason} at byte {error.start}") from None
    except OSError as error:
        raise BadValue(f"cannot read {path}: {error.strerror or error}") from error
