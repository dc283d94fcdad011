"""Time of programs: the ramp at the start, the speed slider, and the reported values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue
from tests.urlink.simulator.generator.stepping import CYCLE, cycles, finish, standing, trapezoid
from tests.urlink.simulator.rtde_peer import Peer, step
from urlink.arm.kinematics import Arm
from urlink.arm.models import model
from urlink.protocol.enums import TimeScaleSource
from urlink.simulator import Controller, ScalingParameters, Still
from urlink.simulator.robot.generator import MotionGenerator
from urlink.simulator.robot.setpoint_sources import HOME, Setpoint

REST = [0.0] * 6
TURN = f"def turn():\n  movej([0.4, {', '.join(map(str, HOME[1:]))}], a=1.4, v=1.05)\nend\n"
SPIN = "def spin():\n  while True:\n    speedj([0.3, 0, 0, 0, 0, 0.2], 2.0, 0.008)\n  end\nend\n"


def targets(controller: Controller, count: int) -> list[Setpoint]:
    setpoints = []
    for _ in range(count):
        controller.step()
        setpoints.append(controller.arm.setpoint)
    return setpoints


# -- servoj --------------------------------------------------------------------------------------


@pytest.mark.parametrize("fraction", [1.0, 0.5, 0.25, 0.7, 0.9, 0.05])
@pytest.mark.parametrize("command", ["servoj", "speedj", "speedl"])
def test_command_of_one_cycle_is_stretched_by_the_slider(command: str, fraction: float) -> None:
    generator = standing()
    generator.scaling = generator.speed_fraction = fraction
    each: list[int] = []
    while sum(each) < 2000:
        move = {
            "servoj": lambda: generator.servoj(list(HOME), CYCLE, 0.03, 300.0),
            "speedj": lambda: generator.speedj([0.01] * 6, 1.0, CYCLE),
            "speedl": lambda: generator.speedl([0.001, 0, 0, 0, 0, 0], 1.0, CYCLE),
        }[command]()
        count = 0
        while not move.is_over:
            generator.advance(CYCLE)
            count += 1
        each.append(count)
    assert len(each) == pytest.approx(2000 * fraction, abs=2)
    assert max(each) - min(each) <= 1
    if fraction == 0.5:
        assert set(each) == {2}


@pytest.mark.parametrize("command", ["servoj", "speedj", "speedl"])
def test_commands_make_no_progress_at_zero(command: str) -> None:
    generator = standing()
    generator.scaling = generator.speed_fraction = 0.0
    move = {
        "servoj": lambda: generator.servoj([q + 0.01 for q in HOME], CYCLE, 0.03, 300.0),
        "speedj": lambda: generator.speedj([0.1] * 6, 1.0, CYCLE),
        "speedl": lambda: generator.speedl([0.01, 0, 0, 0, 0, 0], 1.0, 0.0),
    }[command]()
    for setpoint in cycles(generator, 1000):
        assert setpoint.q == list(HOME)
    assert not move.is_over


def streamed(
    fractions: Sequence[float],
    parameters: ScalingParameters = ScalingParameters(),  # noqa: B008
) -> tuple[list[Setpoint], list[float]]:
    """Return the set-points of a stream at 1 rad/s without skipping, and the scaled time after each of them.

    Args:
        fractions: Fraction of the speed slider for each cycle.
        parameters: Parameters of the speed scaling.
    """
    generator = MotionGenerator(Arm(model("UR5e")), Setpoint(list(HOME), REST, REST), 1.0, parameters)
    number, move, setpoints, times, time = 0, None, [], [], 0.0
    for fraction in fractions:
        if move is None or move.is_over:
            number += 1
            move = generator.servoj([HOME[0] + wave(number * CYCLE), *HOME[1:]], CYCLE, 0.03, 300.0)
        generator.speed_fraction = fraction
        before = generator.scaling
        setpoints.append(generator.advance(CYCLE))
        time += 0.5 * (before + generator.scaling) * CYCLE
        times.append(time)
    return setpoints, times


def wave(time: float) -> float:
    return float(0.2 * (1.0 - np.cos(3.0 * time)))


@pytest.mark.slow
def test_stream_follows_the_same_path_in_scaled_time() -> None:
    full, at = streamed([1.0] * 2500)
    path = np.array([each.q[0] for each in full])
    rng = np.random.default_rng(5)
    profiles = {
        "half": [0.5] * 3000,
        "steps": [float(f) for f in np.repeat(rng.random(30), 100)],
        "zero": [1.0] * 500 + [0.0] * 1000 + [1.0] * 1000,
        "noise": [float(f) for f in rng.random(3000)],
    }
    for name, fractions in profiles.items():
        setpoints, times = streamed(fractions)
        there = np.interp(times, at, path)
        assert np.abs(np.array([each.q[0] for each in setpoints]) - there).max() < 0.5 * CYCLE * 0.6, (
            name
        )  # half a cycle at the highest speed
        qd = np.array([each.qd[0] for each in setpoints])
        drift = np.diff([each.q[0] for each in setpoints]) - 0.5 * CYCLE * (qd[1:] + qd[:-1])
        assert np.abs(drift).max() < 1e-4, name


def test_servoj_lag_is_stretched_by_the_slider_if_configured() -> None:
    profile = [1.0] * 400 + [0.0] * 1000
    stretched, _ = streamed(profile)
    straight, _ = streamed(profile, ScalingParameters(servoj_lag_stretches=False))
    speed = stretched[399].qd[0]
    assert abs(speed) > 0.3
    # At 0 the arm stops immediately, or moves on to the set-point that it lags behind: 0.5 * 0.03 + 2 / 300 s here.
    assert straight[-1].q[0] - stretched[-1].q[0] == pytest.approx(speed * 0.0217, rel=0.3)


def test_motion_taken_over_near_zero_stays_within_limits() -> None:
    generator = standing()
    generator.speedj([1.0, 0, 0, 0, 0, 0], 2.0, None)
    cycles(generator, 400)
    generator.speed_fraction = 0.0
    generator.speedj([1.0, 0, 0, 0, 0, 0], 0.5, None)
    cycles(generator, 90)
    assert generator.scaling == 0.0
    assert generator.setpoint.qd[0] > 0.5
    generator.servoj(generator.setpoint.q, CYCLE, 0.03, 300.0)
    speeds = [setpoint.qd[0] for setpoint in cycles(generator, 500)]
    assert max(-np.diff(speeds)) / CYCLE <= float(model("UR5e").max_acceleration[0]) * (1 + 1e-9)
    assert speeds[-1] == 0.0


# -- the start of a program ----------------------------------------------------------------------


@pytest.mark.parametrize(("firmware", "rate"), [("5.11", 500), ("3.14", 125), ("1.8", 125)])
def test_program_starts_with_a_ramp_of_160_ms(firmware: str, rate: int) -> None:
    controller = Controller(firmware=firmware, noise=False)
    controller.take(TURN)
    controller.step()
    began = controller.cycle
    while controller.program_name:
        controller.step()
    assert (controller.cycle - began) / rate == pytest.approx(trapezoid(0.4, 1.05, 1.4) + 0.08, abs=2.5 / rate)


def test_ramp_matches_the_recorded_log() -> None:
    """With s_k = k / 80, the speed is a s² t while a motion accelerates evenly; t is the scaled time."""
    controller = Controller(firmware="5.11", noise=False)
    controller.take(TURN)
    speeds = [setpoint.qd[0] for setpoint in targets(controller, 100)]
    scaling = [min(k / 80, 1.0) for k in range(1, 101)]
    time = np.cumsum([(s - 0.5 / 80 if k < 80 else s) * 0.002 for k, s in enumerate(scaling)])
    expected = 1.4 * time * scaling
    begin = next(i for i, speed in enumerate(speeds) if speed > 0.0)
    np.testing.assert_allclose(speeds[begin:], expected[: 100 - begin], atol=1e-9)


def test_replacing_program_keeps_the_speed() -> None:
    controller = Controller(firmware="5.11", noise=False)
    controller.take(SPIN)
    targets(controller, 300)
    controller.take(SPIN)
    assert min(setpoint.qd[0] for setpoint in targets(controller, 50)) == pytest.approx(0.3)


def test_resumed_program_starts_with_a_ramp() -> None:
    controller = Controller(firmware="5.11", noise=False)
    controller.take(SPIN)
    targets(controller, 300)
    assert controller.pendant.pause()
    assert not any(targets(controller, 500)[-1].qd)
    assert controller.pendant.play()
    speeds = np.array([setpoint.qd[0] for setpoint in targets(controller, 120)])
    assert np.diff(speeds).max() == pytest.approx(0.3 / 80, rel=1e-6)
    assert speeds[-1] == pytest.approx(0.3)


# -- later moves of a program --------------------------------------------------------------------

FOLDED, UNFOLDED = [-1.57, -1.6, 1.6, -0.7, 0.7, 0.2], [-1.57, -1.57, 0.0, 0.0, 0.0, 0.0]


_USUAL = ScalingParameters()


def durations(lines: str, scaling: ScalingParameters = _USUAL, firmware: str = "5.11") -> list[float]:
    """Return the duration of each motion of a program that begins at `UNFOLDED`, in s."""
    controller = Controller(firmware=firmware, motion=Still(UNFOLDED), noise=False, scaling=scaling)
    controller.take(f"def f():\n{lines}end\n")
    moving = []
    while controller.program_name is not None:
        moving.append(any(targets(controller, 1)[0].qd))
    edges = np.flatnonzero(np.diff([0, *moving, 0]))
    return [1.0 / controller.firmware.rate * float(count + 1) for count in np.diff(edges)[::2]]


@pytest.mark.parametrize("rest", ["", "  sleep(0.3)\n"])
def test_later_moves_from_rest_have_a_shorter_ramp(rest: str) -> None:
    ideal, rest = trapezoid(1.6, 3.1, 3.4), rest or "  sync()\n  sync()\n"
    there, back = (f"  movej({q}, a=3.4, v=3.1)\n" for q in (FOLDED, UNFOLDED))
    first, *later = durations(there + rest + back + rest + there)
    assert first == pytest.approx(ideal + 0.08, abs=0.003)
    assert later == pytest.approx([ideal + 0.04] * 2, abs=0.003)
    (_, slower) = durations(there + rest + back, ScalingParameters(move_rate=6.25))
    assert slower == pytest.approx(ideal + 0.08, abs=0.003)


@pytest.mark.parametrize("firmware", ["5.11", "5.25"])
def test_next_moves_take_as_long_as_on_the_vendor_simulator(firmware: str) -> None:
    # The limits come from the tests of the UR Client Library. Its executor sends one move after the other to a running
    # program. It checks every 0.1 s whether the move has ended. movej lasts more than 1.4 s (1.45 to 1.65 s in earlier
    # releases) and movel 0.65 to 0.85 s. A move with a time lasts up to 0.1 s longer than this time; the exception is a
    # move of 0.3 s, which lasts 0.35 to 0.45 s.
    pose, near = "p[-0.203, 0.263, 0.559, 0.68, -1.083, -2.076]", "p[-0.203, 0.463, 0.559, 0.68, -1.083, -2.076]"
    lines = {
        f"movej({FOLDED}, 1.4, 1.05)": (1.0, 5.0),
        f"movej({UNFOLDED}, 3.4, 3.1)": (1.4, 1.5),
        f"movej({FOLDED}, 3.4, 3.1)": (1.4, 1.5),
        f"movej({UNFOLDED}, 3.4, 3.1, 3)": (3.0, 3.1),
        f"movej({FOLDED}, 3.4, 3.1, 2.5)": (2.5, 2.6),
        f"movel({pose})": (0.5, 5.0),
        f"movel({near}, 1.5, 1.5)": (0.7, 0.8),
        f"movel({pose}, 1.5, 1.5, 0.3)": (0.3, 0.4),
    }
    found = durations("".join(f"  {line}\n  sleep(0.05)\n" for line in lines), firmware=firmware)
    for seconds, (low, high) in zip(found, lines.values(), strict=True):
        assert low < seconds < high


def test_blended_move_has_no_ramp() -> None:
    generator = standing(UNFOLDED)
    generator.movej(FOLDED, 1.4, 1.05, 0.0, 0.1)
    while not generator._command.is_over:  # type: ignore[union-attr]
        generator.advance(CYCLE)
    generator.movej(UNFOLDED, 1.4, 1.05)
    generator.advance(CYCLE)
    assert generator.scaling == 1.0


def test_ramp_of_a_later_move_ends_at_the_slider() -> None:
    generator = standing(UNFOLDED)
    generator.scaling = generator.speed_fraction = 0.5
    finish(generator, generator.movej([*UNFOLDED[:5], 0.1]))
    generator.movej(UNFOLDED)
    scalings = []
    for _ in range(30):
        generator.advance(CYCLE)
        scalings.append(generator.scaling)
    np.testing.assert_allclose(scalings[:20], [0.025 * k for k in range(1, 21)], atol=1e-12)
    assert scalings[20:] == [0.5] * 10


# -- reported values -----------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["3.4", "3.14", "5.4", "5.11", "5.22"])
def test_all_interfaces_report_the_same_scaling(firmware: str) -> None:
    controller = Controller(firmware=firmware, noise=False)
    peer = Peer(controller)
    names = ["speed_scaling", "target_speed_fraction"]
    if controller.firmware >= (5, 11):
        names.append("time_scale_source")
    peer.outputs(*names)
    peer.start()
    seen = set()
    for number in range(400):
        if number == 20:
            controller.take(SPIN)
        if number == 150:
            controller.speed_fraction = 0.4
        if number == 300:
            controller.pendant.pause()
        step(controller)
        data = peer.data()
        if number < 2 or not data:
            continue
        (realtime,) = urlink.decode(controller.realtime_packet(), "realtime", firmware)
        (state,) = urlink.decode(controller.state_package(), "primary", firmware)
        assert isinstance(state, urlink.packets.RobotState)
        assert state.robot_mode_data
        rtde, mode = data[-1], state.robot_mode_data
        assert rtde["speed_scaling"] == realtime.speed_scaling == mode.speed_scaling
        assert rtde["target_speed_fraction"] == mode.target_speed_fraction == controller.speed_fraction
        scaling = rtde["speed_scaling"]
        if not mode.is_program_running:  # captured packets: docs/protocols/primary.md
            assert scaling == (1.0 if firmware == "3.4" and number < 150 else 0.0 if firmware != "3.4" else 0.4)
        if "time_scale_source" in names:
            seen.add((rtde["time_scale_source"], bool(scaling), mode.is_program_running))
    if "time_scale_source" in names:
        assert seen == {
            (TimeScaleSource.PROGRAM_NOT_RUNNING, False, False),
            (TimeScaleSource.SMOOTH_TRANSITION, True, True),
            (TimeScaleSource.NOT_SCALED, True, True),
        }


def test_slider_takes_effect_at_its_rate() -> None:
    controller = Controller(firmware="5.11", noise=False)
    controller.take(SPIN)
    targets(controller, 200)
    controller.speed_fraction = 0.5
    speeds = np.array([setpoint.qd[0] for setpoint in targets(controller, 60)])
    np.testing.assert_allclose(speeds[:40], [0.3 * (1 - 0.0125 * k) for k in range(1, 41)], atol=1e-9)
    np.testing.assert_allclose(speeds[40:], 0.15, atol=1e-9)


# -- parameters ----------------------------------------------------------------------------------


def test_slider_rate_must_be_positive() -> None:
    with pytest.raises(BadValue, match="slider_rate"):
        ScalingParameters(slider_rate=0.0)
