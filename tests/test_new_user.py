"""Each task of `new_user` has examples, and the text before the first motion is short."""

from __future__ import annotations

import pytest

from tests.new_user import TASKS, Task, examples, words


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.what)
def test_task_has_examples(task: Task) -> None:
    assert ">>> " in examples(task)


def test_examples_rejects_a_missing_section() -> None:
    with pytest.raises(ValueError, match="no section 'Fly'"):
        examples(Task("fly", "moving", "Fly"))


def test_text_before_the_first_motion_is_short() -> None:
    assert 300 < words() < 900
