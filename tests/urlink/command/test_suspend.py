"""A computer that was suspended: states received before the suspend are too old to permit a motion."""

from __future__ import annotations

import pytest

from tests.fakes.clock import Suspend
from tests.fakes.controller import ScriptedController
from urlink.errors import NotRunning

pytestmark = pytest.mark.simulated_time


def test_states_from_before_a_suspend_permit_no_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    suspend = Suspend(monkeypatch)
    with ScriptedController() as robot:
        robot.clear()
        robot.channel.motion("movej(q)")
        suspend(100.0)
        with pytest.raises(NotRunning, match=r"nothing was read from the \w+ interface for 100\.\d s"):
            robot.channel.motion("movej(q)")
        robot.state()
        robot.safety.wait_enabled(5)
        robot.channel.motion("movej(q)")
