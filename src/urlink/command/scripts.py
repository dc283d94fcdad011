"""`robot.script`: users' programs and single lines of URScript."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

from linkcore.arguments import check_callable, check_wait
from linkcore.errors import BadValue
from linkcore.handle import Handle, Lifecycle, waited
from linkcore.names import StrictAttributes
from linkcore.pending_call import starts_motion
from linkcore.threads import CallbackThread, Newest

from .channel import CommandChannel
from .programs import Programs

#: Pattern of the name of a URScript file, which is not a program itself.
_FILE = re.compile(r"[^\n()=\"]+\.(script|urscript|urp|txt)")
#: Maximum number of `textmsg` lines kept per program.
_TEXTS = 1000


class Program(Handle):
    """Handle of a program that was sent to the controller; returned by `robot.script.run`."""

    def __init__(self, life: Lifecycle) -> None:
        super().__init__(life)
        # The reader of the primary interface adds lines, and other threads copy the list in one step.
        self._texts: Newest[str] = Newest(_TEXTS)

    @property
    def texts(self) -> tuple[str, ...]:
        """The last thousand lines of the program's `textmsg` calls.

        A controller does not report which program sent a line, so the lines of a `sec` that runs at the same time are
        included.
        """
        return tuple(self._texts.copy())

    def _receiver(self, callbacks: CallbackThread, on_text: Callable[[str], object] | None) -> Callable[[str], object]:
        """Return the function that receives these lines. It refers only to the lines, not to the program."""
        texts = self._texts

        def receive(text: str) -> None:
            texts.add(text)
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
        """Send a program, which preempts the running program. A `sec` runs in addition to the running program instead.

        Args:
            source: URScript text, or the path of a file with it as a `pathlib.Path`. The text is a whole ``def``, a
                ``sec``, or bare statements. If the last top-level item is a ``def``, which must not take arguments,
                it is called after the statements above it. Functions above it must be called from the text. If none
                of them is called, the text is rejected, because only the last function would run.
            wait: Whether to wait until the program has ended: False (not at all), True (up to 60 s), or a number of
                seconds.
            detached: Whether the program keeps running when the robot object is closed or this process ends. By default
                it is stopped then, and the arm brakes, as for a motion.
            on_text: Function called with each line of its `textmsg`, in the robot's thread for callbacks. The last
                lines might therefore arrive after `wait` has returned; `texts` contains them by then. It is not called
                for a `sec`, because a message does not contain its program, and the main program can send lines too.

        Returns:
            Handle of the program. The line numbers in its errors refer to `source`.

        Raises:
            BadValue: If `source` cannot be a program, or the file cannot be read. Nothing is sent.
            LimitExceeded: If the session has limits that do not allow "script.run". Nothing is sent.
            SafetyStop, NotRunning: If the arm may not be moved now. Nothing is sent.
            LinkError: If the program could not be sent, or with `wait`, if it ended with an error.
        """
        seconds = check_wait(wait)
        if on_text is not None:
            check_callable(on_text, "on_text")
        wrapped = self._programs.wrap(_text(source))
        life = self._programs.life(wrapped.name, "script.run")
        program = Program(life)
        receive = program._receiver(self._callbacks, on_text)
        self._programs.start(
            wrapped, life, is_motion=False, is_detached=detached, left_alone="it might still run", on_text=receive
        )
        return waited(program, seconds)

    @starts_motion
    def send_line(self, line: str) -> None:
        """Send one line unchanged, such as ``set speed 0.5``. Its effect is not reported.

        The line is sent through the interlock, like a program, because it might move the arm. It has no start
        permission and no reply. If the controller hangs, this method returns, and the line **might still be executed**
        when the controller resumes.

        Raises:
            BadValue: If `line` is not one line.
            LimitExceeded: If the session has limits that do not allow "script.send_line". Nothing is sent.
            SafetyStop, NotRunning: If the arm may not be moved now. Nothing is sent.
            RemoteError: If the line could not be sent.
        """
        if not isinstance(line, str) or not line.strip():
            raise BadValue(f"{line!r} is not a line of URScript; expected a string that is not blank")
        if not all(character == "\t" or character.isprintable() for character in line):
            raise BadValue(f"{line!r} contains a line break or a control character; expected one line")
        self._programs.allow("script.send_line")
        self._channel.motion(line)

    def __repr__(self) -> str:
        return "<Scripts: run() sends a program, send_line() a line>"


def _text(source: str | os.PathLike[str]) -> str:
    if not isinstance(source, os.PathLike):
        if isinstance(source, str) and _FILE.fullmatch(source.strip()):
            raise BadValue(
                f"{source!r} is a file name, but a string must be the text of a program; pass pathlib.Path({source!r})"
            )
        return source
    path = source
    try:
        return Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise BadValue(f"{path} is not a text file: {error.reason} at byte {error.start}") from None
    except OSError as error:
        raise BadValue(f"cannot read {path}: {error.strerror or error}") from error
