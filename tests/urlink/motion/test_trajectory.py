"""Trajectories: rejected points, and the curve through accepted points."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue, LocalError
from urlink.arm.models import model
from urlink.arm.vectors import JOINTS, FloatArray
from urlink.motion.moves.trajectory import Trajectory, TrajectoryPoint

UR5E = model("UR5e")


def tool(*angles: float, time: list[float] | None = None) -> Trajectory:
    """Return a trajectory that turns only wrist 3; by default, points are one second apart."""
    q = np.zeros((len(angles), 6))
    q[:, 5] = angles
    return Trajectory.from_arrays(range(len(angles)) if time is None else time, q)


# -- points and arrays ---------------------------------------------------------------------------------


def test_points_and_arrays_give_the_same_trajectory() -> None:
    q, qd, qdd = (np.random.default_rng(i).uniform(-1, 1, (3, 6)) for i in range(3))
    arrays = Trajectory.from_arrays([0, 1, 2.5], q, qd, qdd)
    points = Trajectory([TrajectoryPoint(q[i], t, qd[i], qdd[i]) for i, t in enumerate((0, 1, 2.5))])
    for one, other in ((arrays, points), (arrays, Trajectory(arrays.points))):
        assert (one.time == other.time).all()
        assert (one.q == other.q).all()
        assert (one.qd == other.qd).all()
        assert one.qdd is not None
        assert other.qdd is not None
        assert (one.qdd == other.qdd).all()
    assert arrays.duration == 2.5
    assert len(arrays) == 3
    assert arrays.is_quintic
    assert repr(arrays) == "<Trajectory of 3 points in 2.5 s>"


def test_trajectory_is_immutable() -> None:
    source = np.zeros((2, 6))
    trajectory = Trajectory.from_arrays([0, 1], source)
    source[1, 0] = 7
    assert trajectory.q[1, 0] == 0
    for array in (trajectory.time, trajectory.q, trajectory.qd, TrajectoryPoint([0] * 6, 0).q):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(AttributeError):
        TrajectoryPoint([0] * 6, 0).time = 3  # type: ignore[misc]


NAN = float("nan")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0, 0, 0, 0, 0], 0), "shape"),
        (([0, 0, 0, 0, 0, NAN], 0), r"q\[5\] is not finite"),
        ((["a"] * 6, 0), "expected numbers"),
        (([[0], [0, 1]], 0), "expected numbers"),
        (([0] * 6, "soon"), "time"),
        (([0] * 6, [1, 2]), "expected one number"),
        (([0] * 6, 0, [1, 2]), "qd has the shape"),
    ],
)
def test_invalid_point_is_rejected(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(BadValue, match=message):
        TrajectoryPoint(*arguments)  # type: ignore[arg-type]


REST = np.zeros((3, 6))


@pytest.mark.parametrize(
    ("time", "q", "qd", "qdd", "message"),
    [
        ([0], [[0] * 6], None, None, "at least two points"),
        ([0, 1, 1], REST, None, None, "point 2: time 1 s follows 1 s"),
        ([0, 2, 1], REST, None, None, "point 2"),
        ([0, 1e-9, 1], REST, None, None, "point 1"),
        ([1, 2, 3], REST, None, None, "begins at 0"),
        ([0, 1, NAN], REST, None, None, "point 2: time is nan"),
        ([0, 1], REST, None, None, r"q has the shape \(3, 6\); expected \(2, 6\)"),
        ([0, 1, 2], np.where(np.arange(18).reshape(3, 6) == 8, NAN, 0.0), None, None, r"point 1: q\[2\] \(elbow\)"),
        ([0, 1, 2], REST, REST[:2], None, "qd has the shape"),
        ([0, 1, 2], REST, None, REST, "has accelerations without velocities"),
        ([0, 1, 2], REST, REST + 1e300, None, r"point 0: qd\[0\]"),
        (
            [0, 1, 2],
            REST + 1.1e6,
            None,
            None,
            r"point 0: q\[0\] \(base\) is 1100000.0; expected a finite number of rad$",
        ),
        ([0, 1, 1.1e6], REST, None, None, "point 2: time is 1100000.0"),
        (
            [0, 1, 1.00009],
            REST,
            None,
            None,
            "point 2: time 1.00009 s follows 1 s; times must increase by at least 0.0001 s",
        ),
    ],
)
def test_invalid_arrays_are_rejected(time: object, q: object, qd: object, qdd: object, message: str) -> None:
    with pytest.raises(BadValue, match=message):
        Trajectory.from_arrays(time, q, qd, qdd)  # type: ignore[arg-type]


def test_largest_numbers_and_shortest_steps_are_accepted() -> None:
    closest = Trajectory.from_arrays([0, 1e-4, 1e6], REST + 1e6, REST - 1e6, REST + 1e6)
    assert closest.duration == 1e6


def test_inconsistent_points_are_rejected() -> None:
    still = TrajectoryPoint([0] * 6, 0)
    with pytest.raises(BadValue, match="point 1: either all points have velocities or none"):
        Trajectory([still, TrajectoryPoint([0] * 6, 1, qd=[0] * 6)])
    with pytest.raises(BadValue, match="point 1 is 3"):
        Trajectory([still, 3])  # type: ignore[list-item]


# -- the curve -----------------------------------------------------------------------------------------


def test_curve_is_constant_before_and_after() -> None:
    trajectory = Trajectory.from_arrays([0, 0.5], [[0] * 6, [1] * 6], [[0.5] * 6, [0.5] * 6])
    for t, q in ((-1.0, 0.0), (0.75, 1.0), (float("inf"), 1.0)):
        position, speed, acceleration = trajectory.at(t)
        assert position.tolist() == [q] * 6
        assert trajectory.at([t, 0.0])[0].tolist() == [[q] * 6, [0.0] * 6]
        assert not speed.any()
        assert not acceleration.any()
    with pytest.raises(BadValue):
        trajectory.at(NAN)


def test_chosen_velocities_avoid_overshoot_and_end_at_rest() -> None:
    trajectory = tool(1, 0, 1, 0, time=[0, 1, 4, 8])
    q, qd, _ = trajectory.at(np.linspace(0, 8, 4001))
    assert q[:, 5].min() >= 0.0
    assert q[:, 5].max() <= 1.0
    assert not qd[[0, -1]].any()
    assert not trajectory.has_velocities


def test_chosen_velocities_are_weighted_harmonic_means() -> None:
    """Compute by hand, with weights 2 h + h' of the steps: 9 / (5 / 1 + 4 / 0.5) and 9 / (4 / 0.5 + 5 / 2)."""
    trajectory = tool(0, 1, 2, 4, time=[0, 1, 3, 4])
    assert trajectory.qd[:, 5] == pytest.approx([0.0, 9.0 / 13.0, 9.0 / 10.5, 0.0])


