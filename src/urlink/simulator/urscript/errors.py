"""Errors of a program, with the texts of a controller.

Texts of real controllers, each seen in a log or a capture:

- `syntax_error_on_line:2:end:` and `compile_error_name_not_found:txtmsg:` with line and column, counted from 1; the
  line number is followed by the whole line, with its indentation;
- `Type error: str_sub takes exact...` (5.x, truncated there), the model of the "Type error: " texts here;
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
    """A compile error or run-time error of a program.

    Attributes:
        line, column: its place, counted from 1.
        text: the controller's text.
    """

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(line, column, text)
        self.line = line
        self.column = column
        self.text = text

    def __str__(self) -> str:
        return f"{self.line}:{self.column}: {self.text}"


class Fault(Exception):
    """A run-time error, which the machine converts to a `ScriptError`.

    Attributes:
        place: character offset in the text; None for that of the instruction.
    """

    def __init__(self, text: str, place: int | None = None) -> None:
        super().__init__(text)
        self.place = place


def type_error(text: str) -> Fault:
    """The fault of a value of the wrong type."""
    return Fault(f"Type error: {text}")


def endless(firmware: Firmware) -> Fault:
    """The fault of a program that loops without time passing."""
    if firmware.is_cb2:
        return Fault("infinite loop detected")
    return Fault(
        "The program used too much time without instructing the robot what to do. Consider using a Wait or sync() to "
        "split long program sequences that do not move the robot."
    )
