"""Environments on a simulated arm, in simulated time."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import urlink
from urlink_gym import ArmEnv

if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported

#: The CB3 has the fewest cycles per second, so its tests are the fastest.
CB3, E_SERIES = "sim://ur5?firmware=3.15", "sim://ur5e?firmware=5.11"


@pytest.fixture
def make(simulated_time: urlink.Simulation) -> Iterator[Callable[..., ArmEnv]]:
    """Function that makes environments, which are closed after the test."""
    made: list[ArmEnv] = []

    def one(robot: Any = CB3, action: str = "position_deltas", **options: Any) -> ArmEnv:
        made.append(ArmEnv(robot, action, **options))
        return made[-1]

    yield one
    for env in made:
        env.close()
