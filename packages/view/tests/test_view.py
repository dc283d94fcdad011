"""Drawings of a view: of a live arm, of a recording, and of a URDF with meshes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import urlink
import urlink.cli
from linkcore.recording.file import Kind, RecordingWriter
from linkcore.streaming.connection_life import ConnectionState
from tests.waiting import until
from urlink.arm.kinematics import Arm
from urlink.arm.poses import compose, quaternion_to_rotvec
from urlink.packets import RealtimeState, RobotMode, SafetyMode, Stamp
from urlink.simulator import Controller
from urlink_view.arm_view import ArmView
from urlink_view.bodies import Bodies
from urlink_view.page import Page
from urlink_view.windows import SPAN, LiveWindow, RecordedWindow, Window

WHY = "needs viser: uv pip install viser"
NO_MESH = "<visual><geometry><mesh filename='no.stl'/></geometry></visual>"
Q = np.array([0.3, -1.1, 1.4, -0.7, 0.9, 2.0])


class Scene:
    """Scene with the interface of viser that records the drawn objects."""

    def __init__(self) -> None:
        self.frames: dict[str, Any] = {}
        self.meshes: dict[str, Any] = {}

    def add_frame(self, name: str, **options: Any) -> Any:
        self.frames[name] = SimpleNamespace(position=np.zeros(3), wxyz=np.array([1.0, 0.0, 0.0, 0.0]), **options)
        return self.frames[name]

    def add_mesh_simple(self, name: str, vertices: Any, faces: Any, **options: Any) -> None:
        self.meshes[name] = SimpleNamespace(vertices=vertices, **options)

    def add_mesh_trimesh(self, name: str, mesh: Any, **options: Any) -> None:
        self.meshes[name] = SimpleNamespace(vertices=mesh.vertices, **options)

    def pose(self, name: str) -> Any:
        """Return the pose of a node, composed of the poses of all its parents and its own pose."""
        pose = np.zeros(6)
        parts = name.split("/")
        for end in range(2, len(parts) + 1):
            frame = self.frames["/".join(parts[:end])]
            pose = compose(pose, [*frame.position, *quaternion_to_rotvec(np.roll(frame.wxyz, -1))])
        return pose


@pytest.mark.parametrize("model", ["UR5e", "UR10", "UR30"])
def test_links_match_kinematics(model: str) -> None:
    pytest.importorskip("trimesh", reason=WHY)
    scene, arm = Scene(), Arm(model)
    bodies = Bodies(scene, "/actual", arm, None, (1, 2, 3))
    bodies.show(Q)
    path = next(name for name in scene.frames if name.endswith("/tool0"))
    np.testing.assert_allclose(scene.pose(path), arm.forward(Q), atol=1e-12)
    # Each link with a length has a sphere and a cylinder.
    assert len(scene.meshes) > 8
    assert {name.rpartition("/")[0] for name in scene.meshes} <= scene.frames.keys()


def test_urdf_meshes_are_drawn_in_their_frames(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason=WHY)
    (tmp_path / "arm_description" / "meshes").mkdir(parents=True)
    (tmp_path / "arm_description" / "urdf").mkdir()
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "arm_description" / "meshes" / "box.stl")
    urdf = tmp_path / "arm_description" / "urdf" / "arm.urdf"
    mesh = '<geometry><mesh filename="package://arm_description/meshes/box.stl" scale="0.1 0.2 0.3"/></geometry>'
    urdf.write_text(
        f'<robot name="x"><link name="base_link_inertia"><visual><origin xyz="0 0 1" rpy="0 0 3.14159265358979"/>{mesh}'
        f'</visual></link><link name="forearm_link"><visual>{mesh}</visual></link><link name="table"/></robot>'
    )
    scene = Scene()
    Bodies(scene, "/actual", Arm("UR5e"), urdf, (1, 2, 3))
    base, forearm = sorted(scene.meshes, key=len)
    assert base == "/actual/base_link/base_link_inertia_0"
    assert forearm.endswith("/upper_arm_link/forearm_link/forearm_link_0")
    np.testing.assert_allclose(np.ptp(scene.meshes[base].vertices, axis=0), [0.1, 0.2, 0.3], atol=1e-6)
    np.testing.assert_allclose(scene.meshes[base].position, [0, 0, 1])
    np.testing.assert_allclose(abs(scene.meshes[base].wxyz), [0, 0, 0, 1], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<robot", "cannot read .* as URDF"),
        ("<robot name='x'><link name='other'/></robot>", "has no bodies for the arm"),
        (
            f"<robot name='x'><link name='tool0'>{NO_MESH}</link></robot>",
            "refers to the mesh no.stl, which does not exist at",
        ),
    ],
)
def test_invalid_urdf_raises_local_error(tmp_path: Path, text: str, says: str) -> None:
    pytest.importorskip("trimesh", reason=WHY)
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(text)
    with pytest.raises(urlink.LocalError, match=says):
        Bodies(Scene(), "/actual", Arm("UR5e"), urdf, (1, 2, 3))


def run(path: Path, count: int) -> Path:
    """Return a recording of `count` states, 10 ms apart."""
    writer = RecordingWriter(path)
    channel = writer.add_channel({"name": "realtime", "firmware": "5.11", "model": "UR5e"})
    for number in range(count):
        state = RealtimeState(
            "5.11",
            time=number / 100,
            q_actual=Q + number,
            tool_vector_actual=[number, 0, 0, 0, 0, 0],
            robot_mode=7,
            safety_mode=3 if number >= 50 else 1,
            safety_status=3 if number >= 50 else 1,
        )
        writer.write(Kind.BYTES, channel, Stamp(100 + number / 100, 50 + number / 100), bytes(state))
    writer.close()
    return path


def q_of(window: Window) -> Any:
    return window.numbers("q")


def test_recorded_window_shows_values_at_the_chosen_time(tmp_path: Path) -> None:
    window = RecordedWindow(urlink.load(run(tmp_path / "run.urlog", 3000)).realtime)
    assert window.end == pytest.approx(29.99)
    window.at(20.004)
    assert window.time[-1] == pytest.approx(20.0)
    assert 0.9 * SPAN < window.time[-1] - window.time[0] <= SPAN
    assert len(window.time) <= 501
    np.testing.assert_allclose(q_of(window), Q + 2000)
    way = window.way()
    assert way is not None
    assert way[-1, 0] == 2000
    assert np.all(np.diff(way[:, 0]) == np.diff(way[:, 0])[0])
    assert (window.word("robot"), window.word("safety")) == (RobotMode.RUNNING.name, SafetyMode.PROTECTIVE_STOP.name)
    window.at(0.49)
    assert window.word("safety") == SafetyMode.NORMAL.name
    for time, row in ((-1.0, 0), (1e9, 2999)):
        window.at(time)
        np.testing.assert_allclose(q_of(window), Q + row)
    assert window.numbers("force") is not None
    assert window.column("no_such_field") is None


def test_recorded_window_rejects_empty_recording(tmp_path: Path) -> None:
    recording = urlink.load(run(tmp_path / "run.urlog", 0))
    with pytest.raises(urlink.BadRecording, match="contains no rows"):
        RecordedWindow(recording.realtime)


@pytest.mark.slow
@pytest.mark.simulated_time
def test_live_window_keeps_last_seconds() -> None:
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        window = LiveWindow(robot.realtime)
        robot.realtime.wait()
        window.look()
        assert len(window.time) == 1
        first = window.time[0]

        def has_dropped_the_first() -> bool:
            window.look()
            return bool(window.time[-1] - first > SPAN + 2.0)

        until(has_dropped_the_first)
        assert SPAN - 1.0 < window.time[-1] - window.time[0] <= SPAN
        assert len(window.time) <= 502
        assert window.word("robot") == "RUNNING"
        assert window.status == ("live", True)
        np.testing.assert_array_equal(q_of(window), window.newest("q_actual"))
        way = window.way()
        assert way is not None
        assert way.shape == (len(window.time), 3)
        controller.close()
        until(lambda: not window.status[1])
        assert "shown state is" in window.status[0]


@pytest.mark.real_time
def test_robot_view_shows_arm() -> None:
    pytest.importorskip("viser", reason=WHY)
    with urlink.connect("sim://ur5e?firmware=5.11&motion=demo") as robot:
        with robot.view(plots=["I_actual"]) as view:
            assert isinstance(view, ArmView)
            assert f'<iframe src="{view.address}"' in view._repr_html_()
            frame = view._actual._frames[0]
            before = tuple(frame.wxyz)
            until(lambda: tuple(frame.wxyz) != before)
            until(lambda: "RUNNING" in view._words.content)
        with pytest.raises(urlink.BadValue, match="cannot plot the unknown field 'I_actal'; did you mean 'I_actual'"):
            robot.view(plots=["I_actal"])


@pytest.mark.real_time
@pytest.mark.parametrize(("apart", "shown"), [(0.0, False), (0.02, True)])
def test_target_arm_is_drawn_when_it_differs_from_the_arm(apart: float, shown: bool) -> None:
    pytest.importorskip("viser", reason=WHY)
    state = RealtimeState("5.11", time=1.0, q_actual=Q, q_target=Q + apart * np.eye(6)[3])
    window = LiveWindow(cast("Any", SimpleNamespace(start=lambda: None, latest=state, connection=None)))
    window.look()
    with Page("a page", port=0) as page:
        view = ArmView(page, Arm("UR5e"), window, plots=())
        view._draw()
        assert (view._actual.root.visible, view._target.root.visible) == (True, shown)
        view._wants_target.value = False
        view._draw()
        assert not view._target.root.visible


@pytest.mark.real_time
def test_curves_have_units_and_legends(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason=WHY)
    recorded = RecordedWindow(urlink.load(run(tmp_path / "run.urlog", 100)).realtime)
    state = RealtimeState("5.11", time=1.0, q_actual=Q, qd_actual=Q, tcp_force=Q, speed_scaling=1.0)
    connected = ConnectionState.CONNECTED
    live = LiveWindow(cast("Any", SimpleNamespace(start=lambda: None, latest=state, connection=connected)))
    fields = {
        "qd_actual": ("rad/s", ["base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3"]),
        "tcp_force": ("N, Nm", ["x, N", "y, N", "z, N", "rx, Nm", "ry, Nm", "rz, Nm"]),
        "speed_scaling": ("", ["speed_scaling"]),
    }
    for window in (live, recorded):
        with Page("a page", port=0) as page:
            view = ArmView(page, Arm("UR5e"), window, plots=list(fields))
            view.show()
            for curves, (field, (unit, labels)) in zip(view._plots, fields.items(), strict=True):
                handle = curves._handle
                assert handle.title == field
                assert [axis["label"] for axis in handle.axes] == ["t [s]", unit]
                assert [each["label"] for each in handle.series] == ["t [s]", *labels]
                assert handle.legend["show"]


@pytest.mark.real_time
def test_view_command_shows_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser", reason=WHY)
    path = str(run(tmp_path / "run.urlog", 100))
    assert urlink.cli.main(["view", path, "--port", "0", "--duration", "0.5", "--plot", "q_actual"]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert "run.urlog is at http://127.0.0.1:" in err
    assert urlink.cli.main(["view", path, "--port", "0", "--jog"]) == 1
    assert "is a recording" in capsys.readouterr().err
    assert urlink.cli.main(["view", "sim://", "--jog", "--host", "0.0.0.0"]) == 1
    assert "--jog is only for browsers on this computer" in capsys.readouterr().err