times = st.lists(st.floats(0.01, 5.0), min_size=1, max_size=5).map(lambda steps: np.cumsum([0.0, *steps]))
seeds = st.integers(0, 2**32 - 1)


def some(time: FloatArray, seed: int, quantities: int) -> Trajectory:
    """Return a trajectory of arbitrary points; seeds shrink better than 90 floats and are as arbitrary."""
    generator = np.random.default_rng(seed)
    arrays = [generator.normal(0, 2, (time.size, 6)) * generator.integers(0, 2, (time.size, 1)) for _ in range(3)]
    return Trajectory.from_arrays(time, *arrays[:quantities])


@pytest.mark.property
@given(times, seeds, st.integers(1, 3))
def test_curve_passes_through_every_point(time: FloatArray, seed: int, quantities: int) -> None:
    trajectory = some(time, seed, quantities)
    q, qd, qdd = trajectory.at(time)
    assert np.allclose(q, trajectory.q, rtol=0, atol=1e-9)
    assert np.allclose(qd, trajectory.qd, rtol=0, atol=1e-7)
    if trajectory.qdd is not None:
        assert np.allclose(qdd, trajectory.qdd, rtol=0, atol=1e-3)


@pytest.mark.property
@given(times, seeds, st.integers(1, 3))
def test_curve_is_continuous_in_given_quantities(time: FloatArray, seed: int, quantities: int) -> None:
    trajectory = some(time, seed, quantities)
    inner = time[1:-1]
    before = trajectory.at(np.nextafter(inner, 0.0))
    after = trajectory.at(inner)
    assert np.allclose(before[0], after[0], rtol=0, atol=1e-9)
    assert np.allclose(before[1], after[1], rtol=0, atol=1e-6)
    if trajectory.is_quintic:
        assert np.allclose(before[2], after[2], rtol=0, atol=1e-2)


