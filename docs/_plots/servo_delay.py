"""How far an arm is from where it should be, without and with its delay made up for.

A program leads the arm by `servoj` to what is in the registers, and a loop writes them once a cycle, from each state,
as `servo(link="rtde")` does. The delay is measured as `Servo.measure_delay` measures it.
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
#: The wave that is followed: rad of wrist 3, s of one turn, and s that are drawn.
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
    """A simulated arm that goes where the registers say, cycle by cycle."""

    def __init__(self) -> None:
        self.controller = Controller("UR5e", "5.11", motion=Still())
        self.home = list(self.controller.arm.setpoint.q)
        self.send(self.home)
        self.controller.take(PROGRAM)
        self.controller.step(10)

    def send(self, q: list[float]) -> None:
        """Where to, from the next cycle on."""
        self.controller.registers.inputs.floats[:6] = q

    def states(self) -> Iterator[RealtimeState]:
        """One for each cycle, without end."""
        while True:
            self.controller.step()
            (state,) = urlink.decode(self.controller.realtime_packet(), "realtime")
            assert isinstance(state, RealtimeState)
            yield state


def desired(time: float) -> float:
    """Rad of wrist 3 from where it begins."""
    return 0.5 * AMPLITUDE * (1.0 - math.cos(math.tau * max(time, 0.0) / PERIOD))


def errors(ahead: float) -> tuple[list[float], list[float], list[float]]:
    """s, rad that were desired, and desired minus actual, of a loop that sends what is to be `ahead` s later."""
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
    """What is desired, and how far off the arm is both times."""
    led = Led()
    delay = measure(led.states(), led.send, joint=5, amplitude=0.05, duration=0.5)
    times, wanted, before = errors(0.0)
    after = errors(delay)[2]
    # The arm begins to move with what it is told first, so the first moments are not those of a loop that runs.
    settled = np.array(times) > 0.2
    worst = [float(1e3 * np.abs(np.array(off)[settled]).max()) for off in (before, after)]
    position, error = figure.subplots(2, 1, sharex=True)
    position.plot(times, wanted, color="black")
    error.plot(times, 1e3 * np.array(before), color="#c05621", label=f"as it is: up to {worst[0]:.1f} mrad")
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
