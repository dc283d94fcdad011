"""Simulated arm, and the package's robot to connect to it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import urlink
from lerobot_robot_urlink import UR, URConfig
from urlink.simulator import Controller


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use long limits, because a busy machine causes silence and delays of the robot."""
    monkeypatch.setattr(urlink, "connect", partial(urlink.connect, silence=20.0, stale_after=20.0, start_timeout=20.0))


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        with urlink.connect(controller.address) as robot:
            robot.motion.move_joints([0.0, -1.5, 1.5, -1.5, -1.5, 0.0], wait=True)
        yield controller


@pytest.fixture
def make(controller: Controller, tmp_path: Path) -> Iterator[Callable[..., UR]]:
    made: list[UR] = []

    def one(**options: Any) -> UR:
        given = {"id": "test", "calibration_dir": tmp_path, "address": controller.address, "fps": 50.0, **options}
        made.append(UR(URConfig(**given)))
        return made[-1]

    yield one
    for arm in made:
        arm.disconnect()


@pytest.fixture
def arm(make: Callable[..., UR]) -> UR:
    return make()