@pytest.mark.property
@given(times, seeds, st.integers(1, 3), st.lists(st.floats(-1, 30), min_size=1, max_size=10))
def test_evaluation_at_one_time_equals_row_for_several_times(
    time: FloatArray, seed: int, quantities: int, at: list[float]
) -> None:
    trajectory = some(time, seed, quantities)
    many = trajectory.at([*at, *time])
    for row, t in enumerate([*at, *time]):
        for one, all_ in zip(trajectory.at(float(t)), many, strict=True):
            assert one.tolist() == all_[row].tolist()


@pytest.mark.property
@given(times, seeds)
def test_chosen_velocities_keep_curve_between_neighbours(time: FloatArray, seed: int) -> None:
    trajectory = some(time, seed, 1)
    for i in range(len(trajectory) - 1):
        q = trajectory.at(np.linspace(time[i], time[i + 1], 50))[0]
        low, high = np.sort(trajectory.q[i : i + 2], axis=0)
        assert (q >= low - 1e-9).all()
        assert (q <= high + 1e-9).all()


@pytest.mark.property
@given(times, seeds, st.integers(1, 3))
def test_velocity_is_the_derivative_of_position(time: FloatArray, seed: int, quantities: int) -> None:
    trajectory = some(time, seed, quantities)
    middle = 0.5 * (time[:-1] + time[1:])
    h = 1e-4 * np.diff(time)[:, None]
    ahead, behind = trajectory.at(middle + h[:, 0]), trajectory.at(middle - h[:, 0])
    _, qd, qdd = trajectory.at(middle)
    scale = 1.0 + np.abs(qdd).max() + np.abs(qd).max()
    assert np.allclose((ahead[0] - behind[0]) / (2 * h), qd, rtol=0, atol=1e-4 * scale)
    assert np.allclose((ahead[1] - behind[1]) / (2 * h), qdd, rtol=0, atol=1e-3 * scale)


# -- limits --------------------------------------------------------------------------------------------


def test_trajectory_within_limits_is_accepted() -> None:
    tool(1, 0, 1, 0, time=[0, 1, 4, 8]).check(UR5E, near=[0, 0, 0, 0, 0, 1])


def test_position_beyond_limit_is_rejected() -> None:
    with pytest.raises(
        BadValue, match=r"between points 0 and 1 .*position of wrist 3 \(joint 5\) is 6\.\d+ rad; .*UR5e is 6\.2832"
    ):
        tool(0, 7, 0, time=[0, 20, 40]).check(UR5E)


def test_velocity_between_points_is_checked() -> None:
    # 4 rad in 1.5 s with rest at both ends: in the middle, the speed is 1.5 times the mean speed.
    with pytest.raises(BadValue, match=r"between points 0 and 1 .*velocity of wrist 3 .* rad/s; the limit .* 3\.1416"):
        tool(0, 4, time=[0, 1.5]).check(UR5E)
    tool(0, 4, time=[0, 1.95]).check(UR5E)


