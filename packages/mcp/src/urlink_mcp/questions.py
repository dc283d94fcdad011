"""Questions to a person, each of which permits one request: their text, their answers, and their expiry.

Older clients answer a question while the request waits. Clients of protocol 2026-07-28 or later receive the question as
the result of the request, and repeat the request with the answer. The second form could be repeated again. So each
question has an id that only its client receives, and an answer takes the question out of the list.
"""

from __future__ import annotations

import dataclasses
import math
import secrets
from collections.abc import Callable, Mapping
from typing import Any

from linkcore import clock
from urlink import Cancelled, LinkTimeout, LocalError, PendingCall

from .actions import Action
from .request_log import Client

__all__ = ["SCHEMA", "Question", "Questions", "check_answer"]

#: Maximum number of unanswered questions about one robot.
_MOST = 8
#: Form that the client shows to the person. The field has no default, so that a form which is only confirmed, without a
#: choice, is not a consent.
SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "consent": {
            "type": "boolean",
            "title": "Allow this once",
            "description": "Choose true only if you can see the robot, and no person is in its way.",
        }
    },
    "required": ["consent"],
}


@dataclasses.dataclass(frozen=True)
class Question:
    """Question whether a request may be executed.

    Attributes:
        client: Client that asked.
        tool: Name of the tool.
        arguments: Arguments of the tool, as the client sent them.
        action: Checked request.
        call: Call that the request makes. It counts as entered when the client asked, so a later stop cancels it.
        until: Time of `linkcore.clock.now` after which an answer is too late.
        id: Secret of this question.
    """

    client: Client
    tool: str
    arguments: Mapping[str, Any]
    action: Action
    call: PendingCall
    until: float
    id: str = dataclasses.field(default_factory=lambda: secrets.token_urlsafe(16))


class Questions:
    """Unanswered questions about one robot.

    Args:
        time: Seconds for which an answer is valid.
        now: Monotonic clock, in seconds.
    """

    def __init__(self, time: float, now: Callable[[], float] = clock.now) -> None:
        self.time = time
        self.now = now
        self._open: dict[str, Question] = {}

    def add(self, question: Question) -> None:
        """Add a question.

        Raises:
            LocalError: If too many questions are unanswered.
        """
        now = self.now()
        self._open = {each.id: each for each in self._open.values() if each.until >= now}
        if len(self._open) >= _MOST:
            raise LocalError(f"{_MOST} requests wait for the consent of a person; answer one of them first")
        self._open[question.id] = question

    def take(self, id: str, tool: str, arguments: Mapping[str, Any]) -> Question:
        """Remove a question, and return it. Each question permits only one answer.

        Args:
            id: Secret of the question.
            tool, arguments: Request that repeats the first one.

        Raises:
            LocalError: If there is no such question, or the request differs from the one that was asked about.
        """
        question = self._open.pop(id, None)
        if question is None:
            raise LocalError("this question was answered before, has expired, or was abandoned; send the request again")
        if question.tool != tool or question.arguments != arguments:
            raise LocalError(f"the consent was for another request ({question.tool}); send the request again")
        return question

    def check(self, question: Question) -> None:
        """Reject an answer that came too late, or whose request was abandoned.

        Raises:
            Cancelled: If a stop abandoned the request.
            LinkTimeout: If the time for the answer has passed.
        """
        if question.call.is_given_up:
            raise Cancelled("the robot was stopped after this request; nothing was sent")
        late = self.now() - question.until
        if late > 0.0:
            raise LinkTimeout(
                f"the consent came {math.ceil(late)} s too late; it was valid for {self.time:g} s, and nothing was sent"
            )

    def abandon(self, give_up: Callable[[PendingCall], object]) -> None:
        """Abandon all questions. An answer to one of them is refused."""
        for question in self._open.values():
            give_up(question.call)


def check_answer(action: str, content: Mapping[str, Any] | None) -> None:
    """Reject every answer except a consent.

    Args:
        action: What the person did with the question: "accept", "decline" or "cancel".
        content: Values of the form.

    Raises:
        LocalError: If the person did not consent.
    """
    given = None if content is None else content.get("consent")
    if action == "accept" and given is True:
        return
    if action == "accept" and given is not False:
        raise LocalError("the answer contains no consent; expected the field consent with the value true")
    done = "dismissed" if action == "cancel" else "declined"
    raise LocalError(f"the person {done} the question; nothing was sent")
