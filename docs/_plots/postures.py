"""The eight postures in which an arm reaches the same pose, from `Arm.branches`."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from urlink.arm.kinematics import Arm

SIZE = (9.0, 4.8)
MODEL = "UR5e"
POSTURE = (0.3, -1.5, 1.8, -1.2, 1.1, 0.3)


def corners(arm: Arm, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the line along the links, from joint to joint, at the end of each link's offset."""
    frames = arm.frames(q)
    line = [frames[0][:3, 3]]
    for i, offset in enumerate(arm.model.dh_d):
        # first along the axis of the joint, then along the link
        line.append(frames[i][:3, 3] + offset * frames[i][:3, 2])
        line.append(frames[i + 1][:3, 3])
    return np.array(line)


def draw(figure: Figure) -> str:
    """Plot axes and links of the arm once for each posture; the shoulder determines the row."""
    arm = Arm(MODEL)
    figure.set_layout_engine(None)
    plots = figure.subplots(2, 4, subplot_kw={"projection": "3d"})
    for number, (axes, q) in enumerate(zip(plots.flat, arm.branches(arm.forward(POSTURE)), strict=True)):
        axes.plot(*corners(arm, q).T, color="#2b6cb0", linewidth=2.5, solid_joinstyle="round")
        axes.scatter(*arm.frames(q)[:6, :3, 3].T, color="#1a365d", s=12, depthshade=False)
        # the flange, whose pose is the same in all eight postures
        flange = arm.frames(q)[6]
        for column, colour in enumerate(("#c53030", "#2f855a", "#2c5282")):
            tip = flange[:3, 3] + 0.15 * flange[:3, column]
            axes.plot(*np.stack([flange[:3, 3], tip]).T, color=colour, linewidth=1.5)
        wrist, elbow = "+" if q[4] > 0 else "\u2212", "+" if q[2] > 0 else "\u2212"
        axes.set_title(f"{number}: q5 {wrist}, q3 {elbow}", pad=-2, fontsize=9)
        axes.set(xlim=(-0.65, 0.35), ylim=(-0.5, 0.5), zlim=(0.0, 1.0), box_aspect=(1, 1, 1))
        axes.set(xticklabels=[], yticklabels=[], zticklabels=[])
        axes.view_init(elev=18, azim=-55)
    figure.subplots_adjust(left=0.0, right=1.0, bottom=0.0, top=0.94, wspace=0.0, hspace=0.08)
    return f"The eight postures in which a {MODEL} brings its flange to the same pose, in the order of Arm.branches."
