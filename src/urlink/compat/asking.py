"""The value of a URScript expression, from a program that runs beside the one that moves the arm."""

from __future__ import annotations

import itertools
from queue import Empty, SimpleQueue

import urlink
from linkcore.errors import LinkTimeout

__all__ = ["ask"]

#: Seconds to wait for an answer.
_TIMEOUT = 5.0

_numbers = itertools.count(1)


def ask(robot: urlink.Robot, expression: str) -> str:
    """The value of an expression, as text that the controller makes of it.

    Raises:
        SafetyStop, NotRunning: the controller accepts no programs now.
        CompileError: a function does not exist on this controller.
        LinkTimeout: no answer within 5 s.
    """
    mark = f"urlink answer {next(_numbers)} "
    answers: SimpleQueue[str] = SimpleQueue()

    def hear(message: urlink.packets.TextMessage) -> None:
        if message.text.startswith(mark):
            answers.put(message.text[len(mark) :])

    # Subscribed to the stream and not to the program: a line of text does not say which program sent it.
    with robot.primary.subscribe(hear, urlink.packets.TextMessage, inline=True):
        robot.script.run(f'sec urlink_question():\n  textmsg("{mark}", {expression})\nend')
        try:
            return answers.get(timeout=_TIMEOUT)
        except Empty:
            raise LinkTimeout(f"no answer to {expression} within {_TIMEOUT:g} s") from None
