"""Questions to a person: which answers are a consent, and for how long."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

import urlink
from tests.fakes.clock import Clock
from urlink_mcp.actions import Action
from urlink_mcp.questions import SCHEMA, Question, Questions, check_answer
from urlink_mcp.request_log import Client

CLIENT = Client("tester", "1", "stdio")
ACTION = Action("The arm will move.", lambda: None, True, np.zeros(6), np.zeros(6))
TIME = 30.0


def question(until: float, arguments: dict[str, Any] | None = None) -> Question:
    return Question(CLIENT, "move_joints", arguments or {}, ACTION, urlink.PendingCall(), until)


json = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
)


@pytest.mark.property
@given(
    action=st.sampled_from(["accept", "decline", "cancel"]) | st.text(max_size=8),
    content=st.none() | st.dictionaries(st.sampled_from(["consent", "Consent", "allow"]), json, max_size=3),
)
def test_check_answer_accepts_only_consent(action: str, content: dict[str, Any] | None) -> None:
    is_consent = action == "accept" and content is not None and content.get("consent") is True
    if is_consent:
        check_answer(action, content)
    else:
        with pytest.raises(urlink.LocalError, match=r"declined|dismissed|contains no consent"):
            check_answer(action, content)


def test_form_has_no_default_consent() -> None:
    assert SCHEMA["required"] == ["consent"]
    assert "default" not in SCHEMA["properties"]["consent"]


def test_check_rejects_late_answer() -> None:
    clock = Clock()
    questions = Questions(TIME, clock)
    asked = question(clock.now + TIME)
    questions.add(asked)
    clock.now += TIME
    questions.check(asked)
    clock.now += 0.5
    with pytest.raises(urlink.LinkTimeout, match=r"the consent came 1 s too late; it was valid for 30 s"):
        questions.check(asked)


def test_check_rejects_answer_after_stop() -> None:
    questions = Questions(TIME, Clock())
    asked = question(1000.0)
    questions.add(asked)
    questions.abandon(lambda call: call.give_up())
    with pytest.raises(urlink.Cancelled, match="was stopped after this request"):
        questions.check(questions.take(asked.id, "move_joints", {}))


def test_ids_of_questions_are_not_predictable() -> None:
    ids = {question(0.0).id for _ in range(100)}
    assert len(ids) == 100
    assert min(map(len, ids)) >= 20


class QuestionsMachine(RuleBasedStateMachine):
    """Any order of questions, answers and times: each question is answered at most once, and only by its request."""

    @initialize()
    def start(self) -> None:
        self.clock = Clock()
        self.questions = Questions(TIME, self.clock)
        self.open: list[Question] = []
        self.used: list[Question] = []

    def is_valid(self, each: Question) -> bool:
        return each.until >= self.clock.now

    @rule(arguments=st.dictionaries(st.sampled_from("ab"), st.integers(0, 2), max_size=2))
    def add(self, arguments: dict[str, Any]) -> None:
        asked = question(self.clock.now + TIME, arguments)
        valid = [each for each in self.open if self.is_valid(each)]
        if len(valid) < 8:
            self.questions.add(asked)
            self.open = [*valid, asked]
        else:
            with pytest.raises(urlink.LocalError, match="8 requests wait for the consent of a person"):
                self.questions.add(asked)
            self.open = valid

    @rule(seconds=st.floats(0.0, 40.0))
    def wait(self, seconds: float) -> None:
        self.clock.now += seconds

    @rule(data=st.data(), is_same=st.booleans())
    def answer(self, data: st.DataObject, is_same: bool) -> None:
        if not self.open:
            return
        asked = self.open.pop(data.draw(st.integers(0, len(self.open) - 1)))
        self.used.append(asked)
        arguments = asked.arguments if is_same else {**asked.arguments, "c": 1}
        if not is_same:
            with pytest.raises(urlink.LocalError, match="the consent was for another request"):
                self.questions.take(asked.id, asked.tool, arguments)
            return
        assert self.questions.take(asked.id, asked.tool, arguments) is asked
        if self.is_valid(asked):
            self.questions.check(asked)
        else:
            with pytest.raises(urlink.LinkTimeout):
                self.questions.check(asked)

    @rule(data=st.data())
    def answer_again(self, data: st.DataObject) -> None:
        if self.used:
            asked = data.draw(st.sampled_from(self.used))
            with pytest.raises(urlink.LocalError, match="answered before"):
                self.questions.take(asked.id, asked.tool, asked.arguments)

    @rule(id=st.text(max_size=30))
    def guess(self, id: str) -> None:
        with pytest.raises(urlink.LocalError):
            self.questions.take(id, "move_joints", {})


TestQuestions = pytest.mark.property(QuestionsMachine.TestCase)
