"""Errors of a program, with the texts of a controller, and the limits beyond which it is refused or stopped.

Texts of real controllers, each seen in a log or a capture:

- `syntax_error_on_line:2:end:` and `compile_error_name_not_found:txtmsg:` with line and column, counted from 1; the
  line number is followed by the whole line, with its indentation;
- `Type error: str_sub takes exact...` (5.x, truncated there), the model of the "Type error: " texts here;
- "The program used too much time without instructing the robot what to do. ..." (3.4) and "infinite loop detected"
  (1.8) for a program that loops without time passing;
- "Another thread is already controlling the robot";

Every other text here and in the built-in functions is a guess. So are the limits, which are wide enough for the
programs in the field: they bound the work of one controller cycle and the memory of any program.
"""

from __future__ import annotations

from ...protocol.firmware import Firmware


class ProgramError(Exception):
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
    """A run-time error, which the machine converts to a `ProgramError`.

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


#: characters of a program's text
MAX_TEXT = 262_144
#: tokens of a program; 250 kB of ordinary statements have about 120 000
MAX_TOKENS = 131_072
#: nesting depth of brackets, blocks and operators
MAX_NESTING = 64
#: parameters of one function; a call handles each, given or not
MAX_PARAMETERS = 64
#: instructions of one controller cycle, all threads together, which share them evenly
MAX_INSTRUCTIONS = 20_000
#: work of one controller cycle, all threads together: elements and characters made, parts of long expressions, and
#: the equivalent of other costly operations
MAX_WORK = 200_000
#: call depth of one thread
MAX_CALL_DEPTH = 200
#: threads of one program, those that ended in this cycle included
MAX_THREADS = 100
#: elements of a list, those of inner lists included
MAX_ELEMENTS = 10_000
#: nesting depth of structs
MAX_STRUCTS = 16
#: characters of a string
MAX_STRING = 10_000
#: elements and characters in all variables together
MAX_MEMORY = 2_000_000
#: Integers have 32 bits. That a result beyond them is an error rather than a float is a guess.
MIN_INTEGER, MAX_INTEGER = -(2**31), 2**31 - 1
