"""Topics that move the arm: positions, velocities, freedrive and scripts, with the names of the vendor's driver.

The first message enters a block of `robot.motion`, and a silence ends it. If a stop, another motion or an error has
ended the block, it is not entered again until its topic has been silent for the same time. A client that keeps sending
has not requested the motion again.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from std_msgs.msg import Bool, Float64MultiArray, String

from linkcore import clock
from urlink import Expiry, LinkError, PendingCall, Robot

from .states import STREAMED

__all__ = ["CommandTopics"]

_log = logging.getLogger("urlink.ros2")

#: Silence, in s, after which a block ends: for positions and velocities, and for freedrive, where the vendor's driver
#: uses the same time.
_SILENT, _FREEDRIVE = 0.3, 1.0
#: Maximum time, in s, for a block to end.
_END = 5.0


class CommandTopics:
    """Topics of one robot on which clients command motions.

    Args:
        node: Node that subscribes to them.
        robot: Robot to move.
        expiry: Check for messages that might be late. Late messages are not executed.
    """

    def __init__(self, node: Any, robot: Robot, expiry: Expiry) -> None:
        self._robot = robot
        self._expiry = expiry
        group = ReentrantCallbackGroup()
        self._topics = []
        for kind, name, topic in (
            (
                Float64MultiArray,
                "forward_position_controller/commands",
                _BlockTopic(
                    "positions",
                    partial(robot.motion.servo, target_filter="jerk_limited"),
                    lambda servo, message: servo.send(list(message.data)),
                    _SILENT,
                ),
            ),
            (
                Float64MultiArray,
                "forward_velocity_controller/commands",
                _BlockTopic(
                    "velocities",
                    partial(robot.motion.jog, "joints", timeout=_SILENT),
                    lambda jog, message: jog.move(list(message.data)),
                    _SILENT,
                ),
            ),
            (
                Bool,
                "freedrive_mode_controller/enable_freedrive_mode",
                _BlockTopic(
                    "freedrive", robot.freedrive, lambda freedrive, message: None, _FREEDRIVE, lambda m: bool(m.data)
                ),
            ),
        ):
            self._topics.append(topic)
            node.create_subscription(kind, name, partial(self._take, topic), STREAMED, callback_group=group)
        node.create_subscription(String, "urscript_interface/script_command", self._run, 10, callback_group=group)

    def end(self) -> None:
        """End all blocks. Do not wait for their end."""
        for topic in self._topics:
            topic.end()

    def wait_ended(self, seconds: float = _END) -> None:
        """Wait until all blocks have ended, at most `seconds` for each."""
        for topic in self._topics:
            topic.wait_ended(seconds)

    def _take(self, topic: _BlockTopic, message: Any) -> None:
        try:
            self._expiry.check()
        except LinkError as error:
            _log.warning("%s: message rejected: %s", topic.name, error)
        else:
            topic.take(message)

    def _run(self, message: Any) -> None:
        try:
            self._expiry.check()
            self._robot.script.run(message.data)
        except LinkError as error:
            _log.warning("script not run: %s", error)


class _BlockTopic:
    """A block, and the messages for it.

    Args:
        name: Name of the block, used in log messages.
        enter: Function that opens the block.
        obey: Function that executes a message in the block.
        silent: Silence, in s, after which the block ends.
        wants: Function that returns whether a message requests the block. A message that does not ends the block.
    """

    def __init__(
        self,
        name: str,
        enter: Callable[[], AbstractContextManager[Any]],
        obey: Callable[[Any, Any], object],
        silent: float,
        wants: Callable[[Any], bool] = lambda message: True,
    ) -> None:
        self.name = name
        self._enter = enter
        self._obey = obey
        self._silent = silent
        self._wants = wants
        #: only the newest message counts; None ends the block
        self._messages: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._turn = threading.Lock()
        self._thread: threading.Thread | None = None
        self._is_over = False

    def take(self, message: Any) -> None:
        """Follow a message; the first message enters the block."""
        with self._turn:
            if self._is_over or (self._thread is None and not self._wants(message)):
                return
            self._messages.put(message)
            if self._thread is None:
                lead = partial(self._lead, PendingCall())
                self._thread = threading.Thread(target=lead, name=f"urlink-ros2 {self.name}", daemon=True)
                self._thread.start()

    def end(self) -> None:
        with self._turn:
            self._is_over = True
            self._messages.put(None)

    def wait_ended(self, seconds: float) -> None:
        thread = self._thread
        if thread is not None:
            clock.join(thread, seconds)

    def _lead(self, call: PendingCall) -> None:
        try:
            with contextlib.ExitStack() as entered:
                block = call.make(lambda: entered.enter_context(self._enter()))
                while (message := self._next()) is not None:
                    self._obey(block, message)
        except LinkError as error:
            _log.warning("%s: no longer followed: %s", self.name, error)
            while self._next() is not None:
                continue
        finally:
            with self._turn:
                self._thread = None
                self._messages = queue.SimpleQueue()

    def _next(self) -> Any:
        """Return the newest message; None if the block must end."""
        try:
            message = clock.get(self._messages, self._silent)
            while message is not None and not self._messages.empty():
                message = self._messages.get_nowait()
        except queue.Empty:
            return None
        return message if message is not None and self._wants(message) else None
