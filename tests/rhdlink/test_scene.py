"""Tape on the floor and walls: the readings of sensors, and the import of drawings."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import LinkError
from rhdlink import BadValue
from rhdlink.host.plugins.turtle import SmrTurtle
from rhdlink.host.scene import Scene, Tape
from rhdlink.host.world import World
from rhdlink.smrcl.robot_link import PluginLink


def seen(scene: Scene, *points: tuple[float, float]) -> list[float]:
    return [round(float(value), 3) for value in scene.brightness(np.array(points))]


def test_tape_has_its_brightness_and_width() -> None:
    scene = Scene([Tape(((0.0, 0.0), (1.0, 0.0)), width=0.04), Tape(((0.5, -1.0), (0.5, 1.0)), brightness=0.5)])
    assert seen(scene, (0.2, 0.0), (0.2, 0.014), (0.2, 0.1), (-0.1, 0.0)) == [0.0, 0.0, 1.0, 1.0]
    # The edge of the tape is as wide as the spot that a sensor sees.
    assert seen(scene, (0.2, 0.02)) == [0.5]
    # The tape laid last covers the others.
    assert seen(scene, (0.5, 0.0)) == [0.5]


def test_scene_accepts_a_dark_floor_with_bright_tape() -> None:
    scene = Scene([Tape(((0.0, 0.0), (1.0, 0.0)), brightness=1.0)], floor=0.2)
    assert seen(scene, (0.5, 0.0), (0.5, 0.5)) == [1.0, 0.2]


WALL = Scene(walls=[[(2.0, -1.0), (2.0, 1.0), (5.0, 1.0)]])


def test_wall_is_detected_at_its_distance() -> None:
    assert WALL.wall(0.0, 0.0, 0.0) == pytest.approx(2.0)
    assert WALL.wall(0.0, 0.0, math.pi / 4 - 0.5) == pytest.approx(2.0 / math.cos(math.pi / 4 - 0.5))
    assert WALL.wall(0.0, 0.0, math.pi) == math.inf
    assert WALL.wall(3.0, 0.0, math.pi / 2) == pytest.approx(1.0)
    assert WALL.blocked(1.0, 0.0, 2.0, 0.0) == pytest.approx(0.5)


@given(
    x=st.floats(-5, 5), y=st.floats(-5, 5), angle=st.floats(-4, 4), walls=st.integers(1, 60), seed=st.integers(0, 999)
)
@pytest.mark.property
def test_distance_to_nearest_wall_does_not_depend_on_wall_count(
    x: float, y: float, angle: float, walls: int, seed: int
) -> None:
    """Few walls are checked one by one, many walls all at once."""
    ends = np.random.default_rng(seed).uniform(-4, 4, (walls, 2, 2))
    scene = Scene(walls=[[(a[0], a[1]), (b[0], b[1])] for a, b in ends])
    nearest = min(Scene(walls=[[(a[0], a[1]), (b[0], b[1])]]).wall(x, y, angle) for a, b in ends)
    assert scene.wall(x, y, angle) == pytest.approx(nearest)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Tape(((0.0, 0.0),)),
        lambda: Tape(((0.0, 0.0), (1.0, 0.0)), width=0.0),
        lambda: Tape(((0.0, 0.0), (1.0, 0.0)), brightness=1.5),
        lambda: Tape(((0.0, 0.0), (math.nan, 0.0))),
        lambda: Scene(walls=[[(0.0, 0.0), (math.inf, 0.0)]]),
        lambda: Scene(walls=[[(0.0, float(n)) for n in range(5001)]]),
    ],
)
def test_scene_rejects_invalid_tape_and_walls(make: object) -> None:
    with pytest.raises(BadValue):
        make()  # type: ignore[operator]


# -- drawings --------------------------------------------------------------------------------------------------


def drawn(tmp_path: Path, shapes: str, box: str = "0 0 20 10") -> Scene:
    path = tmp_path / "floor.svg"
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}">{shapes}</svg>')
    return Scene.from_svg(path, size=10.0)


def points(scene: Scene) -> list[tuple[float, float]]:
    return [(round(x, 6), round(y, 6)) for x, y in scene.tapes[0].points]


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        ('<line x1="2" y1="2" x2="4" y2="2"/>', [(1, 4), (2, 4)]),
        ('<polyline points="2,2 4,2 4 4"/>', [(1, 4), (2, 4), (2, 3)]),
        ('<polygon points="2,2 4,2 4,4"/>', [(1, 4), (2, 4), (2, 3), (1, 4)]),
        ('<rect x="2" y="2" width="2" height="2"/>', [(1, 4), (2, 4), (2, 3), (1, 3), (1, 4)]),
        ('<path d="M2 2 H4 V4 L2,4 Z"/>', [(1, 4), (2, 4), (2, 3), (1, 3), (1, 4)]),
        ('<path d="m2 2 h2 v2 l-2 0 z"/>', [(1, 4), (2, 4), (2, 3), (1, 3), (1, 4)]),
        ('<path d="M2 2 4 2 4 4"/>', [(1, 4), (2, 4), (2, 3)]),
        ('<g><g><line x1="2" y1="2" x2="4" y2="2"/></g></g>', [(1, 4), (2, 4)]),
    ],
)
def test_svg_shapes_become_tape_in_metres(tmp_path: Path, shape: str, expected: list[tuple[float, float]]) -> None:
    """The view box becomes the world: a width of 20 becomes 10 m, and y points up from the lower edge."""
    assert points(drawn(tmp_path, shape)) == expected


def test_curves_become_straight_segments(tmp_path: Path) -> None:
    scene = drawn(tmp_path, '<circle cx="10" cy="5" r="2"/>')
    assert all(math.hypot(x - 5.0, y - 2.5) == pytest.approx(1.0) for x, y in scene.tapes[0].points)
    scene = drawn(tmp_path, '<path d="M0 10 C0 6, 4 2, 8 2"/>')
    assert points(scene)[0] == (0, 0)
    assert points(scene)[-1] == (4, 4)
    assert len(scene.tapes[0].points) > 10


def test_svg_strokes_define_tape_width_brightness_and_walls(tmp_path: Path) -> None:
    scene = drawn(
        tmp_path,
        '<line x1="0" y1="0" x2="9" y2="0" stroke="#fff" stroke-width="0.2"/>'
        '<line x1="0" y1="5" x2="9" y2="5" style="stroke: black; stroke-width: 0.1px"/>'
        '<line class="high wall" x1="0" y1="1" x2="9" y2="1"/>',
    )
    assert [(tape.width, tape.brightness) for tape in scene.tapes] == [(0.1, 1.0), (0.05, 0.0)]
    assert scene.walls == (((0.0, 4.5), (4.5, 4.5)),)


@pytest.mark.parametrize(
    ("shapes", "box", "said"),
    [
        ('<path d="M0 0 A1 1 0 0 0 2 2"/>', "0 0 9 9", "the command A"),
        ('<path d="M0 0 L1"/>', "0 0 9 9", "ends within the command L"),
        ('<path d="7 7"/>', "0 0 9 9", "contains numbers instead of a command"),
        ('<line x1="a"/>', "0 0 9 9", "x1"),
        ("", "0 0 0 9", "no width"),
        ("<line", "0 0 9 9", "invalid XML"),
        ('<path d="' + "M0 0 L1 1 " * 3000 + '"/>', "0 0 9 9", "the maximum is 5000"),
    ],
)
def test_invalid_drawing_raises_the_reason(tmp_path: Path, shapes: str, box: str, said: str) -> None:
    with pytest.raises(BadValue, match=said):
        drawn(tmp_path, shapes, box)


def test_file_that_is_not_an_svg_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "page.svg"
    path.write_text("<html/>")
    with pytest.raises(BadValue, match="must be <svg>"):
        Scene.from_svg(path)
    with pytest.raises(BadValue, match="No such file"):
        Scene.from_svg(tmp_path / "none.svg")


@given(
    data=st.text('MmLlHhVvCcQqZz0123456789.-, "<>/', max_size=60),
    tag=st.sampled_from(["path", "line", "polyline", "rect"]),
)
@pytest.mark.property
def test_any_drawing_is_a_scene_or_an_error(tmp_path_factory: pytest.TempPathFactory, data: str, tag: str) -> None:
    path = tmp_path_factory.getbasetemp() / "any.svg"
    path.write_text(f'<svg viewBox="0 0 9 9"><{tag} d="{data}" points="{data}" x1="{data}" width="{data}"/></svg>')
    with contextlib.suppress(LinkError):
        Scene.from_svg(path)


# -- a robot in a scene ----------------------------------------------------------------------------------------


def test_turtle_detects_the_line_on_its_left() -> None:
    """The sensors are numbered from the right, 2 cm apart."""
    robot = SmrTurtle(World(11.0, (5.0, 5.0, 0.0), Scene([Tape(((0.0, 5.03), (11.0, 5.03)))])))
    PluginLink([robot])
    brightness = robot.linesensor.tolist()
    assert len(brightness) == 8
    assert brightness.index(min(brightness)) == 5
    assert (min(brightness), max(brightness)) == (25, 230)


def test_turtle_stops_in_front_of_a_wall() -> None:
    world = World(11.0, (5.0, 5.0, 0.0), Scene(walls=[[(6.0, 4.0), (6.0, 6.0)]]))
    robot = SmrTurtle(world)
    link = PluginLink([robot])
    for _ in range(300):
        link.exchange({"speedl": [50], "speedr": [50]})
    assert world.pose.x == pytest.approx(6.0, abs=0.001)
    assert world.pose.x < 6.0
    assert world.blocked > 0
    assert robot.irsensor[2] == 255  # the nearest distance that the sensor can report
