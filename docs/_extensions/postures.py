"""The directive `postures`: the eight ways in which an arm reaches one pose, drawn from `Arm.branches`.

The picture is `images/postures.svg`. It is drawn whenever the pages are built; `python docs/_extensions/postures.py`
draws it as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

PICTURE = Path(__file__).parents[1] / "images" / "postures.svg"
MODEL = "UR5e"
POSTURE = (0.3, -1.5, 1.8, -1.2, 1.1, 0.3)


def draw(path: Path) -> None:
    """Draw the arm as its axes and links, once for each way; the same code gives the same bytes."""
    import matplotlib

    matplotlib.use("svg")
    import numpy as np
    from matplotlib import pyplot

    from urlink.kinematics import Arm

    arm = Arm(MODEL)
    pose = arm.forward(POSTURE)
    # One drawing for each number; the shoulder decides the row.
    with matplotlib.rc_context({"svg.hashsalt": "urlink", "svg.fonttype": "path", "font.size": 8}):
        figure, plots = pyplot.subplots(2, 4, figsize=(9.0, 4.8), subplot_kw={"projection": "3d"})
        for number, (axes, q) in enumerate(zip(plots.flat, arm.branches(pose), strict=True)):
            points = corners(arm, q)
            axes.plot(*points.T, color="#2b6cb0", linewidth=2.5, solid_joinstyle="round")
            axes.scatter(*arm.frames(q)[:6, :3, 3].T, color="#1a365d", s=12, depthshade=False)
            # The flange: where all eight are the same.
            flange = arm.frames(q)[6]
            for column, colour in enumerate(("#c53030", "#2f855a", "#2c5282")):
                tip = flange[:3, 3] + 0.15 * flange[:3, column]
                axes.plot(*np.stack([flange[:3, 3], tip]).T, color=colour, linewidth=1.5)
            wrist, elbow = "+" if q[4] > 0 else "\u2212", "+" if q[2] > 0 else "\u2212"
            axes.set_title(f"{number}: q5 {wrist}, q3 {elbow}", pad=-2)
            axes.set(xlim=(-0.65, 0.35), ylim=(-0.5, 0.5), zlim=(0.0, 1.0), box_aspect=(1, 1, 1))
            axes.set(xticklabels=[], yticklabels=[], zticklabels=[])
            axes.view_init(elev=18, azim=-55)
        figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.94, wspace=0.0, hspace=0.08)
        path.parent.mkdir(exist_ok=True)
        figure.savefig(path, metadata={"Date": None})
        pyplot.close(figure)


def corners(arm: Any, q: Any) -> Any:
    """The line along the links: from joint to joint, at the end of each link's offset."""
    import numpy as np

    frames = arm.frames(q)
    d = arm.model.dh_d
    line = [frames[0][:3, 3]]
    for i in range(6):
        # Along the joint's axis first, then along the link.
        line.append(frames[i][:3, 3] + d[i] * frames[i][:3, 2])
        line.append(frames[i + 1][:3, 3])
    return np.array(line)


def setup(app: Any) -> dict[str, Any]:
    """Register the directive."""
    from docutils import nodes
    from sphinx.util.docutils import SphinxDirective

    class PosturesDirective(SphinxDirective):
        """The eight ways to reach one pose."""

        def run(self) -> list[nodes.Node]:
            """Draw them and show them."""
            draw(PICTURE)
            text = f"The eight ways in which a {MODEL} brings its flange to the same pose, by the row of Arm.branches."
            image = nodes.image(uri=f"images/{PICTURE.name}", alt=text)
            return [nodes.figure("", image, nodes.caption(text, text))]

    app.add_directive("postures", PosturesDirective)
    return {"parallel_read_safe": False, "parallel_write_safe": True}


if __name__ == "__main__":
    draw(PICTURE)
