"""Errors of a program, with the texts of a controller, and the limits of a program.

The following texts of real controllers were seen in a log or a capture:

- `syntax_error_on_line:2:end:` and `compile_error_name_not_found:txtmsg:` with line and column, counted from 1. The
  line number is followed by the whole line, with its indentation.
- `Type error: str_sub takes exact...` (5.x, truncated there). The "Type error: " texts here follow this form.
- "The program used too much time without instructing the robot what to do. ..." (3.4) and "infinite loop detected"
  (1.8), for a program that loops without letting time pass.
- "Another thread is already controlling the robot".

All other texts here and in the built-in functions are assumed. The limits are assumed too. They are large enough for
known programs, and bound the work of one controller cycle and the memory of any program.
"""

from __future__ import annotations

from ...protocol.firmware import Firmware


class ProgramError(Exception):
    """A compile error or run-time error of a program.

    Attributes:
        line, column: Place of the error, counted from 1.
        text: Text of the controller.
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
        place: Character offset in the text; None for the place of the instruction.
    """

    def __init__(self, text: str, place: int | None = None) -> None:
        super().__init__(text)
        self.place = place


def type_error(text: str) -> Fault:
    """Return the fault of a value with the wrong type."""
    return Fault(f"Type error: {text}")


def endless(firmware: Firmware) -> Fault:
    """Return the fault of a program that loops without letting time pass."""
    if firmware.is_cb2:
        return Fault("infinite loop detected")
    return Fault(
        "The program used too much time without instructing the robot what to do. Consider using a Wait or sync() to "
        "split long program sequences that do not move the robot."
    )


#: Maximum number of characters in a program.
MAX_TEXT = 262_144
#: Maximum number of tokens in a program. 250 kB of ordinary statements have about 120 000.
MAX_TOKENS = 131_072
#: Maximum nesting depth of brackets, blocks and operators.
MAX_NESTING = 64
#: Maximum number of parameters of a function. A call handles each parameter, whether it is given or not.
MAX_PARAMETERS = 64
#: Maximum number of instructions in one controller cycle. All threads share them evenly.
MAX_INSTRUCTIONS = 20_000
#: Maximum work of all threads in one controller cycle: elements and characters made, parts of long expressions, and the
#: equivalent of other costly operations.
MAX_WORK = 200_000
#: Maximum call depth of one thread.
MAX_CALL_DEPTH = 200
#: Maximum number of threads of one program, including those that ended in this cycle.
MAX_THREADS = 100
#: Maximum number of elements in a list, including inner lists.
MAX_ELEMENTS = 10_000
#: Maximum nesting depth of structs.
MAX_STRUCTS = 16
#: Maximum number of characters in a string.
MAX_STRING = 10_000
#: Maximum number of elements and characters in all variables together.
MAX_MEMORY = 2_000_000
#: Integers have 32 bits. It is assumed that a larger result is an error rather than a float.
MIN_INTEGER, MAX_INTEGER = -(2**31), 2**31 - 1
