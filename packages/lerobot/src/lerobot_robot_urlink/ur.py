"""The robot "ur": observations out of the real-time stream, actions as set-points of a servo, chunks as a stream."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from lerobot.cameras import CameraConfig
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import urlink
from urlink import BadValue

from .actions import KINDS, Actions, pose_numbers
from .fingers import Fingers, closing
from .joints import FORCE, GRIPPER, POSE, POSITIONS, STATE_TIMEOUT, VELOCITIES, named, newest

__all__ = ["UR", "URConfig"]


@RobotConfig.register_subclass("ur")
@dataclass(kw_only=True)
class URConfig(RobotConfig):
    """How an arm is used.

    Attributes:
        address: of the controller: ``192.168.56.101``, or ``sim://ur5e``.
        fps: actions a second that are meant to be sent.
        action: what an action is: ``joints``, ``joint_deltas``, ``pose`` or ``pose_deltas``.
        max_step: rad that a joint is led further by one action, at most; what an action asks for beyond is left out.
        watchdog: seconds without an action after which the robot brakes by itself.
        gripper: a Robotiq gripper is part of observations and actions. Connecting activates it: **the fingers close and
            open** unless it is active.
        observe_tool: the pose of the tool is part of an observation.
        observe_force: the force at the tool is, too; ``lerobot-rollout`` leaves it out.
        cameras: name -> configuration of a camera.
    """

    address: str
    fps: float = 30.0
    action: str = "joints"
    max_step: float = 0.04
    watchdog: float = 0.5
    gripper: bool = False
    observe_tool: bool = True
    observe_force: bool = False
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class UR(Robot):
    """An arm as LeRobot has it.

    The arm moves from the first action on, by a servo of the library: it passes the interlock, ends with a stop, whose
    error the next action raises, and brakes by itself where no action comes for `URConfig.watchdog` seconds, also
    because this process has died. After such an end the next action begins anew from where the arm is. Chunks of
    actions are points of a stream of the library, for which the same holds; the arm brakes where they end.

    The fingers of a gripper are moved by an action only after its part for the arm was accepted.
    """

    config_class = URConfig
    name = "ur"

    def __init__(self, config: URConfig) -> None:
        super().__init__(config)
        if not (0.0 < config.fps <= 500.0 and config.max_step > 0.0):
            raise BadValue(f"fps={config.fps}, max_step={config.max_step}; expected 0 to 500, and more than 0")
        if config.action not in KINDS:
            raise BadValue(f"action={config.action!r}; expected one of {', '.join(KINDS)}")
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        self._robot: urlink.Robot | None = None
        self._fingers: Fingers | None = None
        #: how the arm is led now: by actions, or by chunks of them; what they mean, and where they have led it
        self._way: urlink.motion.Servo | urlink.motion.PointStream | None = None
        self._actions: Actions | None = None
        self._led: Any = None
        #: where the arm was led at the last observation, and the time of the stream then, s
        self._observed: tuple[Any, float] | None = None

    # -- what it has -----------------------------------------------------------------------------------

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """Positions and velocities of the joints, where the tool is, the gripper, and pictures."""
        config = self.config
        names = [*POSITIONS, *VELOCITIES, *(POSE if config.observe_tool else ())]
        names += [*([GRIPPER] if config.gripper else []), *(FORCE if config.observe_force else ())]
        pictures = {name: (camera.height, camera.width, 3) for name, camera in config.cameras.items()}
        return dict.fromkeys(names, float) | pictures

    @cached_property
    def action_features(self) -> dict[str, type]:
        """What `URConfig.action` says, and the gripper."""
        return dict.fromkeys([*KINDS[self.config.action], *([GRIPPER] if self.config.gripper else [])], float)

    # -- its connection --------------------------------------------------------------------------------

    @property
    def is_connected(self) -> bool:
        """The arm and every camera are."""
        return self._robot is not None and all(camera.is_connected for camera in self.cameras.values())

    def connect(self, calibrate: bool = True) -> None:
        """Connect to the controller, the gripper and the cameras; the arm does not move.

        Raises:
            DeviceAlreadyConnectedError: it is connected.
            LinkError: the controller, or the gripper, is not there.
        """
        if self._robot is not None:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        robot = urlink.connect(self.config.address)
        try:
            robot.realtime.wait(5.0)
            for camera in self.cameras.values():
                camera.connect()
            self._fingers = Fingers(robot) if self.config.gripper else None
        except BaseException:
            robot.close()
            raise
        self._robot = robot

    @property
    def is_calibrated(self) -> bool:
        """An arm of this kind knows where its joints are."""
        return True

    def calibrate(self) -> None:
        """Nothing has to be done."""

    def configure(self) -> None:
        """Nothing has to be done."""

    def disconnect(self) -> None:
        """Let the arm stand, and disconnect; without effect if it is not connected."""
        robot, self._robot = self._robot, None
        if robot is None:
            return
        fingers, self._fingers = self._fingers, None
        try:
            self._end_way()
        finally:
            if fingers is not None:
                fingers.close()
            robot.close()
            for camera in self.cameras.values():
                camera.disconnect()

    # -- the loop --------------------------------------------------------------------------------------

    def get_observation(self) -> dict[str, Any]:
        """The newest state of the arm, and pictures.

        Raises:
            DeviceNotConnectedError: it is not connected.
            LinkTimeout: nothing has come of the arm for a second.
            GripperFault: of the gripper, since the last action or observation.
        """
        state = newest(self._connected())
        stream = self._way if isinstance(self._way, urlink.motion.PointStream) else None
        self._observed = state.q_target, 0.0 if stream is None else stream.time
        found: dict[str, Any] = named(POSITIONS, state.q_actual.tolist()) | named(VELOCITIES, state.qd_actual.tolist())
        if self.config.observe_tool:
            found |= named(POSE, pose_numbers(state.tool_vector_actual))
        if self._fingers is not None:
            self._fingers.check()
            found[GRIPPER] = self._fingers.position()
        if self.config.observe_force:
            found |= named(FORCE, state.tcp_force.tolist())
        for name, camera in self.cameras.items():
            found[name] = camera.async_read()
        return found

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Lead the arm by an action.

        Returns:
            the action that was sent: no joint further than `URConfig.max_step` from where it was led before, and none
            beyond its limits.

        Raises:
            DeviceNotConnectedError: it is not connected.
            BadValue: a number is missing or not finite, or a pose is too far away; nothing was sent.
            Unreachable: a pose is out of reach; nothing was sent.
            SafetyStop, NotRunning, NotEnabled: the arm may not be moved now.
            GripperFault: of the gripper, since the last action or observation; nothing was sent.
            LinkError: what else ended the servo.
        """
        robot, actions, fingers = self._connected(), self._meaning(), self._fingers
        values, wanted = actions.read(action), None if fingers is None else closing(action)
        if fingers is not None:
            fingers.check()
        servo = self._way
        if not isinstance(servo, urlink.motion.Servo):
            self._end_way()
            servo = robot.motion.servo(self.config.fps, watchdog=self.config.watchdog)
            servo.__enter__()
            self._way, self._led = servo, robot.realtime.wait(STATE_TIMEOUT).q_target
        led = self._led
        q = actions.lead(values, led)
        try:
            servo.send(q)
        except BadValue:
            raise
        except urlink.LinkError:
            self._end_way()
            raise
        self._led = q
        sent = actions.named(q, led)
        if fingers is not None and wanted is not None:
            fingers.wanted = lambda: wanted
            sent[GRIPPER] = wanted / 255.0
        return sent

    def send_chunk(self, chunk: Sequence[dict[str, Any]], period: float | None = None) -> list[dict[str, float]]:
        """Lead the arm through the actions of a policy that has seen the last observation.

        The first action is for the moment of that observation, the next for `period` s later. They replace what is left
        of the chunk before: the arm goes over to where they are by now, with continuous speed and acceleration, and
        brakes at the end unless another chunk comes. The chunk may be late by its own length.

        Args:
            chunk: two actions or more.
            period: s from one to the next; None for that of `URConfig.fps`.

        Returns:
            the actions that were sent: of each no joint is further than `URConfig.max_step` from the one before, and of
            the first from where the arm was led at the observation.

        Raises:
            LocalError: nothing was observed; or firmware before 3.4.
            BadValue: as for `send_action`; or all of them are past, or too far apart for the arm. Nothing was sent.
            DeviceNotConnectedError, Unreachable, SafetyStop, NotRunning, NotEnabled, LinkError: as for `send_action`.
        """
        robot, actions, fingers = self._connected(), self._meaning(), self._fingers
        if self._observed is None:
            raise urlink.LocalError("a chunk begins at the last observation; call get_observation first")
        led, since = self._observed
        seconds = 1.0 / self.config.fps if period is None else period
        wanted = [] if fingers is None else [closing(action) for action in chunk]
        path, sent = [], []
        for action in chunk:
            q = actions.lead(actions.read(action), led)
            sent.append(actions.named(q, led))
            path.append(q)
            led = q
        trajectory = urlink.Trajectory.from_arrays(seconds * np.arange(len(path)), np.array(path))
        if fingers is not None:
            fingers.check()
        stream = self._way
        if not isinstance(stream, urlink.motion.PointStream):
            self._end_way()
            stream, since = robot.motion.stream(watchdog=self.config.watchdog), 0.0
            stream.__enter__()
            self._way = stream
        try:
            stream.replace(since, trajectory)
        except BadValue:
            raise
        except urlink.LinkError:
            self._end_way()
            raise
        if fingers is not None:
            begun, last = stream, len(wanted) - 1
            fingers.wanted = lambda: wanted[min(max(int((begun.time - since) / seconds), 0), last)]
            sent = [each | {GRIPPER: position / 255.0} for each, position in zip(sent, wanted, strict=True)]
        return sent

    def _meaning(self) -> Actions:
        if self._actions is None or self._way is None:
            robot = self._connected()
            self._actions = Actions.of(self.config.action, robot, newest(robot), self.config.max_step)
        return self._actions

    def _end_way(self) -> None:
        way, self._way = self._way, None
        if self._fingers is not None:
            self._fingers.wanted = lambda: None
        if way is not None:
            way.__exit__(None, None, None)

    def _connected(self) -> urlink.Robot:
        if self._robot is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return self._robot
