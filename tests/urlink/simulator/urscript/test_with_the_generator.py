"""Programs with the motion generator of the simulated arm."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from tests.fakes.world import NotedWorld
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS
from urlink.simulator.robot.generator import MotionGenerator
from urlink.simulator.robot.setpoint_sources import HOME, Setpoint
from urlink.simulator.urscript import Execution, compile_script


def play(text: str, seconds: float = 20.0) -> tuple[NotedWorld, list[Sequence[float]], Execution]:
    """Return the stand-in with a real motion generator, its joint positions for each cycle, and the execution."""
    world = NotedWorld()
    generator = MotionGenerator(Arm("UR5e"), Setpoint(list(HOME), [0.0] * 6, [0.0] * 6))
    generator.tcp = world.tcp
    world.motion = generator  # type: ignore[assignment]
    execution = Execution(compile_script(text, world.firmware), world)
    path: list[Sequence[float]] = []
    while not execution.is_over and world.cycle < seconds / world.period:
        execution.advance()
        world.q_target = list(generator.advance(world.period).q)
        path.append(world.q_target)
        world.cycle += 1
    return world, path, execution


def test_program_moves_the_arm_from_its_current_posture() -> None:
    text = """
def prog():
  movej([0, -1.5, 1.5, -1.5, -1.5, 0], a=2, v=1)
  textmsg(norm(get_target_joint_positions() - [0, -1.5, 1.5, -1.5, -1.5, 0]) < 1e-9)
  textmsg(is_steady())
  movel(pose_add(get_target_tcp_pose(), p[0, 0, 0.05, 0, 0, 0]), v=0.1)
  speedj([0.1, 0, 0, 0, 0, 0], 1, 0.1)
  stopj(2)
  textmsg(is_steady())
end
"""
    world, path, execution = play(text)
    assert execution.error is None
    assert [note.split(maxsplit=1)[1] for note in world.notes] == ["textmsg True"] * 3
    begin, end = (Arm(MODELS["UR5e"]).forward(q, world.tcp) for q in ([0, -1.5, 1.5, -1.5, -1.5, 0], path[-1]))
    assert end[2] - begin[2] == pytest.approx(0.05, abs=1e-6)


def test_servoj_uses_one_set_point_per_cycle() -> None:
    text = """
q = get_target_joint_positions()
i = 0
while i < 100:
  i = i + 1
  q[5] = q[5] + 0.001
  servoj(q, t=0.002, lookahead_time=0.03, gain=300)
end
"""
    world, path, execution = play(text)
    assert execution.error is None
    assert world.cycle == 101
    assert path[-1][5] > 0.05


def test_target_out_of_range_is_a_runtime_error() -> None:
    _, _, execution = play("movej([0, 0, 0, 9, 0, 0])")
    assert execution.error is not None
    assert (execution.error.line, execution.error.column) == (1, 1)
