"""Draw docs/images/arm.svg: a simulated arm that follows a figure of eight, and its joint positions.

The controller is stepped, so the same code gives the same bytes. The drawn positions are decoded from its real-time
packets.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _drawing import COLOURS, drawing
from numpy.typing import NDArray

import urlink
from urlink.arm.kinematics import Arm
from urlink.simulator import Controller
from urlink.simulator.robot.setpoint_sources import Setpoint

PICTURE = Path(__file__).parent / "images" / "arm.svg"

#: Time of one round of the tool, in s.
PERIOD = 8.0
#: Control cycles per second.
RATE = 500
#: Frames of one round; a browser interpolates linearly between them.
FRAMES = 80
START = (-0.3, -1.35, 1.75, -1.97, -1.57, -0.3)

Floats = NDArray[np.float64]

STYLE = """
.axis { font-size: 12px; fill: var(--faint); }
.code { font: 13px ui-monospace, monospace; }
.floor { stroke: var(--line); stroke-width: 1; }
.way { stroke: var(--faint); stroke-width: 1; stroke-dasharray: 2 4; }
.trace { stroke: #e07a1f; stroke-width: 3; }
.link { stroke: #4a7fc0; stroke-width: 13; }
.joint { fill: var(--paper); stroke: #4a7fc0; stroke-width: 3; }
.tool { fill: #e07a1f; }
.shadow { stroke: var(--line); stroke-width: 9; }
.cursor { stroke: var(--faint); stroke-width: 1; }
.past { stroke-width: 2; }
.future { stroke-width: 1; opacity: 0.35; }
"""


class Round:
    """Generator of set-points along a figure of eight, which repeats."""

    is_program = True

    def __init__(self, arm: Arm) -> None:
        pose = arm.forward(START)
        angle = np.linspace(0.0, 2.0 * math.pi, 2001)
        eight = np.zeros((len(angle), 6))
        eight[:, 1] = 0.24 * np.sin(angle)
        eight[:, 2] = 0.13 * np.sin(2.0 * angle)
        # the same speed everywhere
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(eight, axis=0), axis=1))])
        even = np.linspace(0.0, way[-1], round(PERIOD * RATE) + 1)
        poses = pose + np.stack([np.interp(even, way, column) for column in eight.T], axis=1)
        self._q = arm.inverse_path(poses, near=START)[:-1]
        self._count = 0

    def start(self, q: Sequence[float]) -> None:
        """Start at the beginning of the path, at any position of the arm."""

    def advance(self, seconds: float) -> Setpoint:
        """Return the next set-point."""
        before, now = self._q[(self._count - 1) % len(self._q)], self._q[self._count % len(self._q)]
        self._count += 1
        return Setpoint(now.tolist(), ((now - before) * RATE).tolist(), [0.0] * 6)


def recorded() -> Floats:
    """Return the joint positions of the second round, shape (FRAMES, 6), in rad."""
    controller = Controller("UR5e", "5.11", motion=Round(Arm("UR5e")))
    cycles = round(PERIOD * RATE)
    controller.step(cycles)
    rows = []
    for _ in range(FRAMES):
        controller.step(cycles // FRAMES)
        (state,) = urlink.decode(controller.realtime_packet(), interface="realtime", firmware="5.11")
        assert isinstance(state, urlink.packets.RealtimeState)
        rows.append(state.q_actual)
    return np.array(rows)


def projected(points: Floats) -> Floats:
    """Project points in space to the figure, seen from the arm's side and slightly from above."""
    turn, tilt = math.radians(52.0), math.radians(14.0)
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    right = math.sin(turn) * y - math.cos(turn) * x
    away = -math.sin(turn) * x - math.cos(turn) * y
    up = math.cos(tilt) * z + math.sin(tilt) * away
    return np.stack([130.0 + 400.0 * right, 262.0 - 400.0 * up], axis=-1)


def text_of(points: Floats) -> str:
    """Return points in the notation of SVG."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def animated(attribute: str, values: Sequence[str], is_closed: bool = True) -> str:
    """Animate an attribute through the values, and back to the first value if it `is_closed`."""
    every = ";".join([*values, values[0]] if is_closed else values)
    return f'<animate attributeName="{attribute}" dur="{PERIOD:g}s" repeatCount="indefinite" values="{every}"/>'


def arm_drawing(q: Floats) -> list[str]:
    """Draw the arm, its shadow, the path of the tool, and the latest part of the path."""
    frames = Arm("UR5e").frames(q)
    origins = frames[:, :, :3, 3]
    # the tool is drawn 4 cm long
    tip = origins[:, 6] + 0.04 * frames[:, 6, :3, 2]
    joints, tips = projected(origins), projected(tip)
    ground = projected(origins * [1.0, 1.0, 0.0])
    lines = [[[x, -0.45, 0], [x, 0.45, 0]] for x in np.linspace(-0.75, 0.15, 7)]
    lines += [[[-0.75, y, 0], [0.15, y, 0]] for y in np.linspace(-0.45, 0.45, 7)]
    floor = [f'<path class="floor" d="M{text_of(projected(np.array(line)))}"/>' for line in lines]
    way = "M" + text_of(tips).replace(" ", " L") + " Z"
    drawn = [*floor, f'<polyline class="shadow">{animated("points", [text_of(each) for each in ground])}</polyline>']
    drawn.append(f'<path class="way" d="{way}"/>')
    drawn.append(
        f'<path class="trace" pathLength="1" stroke-dasharray="0.3 0.7" d="{way}">'
        f"{animated('stroke-dashoffset', ['0.3', '-0.7'], is_closed=False)}</path>"
    )
    drawn.append(f'<polyline class="link">{animated("points", [text_of(each) for each in joints])}</polyline>')
    for number in range(1, 7):
        places = joints[:, number]
        drawn.append(
            f'<circle class="joint" r="{6 if number < 4 else 4.5}">'
            + animated("cx", [f"{x:.1f}" for x in places[:, 0]])
            + animated("cy", [f"{y:.1f}" for y in places[:, 1]])
            + "</circle>"
        )
    drawn.append(
        '<circle class="tool" r="5">'
        + animated("cx", [f"{x:.1f}" for x in tips[:, 0]])
        + animated("cy", [f"{y:.1f}" for y in tips[:, 1]])
        + "</circle>"
    )
    return drawn


def curves_drawing(q: Floats) -> list[str]:
    """Draw each joint's position over time, in a separate band, with a moving cursor."""
    left, right, top, band = 490.0, 770.0, 52.0, 38.0
    closed = np.vstack([q, q[:1]])
    x = np.linspace(left, right, len(closed))
    drawn = [f'<text class="code" x="{left:g}" y="30">state.q_actual</text>']
    drawn.append(f'<text class="axis" x="{right:g}" y="30" text-anchor="end">rad, 500 times per second</text>')
    width = animated("width", ["3", f"{right - left + 3:g}"], is_closed=False)
    drawn.append(f'<clipPath id="arm-past"><rect x="{left - 3:g}" width="3" height="320">{width}</rect></clipPath>')
    names = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
    for number, (name, colour) in enumerate(zip(names, COLOURS, strict=True)):
        column = closed[:, number]
        middle = top + band * (number + 0.5)
        scale = 0.4 * band / max(float(np.ptp(column)) / 2.0, 0.05)
        y = middle - scale * (column - (column.max() + column.min()) / 2.0)
        line = text_of(np.stack([x, y], axis=1))
        drawn.append(f'<text class="axis" x="{left - 12:g}" y="{middle + 4:g}" text-anchor="end">{name}</text>')
        drawn.append(f'<polyline class="future" stroke="{colour}" points="{line}"/>')
        drawn.append(f'<polyline class="past" clip-path="url(#arm-past)" stroke="{colour}" points="{line}"/>')
    ends = [animated(end, [f"{left:g}", f"{right:g}"], is_closed=False) for end in ("x1", "x2")]
    drawn.append(f'<line class="cursor" y1="{top:g}" y2="{top + 6 * band:g}">{"".join(ends)}</line>')
    return drawn


def main() -> None:
    """Draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=PICTURE)
    args = parser.parse_args()
    q = recorded()
    title = "A simulated UR5e draws a figure of eight; next to it are the positions of its six joints over time"
    picture = drawing("arm", 800, 320, title, STYLE, [*arm_drawing(q), *curves_drawing(q)])
    args.output.write_text(picture, encoding="utf-8")


if __name__ == "__main__":
    main()
