"""The world: the midpoint step, the walls, the path and its plots."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from rhdlink.host.world import Moved, Pose, World, save, svg


def test_world_starts_in_the_middle() -> None:
    world = World()
    assert world.pose == (5.5, 5.5, 0.0)
    assert world.odometry == (0.0, 0.0, 0.0)
    assert world.path.tolist() == [[5.5, 5.5]]


def test_step_moves_along_the_mean_heading() -> None:
    world = World()
    assert world.step(1.0, math.pi / 2, 1.0) == Moved(1.0, math.pi / 2, False)
    assert world.odometry == pytest.approx((math.sqrt(0.5), math.sqrt(0.5), math.pi / 2))


def test_heading_is_not_wrapped() -> None:
    world = World()
    for _ in range(8):
        world.step(0.0, math.pi / 2, 1.0)
    assert world.pose.theta == pytest.approx(4 * math.pi)


@pytest.mark.parametrize(
    ("theta", "end"), [(0.0, (11.0, 5.5)), (math.pi / 2, (5.5, 11.0)), (math.pi, (0.0, 5.5)), (-math.pi / 2, (5.5, 0))]
)
def test_wall_stops_the_robot_but_lets_it_turn(theta: float, end: tuple[float, float]) -> None:
    world = World(start=(5.5, 5.5, theta))
    assert not world.step(5.0, 0.0, 1.0).is_blocked
    assert world.step(1.0, 0.0, 1.0) == pytest.approx((0.5, 0.0, 1.0))
    assert world.pose[:2] == pytest.approx(end)
    assert world.step(1.0, 0.0, 1.0) == pytest.approx((0.0, 0.0, 1.0), abs=1e-12)
    assert world.step(0.0, math.pi, 1.0) == Moved(0.0, math.pi, False)
    assert world.step(1.0, 0.0, 1.0).distance == 1.0
    assert world.blocked == 2


def test_robot_does_not_slide_along_a_wall() -> None:
    world = World(start=(10.5, 1.0, math.pi / 4))
    assert world.step(2.0, 0.0, 1.0).distance == pytest.approx(0.5 * math.sqrt(2))
    assert world.pose[:2] == pytest.approx((11.0, 1.5))


def test_robot_can_drive_along_a_wall() -> None:
    world = World(start=(11.0, 1.0, math.pi / 2))
    assert math.cos(math.pi / 2) > 0.0
    assert not world.step(1.0, 0.0, 1.0).is_blocked
    assert world.pose[:2] == pytest.approx((11.0, 2.0))


def test_wall_also_stops_the_robot_when_reversing() -> None:
    world = World(start=(0.5, 5.5, 0.0))
    assert world.step(-1.0, 0.0, 1.0) == pytest.approx((-0.5, 0.0, 1.0))
    assert world.pose.x == 0.0


def test_wall_returns_the_distance_in_a_direction() -> None:
    world = World(start=(2.0, 3.0, math.pi / 2))
    assert world.wall(0.0) == pytest.approx(8.0)
    assert world.wall(math.pi / 2) == pytest.approx(2.0)
    assert world.wall(-math.pi / 2) == pytest.approx(9.0)
    assert world.wall(math.pi) == pytest.approx(3.0)
    assert world.wall(math.pi / 4) == pytest.approx(2.0 * math.sqrt(2))


@pytest.mark.property
@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-20, 20), st.floats(0, 1)), max_size=40))
def test_robot_never_leaves_the_square(steps: list[tuple[float, float, float]]) -> None:
    world = World()
    for linear, angular, seconds in steps:
        world.step(linear, angular, seconds)
        assert all(-1e-9 <= place <= 11.0 + 1e-9 for place in world.pose[:2])
    assert world.path[-1].tolist() == list(world.pose[:2])


@pytest.mark.slow
def test_path_is_bounded_and_keeps_both_ends() -> None:
    world = World(1e6)
    for _ in range(70_000):
        world.step(251.0, 0.01, 1.0)
    path = world.path
    assert 10_000 < len(path) < 33_000
    assert path[0].tolist() == [5e5, 5e5]
    assert path[-1].tolist() == list(world.pose[:2])


@pytest.mark.parametrize(
    ("size", "start"), [(0.0, None), (math.inf, None), (math.nan, None), (1.0, (2, 0, 0)), ("11", None), (1.0, 3)]
)
def test_world_rejects_invalid_sizes_and_starts(size: Any, start: Any) -> None:
    with pytest.raises(BadValue):
        World(size, start)


def test_world_rejects_a_start_without_a_heading() -> None:
    with pytest.raises(BadValue):
        World(start=(1.0, 1.0, math.nan))


def driven() -> World:
    world = World()
    for _ in range(100):
        world.step(1.0, 0.5, 0.05)
    return world


def test_svg_contains_the_path_and_the_title() -> None:
    world = driven()
    text = svg(world, "a <way> & more")
    assert text == svg(driven(), "a <way> & more")
    root = ElementTree.fromstring(text)
    space = "{http://www.w3.org/2000/svg}"
    (title,) = root.iter(space + "title")
    assert title.text == "a <way> & more"
    (line,) = root.iter(space + "polyline")
    points = [tuple(map(float, point.split(","))) for point in line.attrib["points"].split()]
    assert len(points) == len(world.path)
    assert points[0] == (264.0, 264.0)
    # y points up in the world, and down in the plot.
    assert world.pose.y > 5.5
    assert points[-1][1] < 264.0
    assert "<title>" not in svg(world)


def test_save_writes_an_svg_and_rejects_other_paths(tmp_path: Path) -> None:
    save(driven(), tmp_path / "way.svg")
    assert (tmp_path / "way.svg").read_text() == svg(driven())
    for path in (tmp_path / "way.jpg", tmp_path / "missing" / "way.svg"):
        with pytest.raises(BadValue):
            save(driven(), path)


@pytest.mark.slow
def test_save_writes_a_png_if_matplotlib_is_installed(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    save(driven(), tmp_path / "way.png", "way")
    assert (tmp_path / "way.png").read_bytes().startswith(b"\x89PNG")


def test_pose_is_a_named_tuple() -> None:
    assert Pose(1.0, 2.0, 3.0)._asdict() == {"x": 1.0, "y": 2.0, "theta": 3.0}
