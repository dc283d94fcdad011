"""Each task of `new_user` has its examples, and the way to the first motion is short."""

from __future__ import annotations

import pytest

from tests.new_user import TASKS, Task, examples, words


@pytest.mark.parametrize("task", TASKS, ids=lambda task: task.what)
def test_a_task_has_examples(task: Task) -> None:
    assert ">>> " in examples(task)


def test_a_section_that_is_not_there_is_an_error() -> None:
    with pytest.raises(ValueError, match="no section 'Fly'"):
        examples(Task("fly", "moving", "Fly"))


def test_the_way_to_the_first_motion_is_short() -> None:
    assert 300 < words() < 900
