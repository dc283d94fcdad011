"""The way of a robot as a picture: SVG from here, PNG where matplotlib is installed."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from linkcore.errors import BadValue

from .world import World

__all__ = ["save", "svg"]

_PIXELS = 480.0
_MARGIN = 24.0
_PAPER, _WALL, _GRID, _PATH, _ROBOT = "#ffffff", "#37474f", "#eceff1", "#1565c0", "#c62828"


def svg(world: World, title: str = "") -> str:
    """The square, the way and the robot as an SVG document; a grid line each metre.

    The same way gives the same text, so that a picture can be compared and kept under version control.
    """
    scale = _PIXELS / world.size
    whole = _PIXELS + 2 * _MARGIN

    def place(x: float, y: float) -> str:
        return f"{_MARGIN + x * scale:.1f},{_MARGIN + (world.size - y) * scale:.1f}"

    # A grid of more lines than pixels shows nothing.
    step = 10.0 ** max(math.ceil(math.log10(world.size / 50.0)), 0)
    marks = np.arange(0.0, world.size, step)[1:]
    lines = "".join(
        f"M{place(mark, 0)}L{place(mark, world.size)}M{place(0, mark)}L{place(world.size, mark)}" for mark in marks
    )
    points = " ".join(place(x, y) for x, y in world.path)
    x, y, theta = world.pose
    nose, arm = 14.0 / scale, 2.5
    corners = " ".join(
        place(x + nose * math.cos(theta + turn) * size, y + nose * math.sin(theta + turn) * size)
        for turn, size in ((0.0, 1.0), (arm, 0.7), (-arm, 0.7))
    )
    caption = f"<title>{_escaped(title)}</title>" if title else ""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {whole:g} {whole:g}" width="{whole:g}" '
        f'height="{whole:g}">{caption}\n'
        f'<rect width="{whole:g}" height="{whole:g}" fill="{_PAPER}"/>\n'
        f'<path d="{lines}" stroke="{_GRID}" fill="none"/>\n'
        f'<rect x="{_MARGIN:g}" y="{_MARGIN:g}" width="{_PIXELS:g}" height="{_PIXELS:g}" fill="none" '
        f'stroke="{_WALL}" stroke-width="3"/>\n'
        f"{_scene(world, place, scale)}"
        f'<polyline points="{points}" fill="none" stroke="{_PATH}" stroke-width="2" stroke-linejoin="round"/>\n'
        f'<polygon points="{corners}" fill="{_ROBOT}"/>\n'
        "</svg>\n"
    )


def _scene(world: World, place: Callable[[float, float], str], scale: float) -> str:
    """The tape and the walls, if there are any."""
    if world.scene is None:
        return ""
    lines = []
    for tape in world.scene.tapes:
        points = " ".join(place(x, y) for x, y in tape.points)
        shade = "#" + 3 * f"{round(255 * tape.brightness):02x}"
        width = max(tape.width * scale, 0.5)
        lines.append(f'<polyline points="{points}" fill="none" stroke="{shade}" stroke-width="{width:.1f}"/>\n')
    for wall in world.scene.walls:
        points = " ".join(place(x, y) for x, y in wall)
        lines.append(f'<polyline points="{points}" fill="none" stroke="{_WALL}" stroke-width="3"/>\n')
    return "".join(lines)


def save(world: World, path: str | os.PathLike[str], title: str = "") -> None:
    """Write the picture to a file, in the format that its suffix names: ``.svg`` or ``.png``.

    Raises:
        BadValue: another suffix, a PNG without matplotlib, or a file that cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        if suffix == ".svg":
            path.write_text(svg(world, title), encoding="utf-8")
        elif suffix == ".png":
            _save_png(world, path, title)
        else:
            raise BadValue(f"{path}: a picture is an .svg or a .png")
    except OSError as error:
        raise BadValue(f"cannot write {path}: {error.strerror or error}") from error


def _save_png(world: World, path: Path, title: str) -> None:
    try:
        # Not pyplot: it would choose a window system for the whole program.
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise BadValue(f"{path}: a PNG needs matplotlib (pip install matplotlib); an .svg does not") from None
    figure = Figure(figsize=(5.3, 5.3), dpi=100)
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set(xlim=(0, world.size), ylim=(0, world.size), aspect="equal", xlabel="x [m]", ylabel="y [m]", title=title)
    axes.grid(color=_GRID)
    for tape in world.scene.tapes if world.scene is not None else ():
        axes.plot(*zip(*tape.points, strict=True), color=str(tape.brightness), linewidth=2.0)
    for wall in world.scene.walls if world.scene is not None else ():
        axes.plot(*zip(*wall, strict=True), color=_WALL, linewidth=2.0)
    axes.plot(*world.path.T, color=_PATH)
    x, y, theta = world.pose
    axes.plot(x, y, marker=(3, 0, math.degrees(theta) - 90.0), markersize=14, color=_ROBOT)
    figure.savefig(path)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")
