"""Buttons of a page that move an arm for as long as they are held."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any, get_args

from linkcore.errors import LinkError

from ..motion.jog import FULL_SPEED, FrameName, Jog

#: Messages a second while a button is held, and seconds after which the speed of one expires.
_RATE, _EXPIRY = 20.0, 0.25
_NAMES = {
    "joints": ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3"),
    "base": ("x", "y", "z", "about x", "about y", "about z"),
}


class JogButtons:
    """Buttons that jog, once a browser has ticked the box before them; then that browser alone.

    Ticking it begins the program of the jog, which preempts the one that runs.

    Args:
        server: of viser.
        jog: `robot.motion.jog`.
    """

    def __init__(self, server: Any, jog: Callable[..., Jog]) -> None:
        self._begin = jog
        self._block = contextlib.ExitStack()
        self._jog: Jog | None = None
        #: who has ticked the box
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

    # viser awaits these in one thread; those that it calls in several could change their order.

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
            with contextlib.suppress(LinkError):  # `show` says why it is over
                jog.move(speeds)

        return move

    def show(self) -> None:
        """Begin or end what the box and the frame ask for, and say how it ended."""
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
        """End the jog, if there is one, for good; the arm brakes. Idempotent."""
        self._holder = None
        self._stop()

    def _stop(self) -> None:
        self._jog = None
        self._block.close()
