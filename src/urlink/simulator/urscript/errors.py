"""Errors of programs, with the messages of a real controller, and limits of programs.

The following messages of real controllers are known from logs or captures:

- `syntax_error_on_line:2:end:` and `compile_error_name_not_found:txtmsg:`. They contain line and column, counted from
  1. After the line number, the first message contains the whole line with its indentation.
- `Type error: str_sub takes exact...` (5.x; the log truncates it). The simulator's messages that begin with "Type
  error: " have this form.
- "The program used too much time without instructing the robot what to do. ..." (3.4) and "infinite loop detected"
  (1.8), for a program that loops without letting time pass.
- "Another thread is already controlling the robot".

All other messages, here and in the built-in functions, are assumed. The limits are assumed too. They are large enough
for known programs, and they limit the work in one controller cycle and the memory of any program.
"""

from __future__ import annotations

from ...protocol.firmware import Firmware


class ProgramError(Exception):
    """Compile error or run-time error of a program.

    Attributes:
        line, column: Line and column of the error, counted from 1.
        text: Message of the controller.
    """

    def __init__(self, line: int, column: int, text: str) -> None:
        super().__init__(line, column, text)
        self.line = line
        self.column = column
        self.text = text

    def __str__(self) -> str:
        return f"{self.line}:{self.column}: {self.text}"


class Fault(Exception):
    """Run-time error, which the machine converts to a `ProgramError`.

    Attributes:
        place: Character offset in the text of the program; None selects the offset of the instruction that raises the
            fault.
    """

    def __init__(self, text: str, place: int | None = None) -> None:
        super().__init__(text)
        self.place = place


def type_error(text: str) -> Fault:
    """Return the fault for a value with a wrong type."""
    return Fault(f"Type error: {text}")


def endless(firmware: Firmware) -> Fault:
    """Return the fault for a program that loops without letting time pass."""
    if firmware.is_cb2:
        return Fault("infinite loop detected")
    return Fault(
        "The program used too much time without instructing the robot what to do. Consider using a Wait or sync() to "
        "split long program sequences that do not move the robot."
    )


#: Maximum number of characters in a program.
MAX_TEXT = 262_144
#: Maximum number of tokens in a program. Ordinary statements with a length of 250 kB have about 120,000 tokens.
MAX_TOKENS = 131_072
#: Maximum nesting depth of brackets, blocks and operators.
MAX_NESTING = 64
#: Maximum number of parameters of a function. The limit is needed because a call processes each parameter, even if it
#: is not given.
MAX_PARAMETERS = 64
#: Maximum number of instructions that a program executes in one controller cycle. Each thread gets the same share of
#: this number.
MAX_INSTRUCTIONS = 20_000
#: Maximum work of all threads in one controller cycle. Each new element or character, and each part of a long
#: expression, counts as 1. Other costly operations count as a fixed number.
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
#: Limits of integers, which have 32 bits. It is assumed that a larger result is an error and does not become a float.
MIN_INTEGER, MAX_INTEGER = -(2**31), 2**31 - 1
