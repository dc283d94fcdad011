"""The wheels of the simulated robot against the log of a robot."""

from __future__ import annotations

from random import Random

import numpy as np
import numpy.typing as npt
import pytest

from rhdlink.mqtt.motors import STEP, Wheel


def driven(target: float, seconds: float, wheel: Wheel | None = None) -> npt.NDArray[np.float64]:
    """Speed and voltage of a wheel each 5 ms, shape (n, 2)."""
    wheel = Wheel() if wheel is None else wheel
    wheel.target, wheel.is_on = target, True
    rows = []
    for number in range(round(seconds / STEP)):
        wheel.step()
        if number % 5 == 4:
            rows.append((wheel.speed, wheel.volts))
    return np.array(rows)


@pytest.mark.parametrize(
    ("target", "deviation", "volts"), [(0.045, 0.029, 0.51), (0.155, 0.021, 1.10)], ids=["left", "right"]
)
def test_wheel_drives_like_the_wheels_of_the_log(target: float, deviation: float, volts: float) -> None:
    rows = driven(target, 11.0, Wheel(Random(1)))[200:]
    assert rows[:, 0].mean() == pytest.approx(target, abs=0.002)
    assert rows[:, 1].mean() == pytest.approx(volts, abs=0.05)
    assert rows[:, 0].std() == pytest.approx(deviation, rel=0.3)


def test_wheel_starts_after_the_delay_of_the_log() -> None:
    speeds = driven(0.25, 0.3)[:, 0]
    first = 0.005 * int(np.argmax(speeds > 0.02))
    assert 0.015 <= first <= 0.035
    assert speeds[-1] == pytest.approx(0.25, abs=0.03)


def test_wheel_comes_to_rest_after_the_speed_zero() -> None:
    wheel = Wheel(Random(3))
    driven(0.155, 1.0, wheel)
    assert driven(0.0, 0.3, wheel)[-1, 0] == 0.0
    assert wheel.volts == 0.0


def test_wheel_that_is_off_does_not_move() -> None:
    wheel = Wheel(Random(4))
    wheel.target = 1.0
    for _ in range(1000):
        wheel.step()
    assert wheel.speed == 0.0


def test_moving_wheel_has_no_voltage_after_it_was_switched_off() -> None:
    wheel = Wheel()
    driven(0.3, 1.0, wheel)
    wheel.is_on = False
    wheel.step()
    assert wheel.volts == 0.0
    assert wheel.speed > 0.0


def test_wheel_drives_backward() -> None:
    assert driven(-0.2, 1.0)[-1, 0] == pytest.approx(-0.2, abs=0.01)
