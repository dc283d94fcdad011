"""Environments on simulated arms: pacing, states, limits, errors and bad input."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import urlink
from linkcore import clock
from packages.gym.tests.conftest import CB3, E_SERIES
from urlink import BadValue, SessionLimits
from urlink.simulator import Controller, Still
from urlink_gym import ArmEnv, Task
from urlink_gym.arm_env import HOME

Make = Callable[..., ArmEnv]
#: Box around the home position of a UR5.
BOX = ((-0.6, -0.3, 0.3), (-0.4, 0.1, 0.6))
STILL = np.zeros(3)


def moved(env: ArmEnv, action: Any, count: int) -> list[dict[str, Any]]:
    """Make steps, and return the dictionaries with information."""
    return [env.step(action)[4] for _ in range(count)]


@pytest.mark.parametrize("action", ["joint_deltas", "pose_deltas", "position_deltas"])
@pytest.mark.filterwarnings("error")
def test_env_passes_gymnasiums_check(simulated_time: urlink.Simulation, action: str) -> None:
    for options in ({}, {"gripper": True, "observe_force": True}):
        with gymnasium.make("urlink/Reach-v0", robot=CB3, action=action, **options) as env:
            check_env(env.unwrapped, skip_render_check=True)


def test_env_of_joints_passes_gymnasiums_check(simulated_time: urlink.Simulation) -> None:
    with (
        gymnasium.make("urlink/Arm-v0", robot=CB3, action="joints") as env,
        pytest.warns(UserWarning, match="normalized space"),
    ):
        check_env(env.unwrapped, skip_render_check=True)


def test_step_moves_tool_by_its_actions(make: Make) -> None:
    env = make(E_SERIES)
    before, _ = env.reset()
    moved(env, [1.0, 0.0, -0.5], 10)
    moved(env, STILL, 20)
    after, *_ = env.step(STILL)
    assert after["tool_position"] - before["tool_position"] == pytest.approx([0.1, 0.0, -0.05], abs=2e-3)
    assert after["tool_rotation"] == pytest.approx(before["tool_rotation"], abs=5e-3)


def test_step_turns_tool_about_axes_of_base(make: Make) -> None:
    env = make(E_SERIES, "pose_deltas")
    before, _ = env.reset()
    for _ in range(10):
        env.step([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    moved(env, np.zeros(6), 20)
    after, *_ = env.step(np.zeros(6))
    first, later = (np.arctan2(*each["tool_rotation"][[1, 0]]) for each in (before, after))
    assert later - first == pytest.approx(10 * 0.05, abs=5e-3)
    assert after["tool_position"] == pytest.approx(before["tool_position"], abs=2e-3)


def test_step_lasts_one_period(make: Make) -> None:
    env = make(rate=10.0)
    env.reset()
    begin = clock.now()
    infos = moved(env, STILL, 20)
    assert clock.now() - begin == pytest.approx(2.0, abs=0.01)
    assert {info["late"] for info in infos} == {0.0}


def test_late_step_is_reported_and_gets_whole_period(make: Make) -> None:
    env = make(rate=20.0)
    env.reset()
    env.step(STILL)
    clock.sleep(0.25)
    begin = clock.now()
    *_, info = env.step(STILL)
    assert info["late"] == pytest.approx(0.2, abs=0.01)
    assert clock.now() - begin == pytest.approx(0.05, abs=0.005)
    assert env.step(STILL)[4]["late"] == 0.0


def test_states_contain_every_cycle(make: Make) -> None:
    env = make(E_SERIES)
    _, info = env.reset()
    states = info["states"]
    for _ in range(10):
        observation, *_, info = env.step([0.3, 0.0, 0.0])
        assert len(info["states"]) >= 20
        assert observation["q_actual"] == pytest.approx(info["states"][-1].q_actual, abs=1e-6)
        states += info["states"]
    assert np.diff([state.time for state in states]) == pytest.approx(0.002, abs=1e-4)


def test_arm_rests_at_its_target_when_the_policy_hangs(make: Make) -> None:
    env = make()
    env.reset()
    moved(env, [1.0, 0.0, 0.0], 10)
    clock.sleep(60.0)
    state = env.robot.realtime.wait()
    assert np.abs(state.qd_actual).max() < 1e-2
    observation, *_, info = env.step(STILL)
    assert "error" not in info
    assert np.abs(observation["qd_actual"]).max() < 1e-2
    # No more than the last 20 s at 500 Hz.
    assert len(info["states"]) <= 10_000


def test_action_outside_of_space_is_clipped(make: Make) -> None:
    env = make()
    env.reset()
    *_, info = env.step([5.0, -0.5, 0.0])
    assert info["action"] == pytest.approx([1.0, -0.5, 0.0], abs=1e-4)
    assert info["action"] in env.action_space


@pytest.mark.parametrize(
    "wrong", [[0.0, 0.0], [0.0, 0.0, np.nan], [0.0, 0.0, np.inf], "left", None, [[0.0, 0.0, 0.0]], ["a", "b", "c"]]
)
def test_step_rejects_invalid_actions(make: Make, wrong: Any) -> None:
    env = make()
    env.reset()
    target = env.robot.realtime.wait().q_target
    with pytest.raises(BadValue, match="expected"):
        env.step(wrong)
    observation, *_ = env.step(STILL)
    assert observation["q_actual"] == pytest.approx(target, abs=5e-3)


def test_step_needs_reset(make: Make) -> None:
    env = make()
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(STILL)


# -- limits ------------------------------------------------------------------------------------------


@pytest.fixture
def at_home(simulated_time: urlink.Simulation) -> Iterator[Controller]:
    """Controller whose arm is in the home position, and therefore in the box."""
    with Controller("UR5", "3.15", motion=Still(HOME)) as controller:
        yield controller


def test_tool_slides_along_face_of_box(make: Make, at_home: Controller) -> None:
    env = make(at_home.address, limits=SessionLimits(tool_speed=0.5, box=BOX))
    env.reset()
    infos = moved(env, [1.0, -0.2, 0.0], 40)
    assert infos[-1]["action"][0] == pytest.approx(0.0, abs=1e-3)
    assert infos[-1]["action"][1] == pytest.approx(-0.2, abs=1e-3)
    places = np.array([state.tool_vector_actual[:3] for info in infos for state in info["states"]])
    assert places[:, 0].max() <= BOX[1][0]
    assert places[:, 0].max() >= BOX[1][0] - 0.005


def test_joint_action_at_limit_is_blocked(make: Make, at_home: Controller) -> None:
    env = make(at_home.address, "joint_deltas", limits=SessionLimits(tool_speed=0.5, box=BOX))
    env.reset()
    infos = moved(env, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 40)
    assert infos[0]["blocked"] == ""
    assert infos[-1]["blocked"] == "box"
    assert infos[-1]["action"] == pytest.approx(np.zeros(6))
    places = np.array([state.tool_vector_actual[:3] for info in infos for state in info["states"]])
    assert ((np.array(BOX[0]) < places) & (places < np.array(BOX[1]))).all()
    # Back into the box, the arm moves again.
    assert moved(env, [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 3)[-1]["blocked"] == ""


def test_speed_of_tool_stays_below_limit(make: Make, at_home: Controller) -> None:
    env = make(at_home.address, limits=SessionLimits(tool_speed=0.15, box=BOX))
    env.reset()
    rng = np.random.default_rng(1)
    states = [state for _ in range(60) for state in moved(env, rng.choice([-1.0, 1.0], 3), 1)[0]["states"]]
    places = np.array([state.tool_vector_actual[:3] for state in states])
    # Over five cycles of 8 ms, because the sensors have noise.
    speeds = np.linalg.norm(places[5:] - places[:-5], axis=1) / 0.04
    assert speeds.max() <= 0.155
    assert speeds.max() >= 0.05


def test_target_out_of_reach_is_blocked(make: Make) -> None:
    env = make()
    env.reset(options={"home": [0.0, -0.4, 0.5, -1.57, -1.57, 0.0]})
    infos = moved(env, [-1.0, 0.0, 0.0], 40)
    assert infos[-1]["blocked"] in ("reach", "singularity")
    assert "error" not in infos[-1]


def test_target_is_never_far_ahead_of_arm(make: Make) -> None:
    env = make(action="joint_deltas", speed=0.1, acceleration=1.0)
    env.reset()
    infos = moved(env, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 40)
    assert infos[-1]["blocked"] == "lag"
    begin = env.robot.realtime.wait().q_target[0]
    clock.sleep(10.0)
    assert env.robot.realtime.wait().q_target[0] - begin <= 0.5


def test_limits_lower_speed_of_reset(make: Make) -> None:
    env = make(limits=SessionLimits(tool_speed=0.25, joint_speed=0.5, box=((-0.9, -0.9, 0.1), (0.9, 0.9, 0.9))))
    env.reset(options={"home": [0.8, -1.57, 1.57, -1.57, -1.57, 0.0]})
    _, info = env.reset()
    assert info["states"][-1].q_actual == pytest.approx([0.0, -1.57, 1.57, -1.57, -1.57, 0.0], abs=5e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot": "192.168.0.1"}, "limits are missing"),
        ({"robot": 7}, "expected an address"),
        ({"robot": CB3, "rate": 0.0}, "rate"),
        ({"robot": CB3, "rate": float("nan")}, "rate"),
        ({"robot": CB3, "rate": True}, "rate"),
        ({"robot": CB3, "spread": -1.0}, "spread"),
        ({"robot": CB3, "home": [0.0]}, "home"),
        ({"robot": CB3, "action": "torque"}, "expected one of joints"),
        ({"robot": CB3, "limits": SessionLimits(allowed=("servo",))}, "move_joints"),
        ({"robot": CB3, "limits": SessionLimits(), "freedrive_button": bool}, "freedrive"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_env_rejects_invalid_arguments(make: Make, options: dict[str, Any], message: str) -> None:
    with pytest.raises(BadValue, match=message):
        make(**options)


def test_env_rejects_limits_with_connected_robot(make: Make, urlink_robot: urlink.Robot) -> None:
    with pytest.raises(BadValue, match=r"urlink\.connect"):
        make(urlink_robot, limits=SessionLimits())


@pytest.mark.parametrize("options", [{"home": [0.0]}, {"home": "up"}, {"Home": [0.0] * 6}])
def test_reset_rejects_invalid_options(make: Make, options: dict[str, Any]) -> None:
    env = make()
    env.reset()
    with pytest.raises(BadValue, match=next(iter(options))):
        env.reset(options=options)


# -- resets ------------------------------------------------------------------------------------------


def test_reset_draws_home_within_spread(make: Make) -> None:
    env = make(E_SERIES, spread=0.1)
    first, again, other = (env.reset(seed=seed)[0]["q_actual"] for seed in (1, 1, 2))
    assert first == pytest.approx(again, abs=2e-3)
    assert np.abs(first - other).max() > 0.01
    assert np.abs(first - [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]).max() < 0.11


def test_close_leaves_connected_robot_open(make: Make, urlink_robot: urlink.Robot) -> None:
    env = make(urlink_robot)
    env.reset()
    env.close()
    env.close()
    assert urlink_robot.realtime.wait().q_actual.shape == (6,)
    with pytest.raises(ResetNeeded):
        env.step(STILL)


def test_envs_run_as_vector(simulated_time: urlink.Simulation) -> None:
    envs = gymnasium.vector.SyncVectorEnv([lambda: gymnasium.make("urlink/Reach-v0", robot=CB3)] * 2)
    observations, _ = envs.reset(seed=3)
    assert observations["goal"].shape == (2, 3)
    assert not np.array_equal(*observations["goal"])
    *_, infos = envs.step(envs.action_space.sample())
    assert len(infos["states"]) == 2
    envs.close()


# -- errors ------------------------------------------------------------------------------------------


def test_safety_stop_ends_episode(make: Make, urlink_controller: Controller) -> None:
    with urlink.connect(urlink_controller.address) as robot:
        env = make(robot)
        env.reset()
        moved(env, [1.0, 0.0, 0.0], 5)
        urlink_controller.faults.protective_stop()
        for _ in range(20):
            observation, reward, terminated, truncated, info = env.step([1.0, 0.0, 0.0])
            if truncated:
                break
        assert (reward, terminated, truncated) == (0.0, False, True)
        assert "SafetyStop" in info["error"]
        assert isinstance(env.error, urlink.SafetyStop)
        assert observation in env.observation_space
        with pytest.raises(ResetNeeded):
            env.step(STILL)
        with pytest.raises(urlink.SafetyStop):
            env.reset()
        urlink_controller.faults.clear()
        robot.safety.wait_enabled(timeout=10.0)
        env.reset()
        *_, truncated, info = env.step(STILL)
        assert not truncated
        assert "error" not in info


def test_lost_connection_ends_episode(make: Make, simulated_time: urlink.Simulation) -> None:
    cell = simulated_time.computer("cell", "192.168.0.100")
    with simulated_time.on(cell):
        controller = Controller("UR5", "3.15", motion=Still(HOME), host="192.168.0.100", ports="standard").start()
    env = make("192.168.0.100", limits=SessionLimits(box=BOX))
    env.reset()
    moved(env, [-0.5, 0.0, 0.0], 5)
    simulated_time.schedule(f"cut=cell@{simulated_time.now + 0.1}")
    begin = clock.now()
    for _ in range(100):
        *_, truncated, info = env.step([-0.1, 0.0, 0.0])
        if truncated:
            break
    assert truncated
    assert info["error"]
    assert clock.now() - begin < 15.0
    with simulated_time.on(cell):
        # The program on the robot has braked the arm on its own.
        assert np.abs(controller.arm.sample.qd_actual).max() < 0.05
        controller.close()


def test_closed_session_ends_episode(make: Make) -> None:
    env = make()
    env.reset()
    env.step([1.0, 0.0, 0.0])
    env.robot.close()
    *_, truncated, info = env.step([1.0, 0.0, 0.0])
    assert truncated
    assert "robot was closed" in info["error"]


def test_motion_of_another_program_ends_episode(make: Make, urlink_controller: Controller) -> None:
    with urlink.connect(urlink_controller.address) as robot:
        env = make(robot)
        env.reset()
        urlink_controller.take("sleep(10)\n")
        for _ in range(40):
            *_, truncated, info = env.step(STILL)
            if truncated:
                break
        assert truncated
        assert info["error"]


class Failing(Task):
    """Task whose reward fails after some steps."""

    left = 5

    def judge(self, env: ArmEnv, observation: dict[str, Any]) -> tuple[float, bool]:
        self.left -= 1
        if not self.left:
            raise ZeroDivisionError
        return 1.0, False


def test_exception_of_task_stops_arm(make: Make) -> None:
    env = make(task=Failing())
    env.reset()
    with pytest.raises(ZeroDivisionError):
        moved(env, [1.0, 0.0, 0.0], 5)
    assert np.abs(env.robot.realtime.wait().qd_target).max() < 1e-3
    with pytest.raises(ResetNeeded):
        env.step(STILL)


# -- gripper and images ------------------------------------------------------------------------------


def test_gripper_follows_last_number(make: Make) -> None:
    env = make(gripper=True)
    observation, _ = env.reset()
    assert observation["gripper"] == pytest.approx([-1.0], abs=0.05)
    infos = moved(env, [0.0, 0.0, 0.0, 1.0], 40)
    assert infos[-1]["action"] == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=1e-3)
    observation, *_ = env.step([0.0, 0.0, 0.0, 1.0])
    assert observation["gripper"] == pytest.approx([1.0], abs=0.2)
    observation, _ = env.reset()
    assert observation["gripper"] == pytest.approx([-1.0], abs=0.05)


def test_fault_of_gripper_ends_episode(make: Make) -> None:
    env = make(gripper=True)
    env.reset()
    env.robot.controller.gripper.fault = 10
    *_, truncated, info = env.step([0.0, 0.0, 0.0, 1.0])
    assert truncated
    assert "GripperFault" in info["error"]


def test_images_are_observations(make: Make) -> None:
    shades = iter(range(10, 250))
    env = make(images={"wrist": lambda robot: np.full((4, 6, 3), next(shades), np.uint8)})
    assert env.observation_space["wrist"].shape == (4, 6, 3)
    observation, _ = env.reset()
    later, *_ = env.step(STILL)
    assert later["wrist"][0, 0, 0] == observation["wrist"][0, 0, 0] + 1


def test_names_of_observations_must_differ(make: Make) -> None:
    with pytest.raises(BadValue, match="q_actual"):
        make(images={"q_actual": lambda robot: np.zeros((2, 2, 3), np.uint8)})
