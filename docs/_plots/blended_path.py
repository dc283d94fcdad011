"""A path of several segments with blends: position of the tool, and its speed in each segment."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

import urlink
from urlink.motion.moves.path import Linear, Rates, plan
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.commands import segment
from urlink.simulator import Controller, Still

SIZE = (8.0, 3.2)
COLOURS = ("#2b6cb0", "#c05621", "#2f855a", "#805ad5")
#: Distance from the tool in the plane of y and z, in m; blend, in m; speed, in m/s.
WAYPOINTS = (((0.0, 0.1), 0.03, None), ((0.15, 0.1), 0.05, 0.1), ((0.15, 0.0), 0.0, None), ((0.0, 0.0), 0.0, None))
SPEED, ACCELERATION = 0.25, 1.2


def followed() -> tuple[NDArray[np.float64], NDArray[np.int_], float]:
    """Return the path of the tool.

    Returns:
        y and z in each cycle, shape (n, 2), in m; next waypoint in each cycle, shape (n,); length of a cycle, in s.
    """
    controller = Controller("UR5e", "5.11", motion=Still())
    controller.step()
    (state,) = urlink.decode(controller.realtime_packet(), "realtime")
    assert isinstance(state, RealtimeState)
    start = np.array(controller.arm.sample.pose_target)
    waypoints = [
        Linear(start + np.array([0, y, z, 0, 0, 0]), blend=blend, speed=speed) for (y, z), blend, speed in WAYPOINTS
    ]
    body = plan(waypoints, Rates(1.0, 1.4), Rates(SPEED, ACCELERATION), controller.arm.kinematics, state).body
    # At the start of each segment, let the program write the number of the segment to a register.
    number = 0
    for at, line in enumerate(body):
        if line == segment(number):
            body[at] = f"write_output_integer_register(0, {number})"
            number += 1
    controller.take("\n".join(["def path():", *body, "end", ""]))
    places, segments = [start[1:3]], [0]
    controller.step()
    while controller.program_name is not None:
        controller.step()
        places.append(np.array(controller.arm.sample.pose_target[1:3]))
        segments.append(controller.registers.outputs.integers[0])
    return np.array(places) - start[1:3], np.array(segments), 1.0 / controller.firmware.rate


def draw(figure: Figure) -> str:
    """Plot the path of the tool from waypoint to waypoint, and its speed."""
    places, segments, cycle = followed()
    times = cycle * np.arange(len(places))
    speeds = np.linalg.norm(np.diff(places, axis=0, append=places[-1:]), axis=1) / cycle
    way, speed = figure.subplots(1, 2, width_ratios=(2, 3))
    corners = np.array([(0.0, 0.0), *(place for place, _, _ in WAYPOINTS)])
    way.plot(*corners.T, color="0.7", linestyle="--")
    for number, ((place, blend, own), colour) in enumerate(zip(WAYPOINTS, COLOURS, strict=True)):
        mine = np.flatnonzero(segments == number)
        way.plot(*places[mine[0] : mine[-1] + 2].T, color=colour, linewidth=2.0)
        way.add_patch(Circle(place, blend, fill=False, color="0.7"))
        way.annotate(f"{number}", place, (4, 4), textcoords="offset points")
        speed.plot(times[mine[0] : mine[-1] + 1], speeds[mine[0] : mine[-1] + 1], color=colour)
        speed.hlines(own or SPEED, times[mine[0]], times[mine[-1]], color=colour, linestyle=":")
    way.set(xlabel="y, m", ylabel="z, m", aspect="equal")
    speed.set(xlabel="controller time, s", ylabel="speed of the tool, m/s", ylim=(0.0, None))
    blends = " and ".join(f"{1e3 * blend:g} mm" for _, blend, _ in WAYPOINTS if blend)
    return (
        f"A path of {len(WAYPOINTS)} lines on a simulated UR5e, with blends of {blends} at waypoints 0 and 1. Each "
        "segment has its own colour, and begins with the blend before it. The arm stops only at waypoints without a "
        f"blend. The dotted lines are the commanded speeds. The path takes {times[-1]:.1f} s."
    )
