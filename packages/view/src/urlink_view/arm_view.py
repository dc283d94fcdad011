"""Class `ArmView`: an arm in a browser, with its state as text and plots, and buttons that move it."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from linkcore import clock
from urlink import BadValue, LinkError, Robot
from urlink.arm.kinematics import Arm
from urlink.motion import Jog
from urlink.tools import FULL_JOG_SPEED as FULL_SPEED
from urlink.tools import JOINTS, Closing, FrameName, ReentrantEvent, StrictAttributes, element_names, similar

from .bodies import Bodies, wxyz
from .page import Page
from .windows import SPAN, LiveWindow, RecordedWindow, Window

if TYPE_CHECKING:
    from typing_extensions import Self

_ARM, _TARGET, _TRAIL, _FORCE = (205, 210, 216), (224, 122, 31), (224, 122, 31), (210, 40, 60)
_CURVES = ("#4a7fc0", "#e07a1f", "#3f9c5a", "#b5495b", "#7d5fb2", "#8a7248")
#: Units of vectors with six elements, one for each joint.
_OF_JOINTS = frozenset({"rad", "rad/s", "rad/s^2", "Nm", "A", "V", "degC"})
#: Length of the arrow in m per newton, and force in N below which no arrow is drawn, because idle sensors show some
#: force.
_PER_NEWTON, _LEAST = 0.004, 3.0
#: Distance in rad between actual and target positions below which the target is not drawn, because it would cover the
#: arm.
_APART = 0.01
#: Pixels that the label of an axis of a plot needs.
_LABEL = 18
#: Number of calls of `show` between two updates of texts and plots.
_SELDOM = 6
#: Messages per second while a button is held, and time in s after which the speed of a message expires.
_RATE, _EXPIRY = 20.0, 0.25
#: Labels of the buttons of a frame.
_NAMES = {
    "joints": JOINTS,
    "base": ("x", "y", "z", "about x", "about y", "about z"),
}


class ArmView(StrictAttributes, Closing):
    """Arm on a page: its actual and target position, the trail of its TCP, the force on it, and its state.

    A notebook shows it in the cell. It is a context manager.

    Args:
        page: Page to draw on.
        arm: Kinematics of the arm.
        window: Window with the values to draw.
        plots: Fields to plot.
        urdf: File with bodies for the links; None for cylinders and spheres.
        jog: Function that begins a jog, `robot.motion.jog`; None if the arm is only shown.

    Raises:
        BadValue: If a field does not exist.
        LocalError: If the file cannot be drawn.
    """

    def __init__(
        self,
        page: Page,
        arm: Arm,
        window: Window,
        plots: Sequence[str] = ("qd_actual", "tcp_force"),
        urdf: Path | None = None,
        jog: Callable[..., Jog] | None = None,
    ) -> None:
        for field in plots:
            if field not in window.fields:
                raise BadValue(f"cannot plot the unknown field {field!r}{similar(field, window.fields)}")
        self.page = page
        self._window = window
        self._model = arm.model.name
        self._rounds = 0
        self._over = ReentrantEvent()
        self._thread: threading.Thread | None = None
        scene, gui = page.server.scene, page.server.gui
        reach = float(sum(abs(link.a) + abs(link.d) for link in arm.geometry.links))
        page.server.initial_camera.position = (0.7 * reach, -0.7 * reach, 0.6 * reach)
        page.server.initial_camera.look_at = (0.0, 0.0, 0.3 * reach)
        scene.configure_default_lights(cast_shadow=False)
        scene.add_grid("/floor", 3.0, 3.0, cell_size=0.1, section_size=0.5)
        self._actual = Bodies(scene, "/actual", arm, urdf, _ARM)
        self._target = Bodies(scene, "/target", arm, urdf, _TARGET, 0.3)
        self._tcp = scene.add_frame("/tcp", axes_length=0.12, axes_radius=0.004)
        self._trail = scene.add_line_segments("/trail", np.zeros((1, 2, 3)), _TRAIL, thickness=0.006)
        self._force = scene.add_arrows(
            "/force", np.zeros((1, 2, 3)), _FORCE, shaft_radius=0.008, head_radius=0.02, head_length=0.04, visible=False
        )
        self._label = scene.add_label("/state", "", position=(0.0, 0.0, 0.85 * reach))
        self._words = gui.add_markdown("")
        self._wants_target = gui.add_checkbox("target", True)
        self._player = _Player(gui, window) if isinstance(window, RecordedWindow) else None
        self._jog = None if jog is None else _JogButtons(page.server, jog)
        self._plots = [_Curves(gui, field) for field in plots]

    @property
    def address(self) -> str:
        """Address for browsers."""
        return self.page.address

    def show(self) -> None:
        """Draw the newest state, or the state at the time of the slider. Call it repeatedly."""
        window = self._window
        if isinstance(window, LiveWindow):
            window.look()
        elif self._player is not None:
            self._player.play()
        if self._jog is not None:
            self._jog.show()
        if len(window.time):
            with self.page.server.atomic():
                self._draw()
        if self._rounds % _SELDOM == 0:
            self._say()
            for plot in self._plots:
                plot.show(window)
        self._rounds += 1

    def _draw(self) -> None:
        q, target, pose, force = map(self._window.numbers, ("q", "target", "pose", "force"))
        self._actual.root.visible = q is not None
        apart = target is not None and (q is None or bool(np.abs(target - q).max() > _APART))
        self._target.root.visible = apart and self._wants_target.value
        if q is not None:
            self._actual.show(q)
        if target is not None:
            self._target.show(target)
        self._tcp.visible = pose is not None
        if pose is not None:
            self._tcp.position, self._tcp.wxyz = pose[:3], wxyz(pose[3:])
        way = self._window.way()
        self._trail.visible = way is not None and len(way) > 1
        if way is not None and len(way) > 1:
            self._trail.points = np.stack([way[:-1], way[1:]], axis=1)
        newtons = 0.0 if force is None else float(np.linalg.norm(force[:3]))
        self._force.visible = pose is not None and newtons >= _LEAST
        if pose is not None and force is not None and newtons >= _LEAST:
            self._force.points = np.array([[pose[:3], pose[:3] + _PER_NEWTON * force[:3]]])

    def _say(self) -> None:
        window = self._window
        status, is_true = window.status
        robot, safety, program = map(window.word, ("robot", "safety", "program"))
        self._label.text = " · ".join(each for each in (robot, safety, program) if each) if is_true else status.upper()
        speed, pose, force = map(window.numbers, ("speed", "pose", "force"))
        rows = [
            ("arm", self._model),
            ("connection", status if is_true else f"**{status}**"),
            ("robot mode", robot or "—"),
            ("safety", safety or "—"),
            ("program", program or "—"),
            ("speed", "—" if speed is None else f"{100 * float(speed[0]):.0f} %"),
            ("TCP, mm", "—" if pose is None else "  ".join(f"{1000 * each:.1f}" for each in pose[:3])),
            ("force, N", "—" if force is None else "  ".join(f"{each:.1f}" for each in force[:3])),
        ]
        text = "| | |\n|---|---|\n" + "\n".join(f"| {name} | {value} |" for name, value in rows)
        if self._words.content != text:
            self._words.content = text

    def start(self, rate: float = 30.0) -> Self:
        """Call `show` in a dedicated thread, `rate` times per second, until the view is closed."""

        def run() -> None:
            while not clock.wait(self._over.wait, 1.0 / rate):
                self.show()

        self._thread = threading.Thread(target=run, name="view", daemon=True)
        self._thread.start()
        return self

    def close(self) -> None:
        """End a jog, and close the page; idempotent."""
        self._over.set()
        if self._thread is not None:
            clock.join(self._thread)
        if self._jog is not None:
            self._jog.close()
        self.page.close()

    def __repr__(self) -> str:
        return f"<ArmView of a {self._model} at {self.address}>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.address}" width="100%" height="600" style="border: 0"></iframe>'


def view_robot(
    robot: Robot, plots: Sequence[str], urdf: str | os.PathLike[str] | None, jog: bool, port: int
) -> ArmView:
    """Return the view for `Robot.view`, which has the same arguments."""
    page = Page(f"urlink {robot.address}", port=port)
    try:
        begin = robot.motion.jog if jog else None
        file = None if urdf is None else Path(urdf)
        return ArmView(page, robot.kinematics, LiveWindow(robot.realtime), plots, file, begin).start()
    except BaseException:
        page.close()
        raise


class _Player:
    """Slider of a recording, and its playback controls."""

    def __init__(self, gui: Any, window: RecordedWindow) -> None:
        self._window = window
        self._end = max(window.end, 0.001)
        self._plays = gui.add_checkbox("play", False)
        self._rate = gui.add_number("times as fast", 1.0, min=0.01, max=100.0, step=0.1)
        self._time = gui.add_slider("time, s", 0.0, self._end, 0.001, 0.0)
        self._last: float | None = None

    def play(self) -> None:
        """Advance if playback is on, and show the arm at the time of the slider."""
        now = clock.now()
        if self._plays.value and self._last is not None:
            self._time.value = min(self._time.value + (now - self._last) * self._rate.value, self._end)
            if self._time.value >= self._end:
                self._plays.value = False
        self._last = now
        self._window.at(self._time.value)


class _Curves:
    """Plot of a field over the last seconds, one curve for each of its elements."""

    def __init__(self, gui: Any, field: str) -> None:
        self._gui = gui
        self._field = field
        self._handle: Any = None

    def show(self, window: Window) -> None:
        """Draw the available rows."""
        rows = window.column(self._field)
        if rows is None or not len(rows):
            return
        data = (window.time - window.time[-1], *rows.T.copy())
        if self._handle is None:
            unit, count = window.unit(self._field), rows.shape[1]
            names = JOINTS if unit in _OF_JOINTS and count == len(JOINTS) else element_names(unit, count)
            curves = [
                {
                    "label": name if count > 1 else self._field,
                    "stroke": _CURVES[number % len(_CURVES)],
                    "width": 1.5,
                    "points": {"show": False},
                }
                for number, name in enumerate(names)
            ]
            self._handle = self._gui.add_uplot(
                data,
                ({"label": "t [s]"}, *curves),
                title=self._field,
                scales={"x": {"time": False, "range": (-SPAN, 0.0), "auto": False}},
                axes=tuple(
                    {"label": label, "labelSize": _LABEL, "size": size, "space": space}
                    for label, size, space in (("t [s]", 34, 50), ("" if unit == "1" else unit, 48, 22))
                ),
                legend={"show": True, "live": False},
                height=200,
            )
        else:
            self._handle.data = data


class _JogButtons:
    """Buttons that jog. They work only for the browser that has ticked the box above them.

    Ticking the box begins the program of the jog, which preempts the running program.

    Args:
        server: Server of viser.
        jog: Function `robot.motion.jog`.
    """

    def __init__(self, server: Any, jog: Callable[..., Jog]) -> None:
        self._begin = jog
        self._block = contextlib.ExitStack()
        self._jog: Jog | None = None
        #: Client that has ticked the box.
        self._holder: int | None = None
        gui = server.gui
        with gui.add_folder("Jog"):
            self._said = gui.add_markdown("The arm moves while a button is held.")
            self._enabled = gui.add_checkbox("enable", False)
            self._frame = gui.add_dropdown("frame", get_args(FrameName))
            self._part = gui.add_slider("speed", 0.01, 1.0, 0.01, 0.1, hint="part of full speed")
            self._buttons = [gui.add_button("", disabled=True) for _ in range(12)]
        for number, button in enumerate(self._buttons):
            button.on_hold(self._move(number // 2, -1.0 if number % 2 else 1.0), _RATE)
        self._enabled.on_update(self._hold)
        server.on_client_disconnect(self._let_go)
        self._labelled: FrameName | None = None

    # viser awaits these functions in one thread. It calls other functions in several threads, which could change the
    # order.

    async def _hold(self, event: Any) -> None:
        self._holder = event.client_id if self._enabled.value else None

    async def _let_go(self, client: Any) -> None:
        if client.client_id == self._holder:
            self._holder, self._enabled.value = None, False

    def _move(self, axis: int, sign: float) -> Callable[[Any], Any]:
        async def move(event: Any) -> None:
            jog = self._jog
            if jog is None or event.client_id != self._holder:
                return
            speeds = [0.0] * 6
            speeds[axis] = sign * FULL_SPEED[jog.frame][axis] * self._part.value
            with contextlib.suppress(LinkError):  # `show` reports why the jog has ended
                jog.move(speeds)

        return move

    def show(self) -> None:
        """Begin or end the jog according to the box and the frame, and show the error if it failed."""
        jog, frame = self._jog, self._frame.value
        if jog is not None and (jog.done or self._holder is None or jog.frame != frame):
            error = jog.error
            self._stop()
            if error is not None:
                self._end(error)
        if self._jog is None and self._holder is not None:
            try:
                self._jog = self._block.enter_context(self._begin(frame, timeout=_EXPIRY, watchdog=_EXPIRY))
            except LinkError as error:
                self._end(error)
            else:
                self._said.content = f"Hold a button to move: **{frame}**"
        if self._labelled != frame:
            self._label(frame)
        for button in self._buttons:
            if button.disabled != (self._jog is None):
                button.disabled = self._jog is None

    def _end(self, error: Exception) -> None:
        self._holder, self._enabled.value = None, False
        self._said.content = f"**{type(error).__name__}**: {error}"

    def _label(self, frame: FrameName) -> None:
        self._labelled, names = frame, _NAMES["joints" if frame == "joints" else "base"]
        for number, button in enumerate(self._buttons):
            button.label = f"{names[number // 2]} {'−' if number % 2 else '+'}"

    def close(self) -> None:
        """End the jog permanently, if there is one. The arm brakes. Idempotent."""
        self._holder = None
        self._stop()

    def _stop(self) -> None:
        self._jog = None
        self._block.close()
