"""A gripper that closes on an object and opens again, and its replies during that."""

from __future__ import annotations

from matplotlib.figure import Figure

from urlink.packets import ObjectStatus
from urlink.protocol.gripper.protocol import get_line, set_line, value_of
from urlink.simulator import Controller, Still

SIZE = (7.0, 4.2)
#: Times at which the lines are sent, in s; width of the object, in m; duration of the plot, in s.
LINES = {0.2: {"POS": 255, "SPE": 100, "FOR": 50, "GTO": 1}, 1.6: {"POS": 0, "SPE": 255}}
WIDTH, DURATION = 0.05, 2.6


def draw(figure: Figure) -> str:
    """Plot position, object detection, and current of the fingers."""
    controller = Controller("UR5e", "5.11", motion=Still())
    gripper, rate = controller.gripper, controller.firmware.rate
    gripper.reply(set_line({"ACT": 1}))
    while not gripper.is_active:
        controller.step()
    gripper.place(WIDTH)
    times: list[float] = []
    seen: dict[str, list[int]] = {name: [] for name in ("PRE", "POS", "OBJ", "COU")}
    for cycle in range(round(DURATION * rate)):
        if cycle in (round(time * rate) for time in LINES):
            gripper.reply(set_line(LINES[cycle / rate]))
        controller.step()
        times.append(cycle / rate)
        for name, values in seen.items():
            value = value_of(name, gripper.reply(get_line(name)) or "")
            assert value is not None
            values.append(value)
    position, stopped, current = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 1))
    position.plot(times, seen["PRE"], color="0.6", linestyle="--", label="requested")
    position.plot(times, seen["POS"], color="#2b6cb0", label="fingers")
    position.set(ylabel="position")
    position.legend(loc="upper right")
    stopped.step(times, seen["OBJ"], color="#c05621", where="post")
    stopped.set_yticks([each.value for each in ObjectStatus], [each.name for each in ObjectStatus], fontsize=7)
    current.step(times, [10 * value for value in seen["COU"]], color="#2f855a", where="post")
    current.set(ylabel="mA", xlabel="controller time, s")
    held = seen["POS"][round(1.5 * rate)]
    return (
        f"The simulated gripper closes on an object of {1e3 * WIDTH:g} mm, and opens again. The lines are the answers "
        f"of its port for PRE, POS, OBJ and COU. The fingers stop at {held} instead of 255; OBJ shows the reason."
    )
