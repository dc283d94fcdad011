"""The errors of a program, in the words of a controller.

Words of real controllers, each seen in a log or a capture:

- `syntax_error_on_line:2:end:` and `compile_error_name_not_found:txtmsg:` with line and column from 1 on; what stands
  after the line's number is the whole line, with its indentation;
- `Type error: str_sub takes exact...` (5.x, cut short there), which gave "Type error: " its form here;
- "The program used too much time without instructing the robot what to do. ..." (3.4) and "infinite loop detected"
  (1.8) for a program that loops without time passing;
- "Another thread is already controlling the robot";

Every other text here and in the built-in functions is a guess.
"""

from __future__ import annotations

from urlink.firmware import Firmware

__all__ = ["ANOTHER_THREAD", "Fault", "ScriptError", "endless", "type_error"]

ANOTHER_THREAD = "Another thread is already controlling the robot"


class ScriptError(Exception):
    """An error of compiling or of running a program.

    Attributes:
        line, column: where, counted from 1.
        text: what a controller says of it.
    """

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(line, column, text)
        self.line = line
        self.column = column
        self.text = text

    def __str__(self) -> str:
        return f"{self.line}:{self.column}: {self.text}"


class Fault(Exception):
    """A run-time error, of which the machine makes a `ScriptError`.

    Attributes:
        place: where in the text it happened, if that is known better than by the instruction.
    """

    def __init__(self, text: str, place: int | None = None) -> None:
        super().__init__(text)
        self.place = place


def type_error(text: str) -> Fault:
    """A value of a type that does not fit."""
    return Fault(f"Type error: {text}")


def endless(firmware: Firmware) -> Fault:
    """The program goes on and on, and no time passes."""
    if firmware.is_cb2:
        return Fault("infinite loop detected")
    return Fault(
        "The program used too much time without instructing the robot what to do. Consider using a Wait or sync() to "
        "split long program sequences that do not move the robot."
    )
