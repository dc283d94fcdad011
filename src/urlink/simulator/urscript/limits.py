"""The limits of a program, beyond which it is stopped. All are guesses, wide enough for the programs in the field.

They bound the work of one controller cycle and the memory of one program, whatever the program is.
"""

from __future__ import annotations

__all__ = [
    "MAX_CALL_DEPTH",
    "MAX_ELEMENTS",
    "MAX_INSTRUCTIONS",
    "MAX_INTEGER",
    "MAX_MEMORY",
    "MAX_NESTING",
    "MAX_PARAMETERS",
    "MAX_STRING",
    "MAX_STRUCTS",
    "MAX_TEXT",
    "MAX_THREADS",
    "MAX_TOKENS",
    "MAX_WORK",
    "MIN_INTEGER",
]

#: characters of a program's text
MAX_TEXT = 262_144
#: of a program; 250 kB of ordinary statements have some 120 000
MAX_TOKENS = 131_072
#: of brackets, blocks and operators in one another
MAX_NESTING = 64
#: of one function; a call looks at each, given or not
MAX_PARAMETERS = 64
#: of one controller cycle, all threads together
MAX_INSTRUCTIONS = 20_000
#: Of one controller cycle, all threads together: elements and characters that are made, parts of long expressions, and
#: what costs as much as them.
MAX_WORK = 200_000
#: calls that have not returned, in one thread
MAX_CALL_DEPTH = 200
#: of one program, living ones and those that ended in this cycle
MAX_THREADS = 100
#: of a list, those of the lists in it included
MAX_ELEMENTS = 10_000
#: of structs in one another
MAX_STRUCTS = 16
#: characters
MAX_STRING = 10_000
#: elements and characters in all variables together
MAX_MEMORY = 2_000_000
#: Integers are those of 32 bits. That a result beyond them is an error, and no float, is a guess.
MIN_INTEGER, MAX_INTEGER = -(2**31), 2**31 - 1
