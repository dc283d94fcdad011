"""Payload and direction of gravity, set on a simulated controller while it moves."""

from __future__ import annotations

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue
from linkcore.handle import Phase
from urlink.arm.dynamics import Dynamics

pytestmark = pytest.mark.simulated_time

INERTIA = [0.02, 0.02, 0.01, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("up", [[0.0, 9.82, 0.0], [0.0, 0.0, -9.82], [3.0, 0.0, 9.0]])
def test_gravity_changes_target_torques(up: list[float]) -> None:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        q = robot.realtime.wait().q_target
        motion = robot.motion.speed_joints([0, 0, 0, 0, 0, 0.1], duration=0.5)
        robot.set_gravity(up)
        motion.wait()
        assert motion.phase is Phase.DONE
        wanted = Dynamics("UR5e", gravity=[-each for each in up]).gravity_torque(q)
        state = robot.realtime.wait_until(lambda state: np.allclose(state.M_target, wanted, atol=0.05))
        assert np.abs(state.M_target - Dynamics("UR5e").gravity_torque(q)).max() > 1.0
        with robot.rtde.outputs("target_gravity") as outputs:
            assert outputs.wait().target_gravity == pytest.approx(up)


@pytest.mark.parametrize("up", [[0, 0, 1], [0, 0, 9820], [9.82, 0], [0, 0, float("nan")], [0, 0, 0]])
def test_invalid_gravity_is_rejected(up: list[float]) -> None:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot, pytest.raises(BadValue, match="gravity"):
        robot.set_gravity(up)


@pytest.mark.slow
def test_payload_changes_gradually_while_program_runs() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.realtime.wait()
        motion = robot.motion.speed_joints([0, 0, 0, 0, 0, 0.1], duration=2.0)
        shown: list[tuple[float, float, float]] = []

        def look(state: urlink.RealtimeState) -> None:
            assert state.payload_mass is not None
            assert state.payload_cog is not None
            shown.append((state.time, float(state.payload_mass), float(state.payload_cog[2])))

        with robot.realtime.subscribe(look, inline=True):
            robot.set_payload(2.0, [0, 0, 0.1], INERTIA, transition_time=0.5, confirm=0.3)
        assert not motion.done
        time, mass, height = np.array(shown).T
        assert mass[-1] == pytest.approx(2.0)
        between = (mass > 0.0) & (mass < 2.0)
        assert time[between][-1] - time[between][0] == pytest.approx(0.5, abs=0.01)
        assert np.diff(mass).max() < 0.02
        assert height[between] == pytest.approx(0.05 * mass[between])
        robot.set_payload(1.0, [0, 0, 0.0], INERTIA)
        motion.wait()
        assert motion.phase is Phase.DONE


@pytest.mark.parametrize(
    ("firmware", "options", "what"),
    [
        ("5.11", {}, "needs both"),
        ("5.11", {"cog": [0, 0, 0.1]}, "needs both"),
        ("5.9", {"cog": [0, 0, 0.1], "inertia": INERTIA}, "accepts no inertia; 5.10 or later is required"),
    ],
)
def test_transition_requires_cog_and_inertia(firmware: str, options: dict[str, list[float]], what: str) -> None:
    with urlink.connect(f"sim://ur5e?firmware={firmware}") as robot:
        with pytest.raises(BadValue, match=what):
            robot.set_payload(1.0, transition_time=0.5, **options)  # type: ignore[arg-type]
        with pytest.raises(BadValue, match="transition_time"):
            robot.set_payload(1.0, transition_time=-0.5)
