"""How a built-in function is declared: a Python function of the calling thread and of the parameters.

Its parameters' names and defaults are those of the URScript function. One that takes time is a generator that yields
once for every cycle that it waits.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from linkcore.wire.version import Since
from urlink.firmware import Firmware

__all__ = ["REQUIRED", "Builtin", "Family"]

F = TypeVar("F", bound=Callable[..., Any])

#: In place of a default value.
REQUIRED = inspect.Parameter.empty


@dataclass(frozen=True, eq=False)
class Builtin:
    """A built-in function.

    Attributes:
        name: in a program.
        function: called with the thread and every parameter, by position.
        parameters: names and default values.
        takes_time: it is a generator.
        in_secondary: a `sec` program may call it.
        is_variadic: takes any arguments, named or not.
        since: the first firmware of each generation that has it.
        until: the first firmware that has it no longer, or otherwise.
    """

    name: str
    function: Callable[..., Any]
    parameters: tuple[tuple[str, Any], ...]
    takes_time: bool
    in_secondary: bool
    is_variadic: bool
    since: Since
    until: Since | None

    def is_in(self, firmware: Firmware) -> bool:
        """That firmware has it."""
        return firmware in self.since and (self.until is None or firmware not in self.until)


class Family:
    """A table of functions that belong together."""

    def __init__(self) -> None:
        self.functions: dict[str, list[Builtin]] = {}

    def declare(
        self,
        *aliases: str,
        name: str | None = None,
        takes_time: bool = False,
        in_secondary: bool = True,
        since: str = "1.0",
        until: str | None = None,
    ) -> Callable[[F], F]:
        """Enter a function into the table, under its own name or `name`, and under other names too."""

        def enter(function: F) -> F:
            signature = list(inspect.signature(function).parameters.values())[1:]
            for known in (name or function.__name__, *aliases):
                builtin = Builtin(
                    known,
                    function,
                    tuple((p.name, p.default) for p in signature if p.kind is p.POSITIONAL_OR_KEYWORD),
                    takes_time,
                    in_secondary,
                    any(p.kind is p.VAR_POSITIONAL for p in signature),
                    Since(since),
                    Since(until) if until else None,
                )
                self.functions.setdefault(known, []).append(builtin)
            return function

        return enter
