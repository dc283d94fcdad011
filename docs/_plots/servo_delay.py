"""Error of an arm that follows set-points, without and with compensation of its delay.

A program moves the arm with `servoj` to the positions in the registers. A loop writes the registers once per cycle,
after each state, like `servo(link="rtde")`. The delay is measured in the same way as in `Servo.measure_delay`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

import urlink
from urlink.motion.servo.servo_delay import measure
from urlink.protocol.realtime.packets import RealtimeState
from urlink.simulator import Controller, Still

SIZE = (7.0, 4.2)
#: Amplitude of the wave of wrist 3, in rad; its period, and the duration of the plot, in s.
AMPLITUDE, PERIOD, DURATION = 0.3, 2.0, 3.0
LED = ", ".join(f"read_input_float_register({number})" for number in range(6))
PROGRAM = f"""
def follow():
  while True:
    servoj([{LED}], t=0.002, lookahead_time=0.03, gain=300)
  end
end
"""


class Led:
    """Simulated arm that follows the registers, cycle by cycle."""

    def __init__(self) -> None:
        self.controller = Controller("UR5e", "5.11", motion=Still())
        self.home = list(self.controller.arm.setpoint.q)
        self.send(self.home)
        self.controller.take(PROGRAM)
        self.controller.step(10)

    def send(self, q: list[float]) -> None:
        """Set the position for the next cycles."""
        self.controller.registers.inputs.floats[:6] = q

    def states(self) -> Iterator[RealtimeState]:
        """Yield one state for each cycle, endlessly."""
        while True:
            self.controller.step()
            (state,) = urlink.decode(self.controller.realtime_packet(), "realtime")
            assert isinstance(state, RealtimeState)
            yield state


def desired(time: float) -> float:
    """Return the desired position of wrist 3 relative to its start, in rad."""
    return 0.5 * AMPLITUDE * (1.0 - math.cos(math.tau * max(time, 0.0) / PERIOD))


def errors(ahead: float) -> tuple[list[float], list[float], list[float]]:
    """Return times (s), desired positions (rad), and desired minus actual position.

    The loop sends the position that is desired `ahead` seconds later.
    """
    led = Led()
    times, wanted, off = [], [], []
    start = None
    for state in led.states():
        start = state.time if start is None else start
        time = state.time - start
        if time > DURATION:
            return times, wanted, off
        times.append(time)
        wanted.append(desired(time))
        off.append(wanted[-1] - (float(state.q_actual[5]) - led.home[5]))
        led.send([*led.home[:5], led.home[5] + desired(time + ahead)])
    raise AssertionError("states have no end")


def draw(figure: Figure) -> str:
    """Plot the desired position, and both errors of the arm."""
    led = Led()
    delay = measure(led.states(), led.send, joint=5, amplitude=0.05, duration=0.5)
    times, wanted, before = errors(0.0)
    after = errors(delay)[2]
    # The arm starts to move at the first set-point, so the first moments do not represent a running loop.
    settled = np.array(times) > 0.2
    worst = [float(1e3 * np.abs(np.array(off)[settled]).max()) for off in (before, after)]
    position, error = figure.subplots(2, 1, sharex=True)
    position.plot(times, wanted, color="black")
    error.plot(times, 1e3 * np.array(before), color="#c05621", label=f"uncompensated: up to {worst[0]:.1f} mrad")
    error.plot(
        times, 1e3 * np.array(after), color="#2b6cb0", label=f"{1e3 * delay:.1f} ms ahead: up to {worst[1]:.2f} mrad"
    )
    position.set_ylabel("wrist 3, desired, rad")
    error.set(ylabel="desired − actual, mrad", xlabel="controller time, s")
    error.legend(loc="lower right")
    return (
        f"A simulated UR5e follows a wave of wrist 3. The measured delay is {1e3 * delay:.1f} ms. The largest error is "
        f"{worst[0]:.1f} mrad. If the set-points are computed for a time that is later by the delay, it is "
        f"{worst[1]:.2f} mrad."
    )
