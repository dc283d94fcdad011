"""The directive `pressing`: the force over time of a peg that force mode presses on a plane, from the simulator.

The picture is `images/pressing.svg`. It is drawn whenever the pages are built; `python docs/_extensions/pressing.py`
draws it as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

PICTURE = Path(__file__).parents[1] / "images" / "pressing.svg"
#: N/m of the planes, and s that are drawn.
STIFFNESSES = (2_000, 20_000, 100_000)
DURATION = 1.6
PROGRAM = """
def press():
  force_mode(p[0, 0, 0, 0, 0, 0], [0, 0, 1, 0, 0, 0], [0, 0, -10, 0, 0, 0], 2, [0.1, 0.1, 0.05, 0.5, 0.5, 0.5])
  sleep(60)
end
"""


def force_over_time(stiffness: float) -> tuple[list[float], list[float], list[float]]:
    """s, N that the sensor shows, and mm of the tool below where it began."""
    from urlink.simulator import Controller, Plane, Still

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


def draw(path: Path) -> None:
    """Draw force and depth, one line for each plane; the same code gives the same bytes."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    with matplotlib.rc_context({"svg.hashsalt": "urlink", "svg.fonttype": "path", "font.size": 9}):
        figure, (force, depth) = pyplot.subplots(2, 1, figsize=(7.0, 4.2), sharex=True, layout="constrained")
        force.axhspan(9.5, 10.5, color="0.92", label="10 ± 0.5 N")
        for stiffness, colour in zip(STIFFNESSES, ("#2f855a", "#2b6cb0", "#c05621"), strict=True):
            times, forces, depths = force_over_time(stiffness)
            force.plot(times, forces, color=colour, linewidth=1.0, label=f"{stiffness / 1e3:g} kN/m")
            depth.plot(times, depths, color=colour, linewidth=1.0)
        force.set_ylabel("force at the TCP, N")
        depth.set_ylabel("tool below its start, mm")
        depth.set_xlabel("controller time, s")
        force.legend(frameon=False, ncols=2)
        for axes in (force, depth):
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
        path.parent.mkdir(exist_ok=True)
        figure.savefig(path, metadata={"Date": None})
        pyplot.close(figure)


def setup(app: Any) -> dict[str, Any]:
    """Register the directive."""
    from docutils import nodes
    from sphinx.util.docutils import SphinxDirective

    class PressingDirective(SphinxDirective):
        """The force of a peg on a plane."""

        def run(self) -> list[nodes.Node]:
            """Draw it and show it."""
            draw(PICTURE)
            text = (
                "A tool 10 mm above a plane is pressed on it with 10 N by the simulated controller, on three planes: "
                "it goes down at its limit of 0.05 m/s, touches, and settles."
            )
            image = nodes.image(uri=f"images/{PICTURE.name}", alt=text)
            return [nodes.figure("", image, nodes.caption(text, text))]

    app.add_directive("pressing", PressingDirective)
    return {"parallel_read_safe": False, "parallel_write_safe": True}


if __name__ == "__main__":
    draw(PICTURE)
