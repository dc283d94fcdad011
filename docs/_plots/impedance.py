"""An arm on springs: how it yields to a push, and how it follows targets that arrive 10 times per second."""

from __future__ import annotations

from collections.abc import Callable

from matplotlib.figure import Figure

from urlink.arm.models import model
from urlink.protocol.firmware import Firmware
from urlink.script.links import FOLLOW, InputRegisters
from urlink.script.springs import Springs, impedance
from urlink.script.wrapping import program
from urlink.simulator import Controller, Still

SIZE = (7.0, 4.6)
#: Fractions of the vendor's stiffness; force of the push, in N; its start and end, and the duration, in s.
PARTS, FORCE, BEGINS, ENDS, DURATION = (1.0, 0.5, 0.25), 15.0, 0.1, 0.9, 1.8
#: Times at which targets arrive, in s (two are missing); speed of the targets, in rad/s.
TIMES, SPEED = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.9, 1.0, 1.1, 1.2, 1.3), 0.2
LINK = InputRegisters(36, 44, 1)


def run(part: float, act: Callable[[Controller, float], float]) -> tuple[list[float], list[list[float]]]:
    """Return times (s) and joint positions (rad) of an arm on springs.

    `act` returns the target of the base joint.
    """
    arm = model("UR5e")
    controller = Controller(arm.name, "5.25", motion=Still())
    controller.step()
    low, high = arm.position_limits.T.tolist()
    springs = Springs(
        stiffness=[part * each for each in (1000.0, 1000.0, 500.0, 100.0, 100.0, 100.0)],
        damping=[1.0] * 6,
        speed=[1.0] * 6,
        torque=[28.0, 28.0, 14.0, 4.5, 4.5, 4.5],
        braking=[112.0, 112.0, 56.0, 18.0, 18.0, 18.0],
        error=[0.2] * 6,
        lowest=low,
        highest=high,
        friction_compensation=True,
        watchdog=0.5,
    )
    controller.take(program("springs", impedance(Firmware(5, 25), LINK, springs)).text)
    inputs, number, target = controller.registers.inputs, 0, 0.0
    begin, times, places = controller.arm.setpoint.q, [], []
    for cycle in range(round(DURATION * 500)):
        wanted = act(controller, cycle / 500)
        number, target = number + (wanted != target), wanted
        values = [begin[0] + target, *begin[1:], number, 0.0, 0.0, 0.0, 0.0, 0.0]
        for at, value in enumerate(values):
            inputs.floats[LINK.first_float + at] = value
        inputs.integers[LINK.date], inputs.integers[LINK.message] = round(controller.time * 500), cycle + 1
        inputs.integers[LINK.mode], inputs.integers[LINK.proof] = FOLLOW, LINK.token
        controller._state.watchdogs.clear()  # the watchdog of the controller itself, which RTDE feeds
        controller.step()
        times.append(cycle / 500)
        places.append([a - b for a, b in zip(controller.arm.setpoint.q, begin, strict=True)])
    return times, places


def pushed(controller: Controller, time: float) -> float:
    """Push the arm to the side, and return the same target."""
    controller.push([0.0, -FORCE if BEGINS <= time < ENDS else 0.0, 0.0, 0.0, 0.0, 0.0])
    return 0.0


def led(controller: Controller, time: float) -> float:
    """Return the newest target."""
    return max((SPEED * each for each in TIMES if each <= time), default=0.0)


def draw(figure: Figure) -> str:
    """Plot the push above, and the targets below."""
    push, follow = figure.subplots(2, 1, sharex=True)
    push.axvspan(BEGINS, ENDS, color="0.92", label=f"a push of {FORCE:g} N")
    for part, colour in zip(PARTS, ("#2f855a", "#2b6cb0", "#c05621"), strict=True):
        times, places = run(part, pushed)
        push.plot(times, [1e3 * place[0] for place in places], color=colour, label=f"{1000 * part:g} Nm/rad")
    push.set_ylabel("base, mrad")
    push.legend()
    times, places = run(1.0, led)
    ends = zip(TIMES, (*TIMES[1:], DURATION), strict=True)
    for begin, end in ends:
        follow.plot([begin, end], [1e3 * SPEED * begin] * 2, color="0.5", linewidth=1.0)
    follow.plot(times, [1e3 * place[0] for place in places], color="#2b6cb0")
    follow.set(ylabel="base, mrad", xlabel="controller time, s")
    return (
        "Above: a push to the side of a simulated UR5e, with three stiffnesses. Below: targets that arrive 10 times "
        "per second (grey; two are missing), and the arm. The arm follows about one interval later, without steps."
    )