def test_trajectory_just_within_limits_is_accepted() -> None:
    tool(0, UR5E.position_limits[5, 1], 0, UR5E.position_limits[5, 0], 0, time=[0, 20, 40, 60, 80]).check(UR5E)
    fastest = np.array([UR5E.max_speed] * 2)
    way = np.array([[0.0] * 6, 0.3 * UR5E.max_speed])
    Trajectory.from_arrays([0, 0.3], way, fastest).check(UR5E)
    with pytest.raises(BadValue, match="velocity of base"):
        Trajectory.from_arrays([0, 0.3], 1.00001 * way, 1.00001 * fastest).check(UR5E)


def test_acceleration_at_point_is_checked() -> None:
    with pytest.raises(BadValue, match=r"point 0 \(t = 0\.0000 s\): acceleration of wrist 3 .* is 600\.0000 rad/s²"):
        tool(0, 1, time=[0, 0.1]).check(UR5E.__class__(**{**vars(UR5E), "max_speed": [99] * 6}))


@pytest.mark.slow
def test_long_trajectory_is_checked_completely() -> None:
    time = np.arange(10_000) * 0.01
    q = np.zeros((10_000, 6))
    q[9_990:, 1] = 9.0
    with pytest.raises(BadValue, match="points 9989 and 9990"):
        Trajectory.from_arrays(time, q).check(UR5E)


def test_first_segment_of_second_block_is_checked() -> None:
    q = np.zeros((4098, 6))
    q[-1, 1] = 9.0
    with pytest.raises(BadValue, match="between points 4096 and 4097"):
        Trajectory.from_arrays(4.0 * np.arange(4098.0), q).check(UR5E)


def test_error_suggests_degrees() -> None:
    with pytest.raises(BadValue, match=r"position of wrist 3 .* is 45\.0000 rad; .* rad \(in degrees\?\)"):
        Trajectory.from_arrays([0.0, 90.0], [[0.0] * 5 + [45.0]] * 2).check(UR5E)


def test_first_point_must_be_near_arm() -> None:
    with pytest.raises(
        BadValue, match=r"shoulder \(joint 1\) is at 0\.2000 rad, but begins at 0\.0000 rad; at most 0\.05"
    ):
        tool(0, 1).check(near=[0, 0.2, 0.1, 0, 0, 0])
    tool(0, 1).check(near=[0, 0.2, 0.1, 0, 0, 0], within=0.2)
    tool(0, 1).check(near=[0, 0.05, -0.05, 0, 0, 0])


def test_trajectory_must_begin_and_end_at_rest() -> None:
    moving = np.zeros((2, 6))
    moving[1, 2] = 0.4
    trajectory = Trajectory.from_arrays([0, 1], np.zeros((2, 6)), moving)
    trajectory.check(UR5E)
    with pytest.raises(BadValue, match=r"point 1: elbow \(joint 2\) moves at 0\.4000 rad/s"):
        trajectory.check(near=[0] * 6)
    Trajectory.from_arrays([0, 1], np.zeros((2, 6)), moving / 8).check(near=[0] * 6)
    with pytest.raises(BadValue, match=r"point 0: elbow \(joint 2\) moves at -0\.0504 rad/s"):
        Trajectory.from_arrays([0, 1], np.zeros((2, 6)), moving[::-1] * -0.126).check(near=[0] * 6)


