"""Limits beyond which a program is refused or stopped. All are guesses, wide enough for the programs in the field.

They bound the work of one controller cycle and the memory of any program.
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
