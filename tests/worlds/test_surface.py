"""Worlds can draw every public method of a robot, with arguments for all of its parameters."""

from __future__ import annotations

import random

import pytest

from tests.worlds import mobile, promises
from tests.worlds.surface import ACTIONS, LEFT_OUT, PARTS, Drawing, lacking, missing_parts, public_methods

_WHERE = "add a row to DRAWERS in tests/worlds/{}.py for each of these parameters"


def test_every_parameter_has_a_generator_of_random_values() -> None:
    assert lacking() == [], _WHERE.format("surface")


def test_every_rhdlink_parameter_has_a_random_generator() -> None:
    assert mobile.lacking() == [], _WHERE.format("mobile")


def test_every_part_of_a_robot_is_known() -> None:
    assert missing_parts() == [], "add these attributes of Robot to PARTS or VALUES in tests/worlds/surface.py"


def test_excluded_actions_exist() -> None:
    every = {f"{part}.{name}" for part, cls in PARTS.items() for name in public_methods(cls)}
    assert LEFT_OUT.keys() <= every


@pytest.mark.parametrize("name", ACTIONS)
def test_random_arguments_include_all_required_parameters(name: str) -> None:
    for seed in range(5):
        positional, named = ACTIONS[name].arguments(Drawing(random.Random(seed)))
        required = [each.name for each in ACTIONS[name].parameters() if each.default is each.empty]
        assert len(required) <= len(positional) + len(named)


def test_every_promise_has_a_page_and_a_sentence() -> None:
    for where, sentence in promises.PROMISES.values():
        assert where
        assert sentence