def test_curve_is_checked_at_points_and_between(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check each point, and 15 positions between two points."""
    looked: list[float] = []
    curve = Trajectory._curve

    def watched(self: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        looked.extend(t.ravel())
        return curve(self, t)

    monkeypatch.setattr(Trajectory, "_curve", watched)
    tool(0, 1, 0, time=[0, 1.6, 4.8]).check(UR5E)
    assert sorted(set(looked)) == pytest.approx([*np.arange(0, 1.65, 0.1), *np.arange(1.8, 4.85, 0.2)])


def test_error_names_point_with_exceeded_limit() -> None:
    """This holds even if rounding gives the end of a step another time than the time of the point."""
    assert 0.2 + (0.9 - 0.2) != 0.9
    speeds = np.zeros((3, 6))
    speeds[2, 0] = 3.2
    with pytest.raises(BadValue, match=r"^point 2 \(t = 0\.9000 s\): velocity of base \(joint 0\) is 3\.2000 rad/s"):
        Trajectory.from_arrays([0, 0.2, 0.9], np.zeros((3, 6)), speeds).check(UR5E)


def test_retiming_adds_positions_between_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """There are a few hundred at least, but only a few per step of a long trajectory. They are closer near points."""
    asked: list[FloatArray] = []

    def fake_retime(
        q: FloatArray, qd: FloatArray, speed: FloatArray, acceleration: FloatArray, closest: float
    ) -> object:
        asked.append(q[:, 5])
        assert closest == 2e-4
        return [0.0, 1.0], q[[0, -1]], np.zeros((2, 6))

    monkeypatch.setattr("urlink.motion.moves.trajectory.retime", fake_retime)
    for segments, places in ((1, 200), (2, 100), (50, 20), (100, 20), (400, 5), (1500, 3)):
        trajectory = tool(*range(segments + 1))
        trajectory.retimed(1.0, 1.0)
        assert len(asked[-1]) == segments * places + 1
        assert asked[-1][::places] == pytest.approx(trajectory.q[:, 5])
    steps = np.diff(asked[0])
    assert (np.diff(steps)[:90] > 0.0).all()
    assert steps == pytest.approx(steps[::-1])


# -- files ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("trajectory") / "path.csv"


@pytest.mark.property
@given(times, seeds, st.integers(1, 3))
def test_file_keeps_every_digit(file: Path, time: FloatArray, seed: int, quantities: int) -> None:
    written = some(time, seed, quantities)
    written.to_csv(file)
    read = Trajectory.from_csv(file)
    assert read.has_velocities == written.has_velocities
    assert (read.time == written.time).all()
    assert (read.q == written.q).all()
    assert (read.qd == written.qd).all()
    assert (read.qdd is None) == (written.qdd is None)
    if read.qdd is not None and written.qdd is not None:
        assert (read.qdd == written.qdd).all()


HEADER = "time,q0,q1,q2,q3,q4,q5\n"
cells = st.sampled_from(["0", "1", "2.5", "nan", "-inf", "", "1e999", "x", '"', "0x1", "١", "1_0", " 3 ", "\x00", "\r"])
tables = st.builds(
    lambda head, rows, end: head + end.join(",".join(row) for row in rows),
    st.sampled_from(["", HEADER, "\ufeff" + HEADER, "q5,q4,q3,q2,q1,q0,time\r\n"]),
    st.lists(st.lists(cells, min_size=6, max_size=8), max_size=5),
    st.sampled_from(["\n", "\r\n", "\r"]),
)


@pytest.mark.property
@given(st.one_of(st.text(max_size=200).map(lambda text: text.encode("utf-8", "replace")), st.binary(max_size=100)))
def test_random_file_is_rejected(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    with pytest.raises(BadValue, match=r"path\.csv"):
        Trajectory.from_csv(file)


@pytest.mark.property
@given(tables)
def test_random_table_is_trajectory_or_rejected(file: Path, content: str) -> None:
    file.write_bytes(content.encode())
    with contextlib.suppress(BadValue):
        assert len(Trajectory.from_csv(file)) >= 2


def test_columns_may_have_any_order_and_blank_lines(file: Path) -> None:
    file.write_text("q5, q4, q3, q2, q1, q0, time\n\n5,4,3,2,1,0,0\n\n5,4,3,2,1,0,2\n")
    trajectory = Trajectory.from_csv(file)
    assert trajectory.q.tolist() == [[0, 1, 2, 3, 4, 5]] * 2
    assert trajectory.duration == 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "0 points"),
        ("time,q0\n", "line 1: the columns are time,q0; expected time,q0,...,q5"),
        ("time\n0\n1\n", "line 1: the columns are time; expected"),
        (HEADER + '0,0,0,0,0,0,0\n"1\n2",0,0,0,0,0,0\n', r"line 4, column time: '1\\n2' is not a finite number"),
        (HEADER + "0" * 200_000, "line 2: field larger than"),
        (HEADER, "0 points"),
        (HEADER + "0,0,0,0,0,0,0\n", "1 points"),
        (HEADER + "0,0,0,0,0,0,0\n1,0,0,0,0,0\n", "line 3 has 6 values; expected 7"),
        (HEADER + "0,0,0,0,0,0,0\n\n1,0,0,x,0,0,0\n", "line 4, column q2: 'x' is not a finite number"),
        (HEADER + "0,0,0,0,0,0,0\n0,0,0,0,0,0,0\n", r"point 0 is line 2\): point 1: time 0 s follows 0 s"),
    ],
)
def test_invalid_file_is_rejected(file: Path, content: str, message: str) -> None:
    file.write_text(content)
    with pytest.raises(BadValue, match=message):
        Trajectory.from_csv(file)


def test_file_without_folder_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match="No such file"):
        Trajectory.from_csv(tmp_path / "none.csv")
    with pytest.raises(BadValue, match="No such file"):
        tool(0, 1).to_csv(tmp_path / "none" / "path.csv")


@pytest.mark.slow
def test_plot_draws_curves_and_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """The figure shows positions, speeds and accelerations, with the limits of the arm."""
    pytest.importorskip("matplotlib")
    path = Trajectory.from_arrays([0, 1, 3], [[0.0] * 6, [0.3] * 6, [0.0] * 6])
    figure = path.plot(UR5E)
    rows = figure.axes
    assert figure.get_size_inches().tolist() == [8.0, 6.0]
    assert [row.get_ylabel() for row in rows] == ["position, rad", "speed, rad/s", "acceleration, rad/s²"]
    assert rows[2].get_xlabel() == "time, s"
    assert rows[0].get_shared_x_axes().joined(rows[0], rows[2])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == list(JOINTS)
    for row, values in zip(rows, path.at(path.time), strict=True):
        times, drawn = (np.asarray(each, dtype=float) for each in row.lines[2].get_data())
        assert (times[0], times[-1]) == (0.0, 3.0)
        assert np.diff(times).max() < 3.01e-3
        assert np.interp(path.time, times, drawn) == pytest.approx(values[:, 2], abs=1e-3)
    # At a point, the acceleration jumps, so both of its values are drawn.
    _, _, (before, after) = path.at([1.0 - 1e-9, 1.0])
    at_it = np.abs(times - 1.0) < 1e-5
    assert times[at_it] == pytest.approx([1.0 - 3e-6, 1.0, 1.0 + 3e-6], abs=1e-9)
    assert drawn[at_it] == pytest.approx([before[2], after[2], after[2]], abs=1e-3)
    assert after[2] > before[2] + 1.0
    for row, limits in zip(rows[1:], (UR5E.max_speed, UR5E.max_acceleration), strict=True):
        heights = [float(np.asarray(line.get_ydata())[0]) for line in row.lines[6:]]
        assert sorted(heights) == pytest.approx(sorted([*limits, *-limits]))
        assert [line.get_color() for line in row.lines[6::2]] == [line.get_color() for line in row.lines[:6]]
    assert [line.get_ydata()[1] for line in rows[0].lines[6:]] == [0.3] * 6  # type: ignore[index]
    assert [len(row.lines) for row in path.plot().axes] == [12, 6, 6]
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(LocalError, match=r"pip install 'urlink-robot\[plot\]'"):
        path.plot()
