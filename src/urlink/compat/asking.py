"""Questions to the controller: a value of a URScript expression, by a program that runs beside the one that moves."""

from __future__ import annotations

import itertools
from queue import Empty, SimpleQueue

import urlink
from linkcore.errors import LinkTimeout

__all__ = ["ask"]

#: Seconds that an answer may take.
_TIMEOUT = 5.0

_numbers = itertools.count(1)


def ask(robot: urlink.Robot, expression: str) -> str:
    """What the controller makes of an expression, as text.

    Raises:
        SafetyStop, NotRunning: it takes no programs now.
        CompileError: it does not know a function.
        LinkTimeout: it does not answer.
    """
    mark = f"urlink answer {next(_numbers)} "
    answers: SimpleQueue[str] = SimpleQueue()

    def hear(message: urlink.TextMessage) -> None:
        if message.text.startswith(mark):
            answers.put(message.text[len(mark) :])

    # Of the stream and not of the program: lines do not say which program they are from.
    with robot.primary.subscribe(hear, urlink.TextMessage, inline=True):
        robot.script.run(f'sec urlink_question():\n  textmsg("{mark}", {expression})\nend')
        try:
            return answers.get(timeout=_TIMEOUT)
        except Empty:
            raise LinkTimeout(f"no answer to {expression} within {_TIMEOUT:g} s") from None
