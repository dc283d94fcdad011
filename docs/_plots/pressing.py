"""Force over time of a peg that force mode presses on a plane."""

from __future__ import annotations

from matplotlib.figure import Figure

from urlink.simulator import Controller, Plane, Still

SIZE = (7.0, 4.2)
#: Stiffnesses of the planes, in N/m; duration of the plot, in s.
STIFFNESSES = (2_000, 20_000, 100_000)
DURATION = 1.6
PROGRAM = """
def press():
  force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2, [0.1, 0.1, 0.05, 0.5, 0.5, 0.5])
  sleep(60)
end
"""


def force_over_time(stiffness: float) -> tuple[list[float], list[float], list[float]]:
    """Return times (s), force of the sensor (N), and depth of the tool below its start (mm)."""
    controller = Controller("UR5e", "5.11", motion=Still())
    controller.step()
    x, y, z = controller.arm.sample.pose_target[:3]
    controller.world.add(Plane((x, y, z - 0.01), stiffness=stiffness))
    controller.take(PROGRAM)
    times, forces, depths = [], [], []
    for cycle in range(round(DURATION * controller.firmware.rate)):
        controller.step()
        times.append(cycle / controller.firmware.rate)
        forces.append(controller.arm.sample.force[2])
        depths.append(1e3 * (z - controller.arm.sample.pose_target[2]))
    return times, forces, depths


def draw(figure: Figure) -> str:
    """Plot force and depth, one line for each plane."""
    force, depth = figure.subplots(2, 1, sharex=True)
    force.axhspan(9.5, 10.5, color="0.92", label="10 ± 0.5 N")
    for stiffness, colour in zip(STIFFNESSES, ("#2f855a", "#2b6cb0", "#c05621"), strict=True):
        times, forces, depths = force_over_time(stiffness)
        force.plot(times, forces, color=colour, label=f"{stiffness / 1e3:g} kN/m")
        depth.plot(times, depths, color=colour)
    force.set_ylabel("force at the TCP, N")
    depth.set(ylabel="tool below its start, mm", xlabel="controller time, s")
    force.legend(ncols=2)
    return (
        "The simulated controller presses a tool with 10 N on three planes. The tool starts 10 mm above the plane, "
        "moves down at its limit of 0.05 m/s, touches the plane, and settles."
    )
