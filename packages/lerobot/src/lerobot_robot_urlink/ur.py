"""Robot "ur": observations from the real-time stream, actions as set-points of a servo, chunks as a point stream."""

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


#: Time in s after an interruption of this process during which no action restarts the arm.
_SETTLING = 5.0


@RobotConfig.register_subclass("ur")
@dataclass(kw_only=True)
class URConfig(RobotConfig):
    """Configuration of an arm.

    Attributes:
        address: Address of the controller: ``192.168.56.101``, or ``sim://ur5e``.
        fps: Intended number of actions per second.
        action: Kind of action: ``joints``, ``joint_deltas``, ``pose`` or ``pose_deltas``.
        max_step: Maximum change of a joint's set-point by one action, in rad. Any excess is left out.
        watchdog: Time, in s, without an action after which the robot brakes on its own, 0.1 to 2.
        restart_after_pause: Whether an action after such a pause moves the arm again, instead of raising
            `ConnectionLost`. LeRobot's asynchronous inference needs this, because it pauses while a slow policy
            computes. After this process was interrupted for more than 2 s, the action is rejected nevertheless.
        gripper: Whether a Robotiq gripper is part of observations and actions. Connecting activates it: **the fingers
            close and open** unless it is active.
        observe_tool: Whether the pose of the tool is part of an observation.
        observe_force: Whether the force at the tool is part of an observation. ``lerobot-rollout`` ignores it.
        limits: Limits of the session: the path of a JSON file, or ``teaching`` (`urlink.SessionLimits.named`); empty
            for none. An action that would exceed a limit raises `urlink.LimitExceeded`.
        cameras: Configurations of the cameras, by name.
    """

    address: str
    fps: float = 30.0
    action: str = "joints"
    max_step: float = 0.04
    watchdog: float = 0.5
    restart_after_pause: bool = False
    gripper: bool = False
    observe_tool: bool = True
    observe_force: bool = False
    limits: str = ""
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class UR(Robot):
    """Universal Robots arm as a robot of LeRobot.

    The first action starts a servo of urlink, which moves the arm. The servo passes the interlock, and ends when the
    robot stops; the next action raises the error of the stop. If no action arrives for `URConfig.watchdog` seconds, the
    arm brakes on its own, even if this process has died. After such an end, the next action starts again from the
    current position of the arm. Chunks of actions are points of a point stream of urlink, which behaves in the same
    way. The arm brakes at the end of a chunk.

    An action moves the fingers of a gripper only after its part for the arm was accepted.
    """

    config_class = URConfig
    name = "ur"

    def __init__(self, config: URConfig) -> None:
        super().__init__(config)
        if not (0.0 < config.fps <= 500.0 and config.max_step > 0.0):
            raise BadValue(
                f"fps={config.fps}, max_step={config.max_step}; expected fps above 0 and at most 500, "
                "and max_step above 0"
            )
        if config.action not in KINDS:
            raise BadValue(f"action={config.action!r}; expected one of {', '.join(KINDS)}")
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        self._robot: urlink.Robot | None = None
        self._fingers: Fingers | None = None
        self._expiry: urlink.Expiry | None = None
        #: current servo (for actions) or point stream (for chunks); meaning of the actions; last set-points of the
        #: joints
        self._way: urlink.motion.Servo | urlink.motion.PointStream | None = None
        self._actions: Actions | None = None
        self._commanded: Any = None
        #: set-points of the joints at the last observation, and the time of the stream, in s
        self._observed: tuple[Any, float] | None = None
        #: delay of the last chunk, and the time of its first action on the clock of the stream, in s
        self._chunk_delay = self._chunk_since = 0.0

    # -- features --------------------------------------------------------------------------------------

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """Names and types of joint values, pose of the tool, gripper, force, and images."""
        config = self.config
        names = [*POSITIONS, *VELOCITIES, *(POSE if config.observe_tool else ())]
        names += [*([GRIPPER] if config.gripper else []), *(FORCE if config.observe_force else ())]
        pictures = {name: (camera.height, camera.width, 3) for name, camera in config.cameras.items()}
        return dict.fromkeys(names, float) | pictures

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Names and types of the numbers of `URConfig.action`, and of the gripper."""
        return dict.fromkeys([*KINDS[self.config.action], *([GRIPPER] if self.config.gripper else [])], float)

    # -- connection ------------------------------------------------------------------------------------

    @property
    def is_connected(self) -> bool:
        """Whether the arm and every camera are connected."""
        return self._robot is not None and all(camera.is_connected for camera in self.cameras.values())

    def connect(self, calibrate: bool = True) -> None:
        """Connect to the controller, the gripper and the cameras; the arm does not move.

        Raises:
            DeviceAlreadyConnectedError: If it is already connected.
            LinkError: If the controller or the gripper cannot be reached.
        """
        if self._robot is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        limits = urlink.SessionLimits.named(self.config.limits) if self.config.limits else None
        robot = urlink.connect(self.config.address, limits=limits)
        try:
            robot.realtime.wait(5.0)
            for camera in self.cameras.values():
                camera.connect()
            self._fingers = Fingers(robot) if self.config.gripper else None
            if self.config.restart_after_pause:
                # The states of the arm show that this process runs, and that it was not suspended.
                self._expiry = expiry = urlink.Expiry(_SETTLING)
                robot.realtime.subscribe(lambda state: expiry.tick(), inline=True)
        except BaseException:
            robot.close()
            raise
        self._robot = robot

    @property
    def is_calibrated(self) -> bool:
        """Whether the arm is calibrated; always true, because its joints need no calibration."""
        return True

    def calibrate(self) -> None:
        """Do nothing, because no calibration is needed."""

    def configure(self) -> None:
        """Do nothing, because no configuration is needed."""

    def disconnect(self) -> None:
        """Stop the arm and disconnect; do nothing if it is not connected."""
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

    # -- control loop ----------------------------------------------------------------------------------

    def get_observation(self) -> dict[str, Any]:
        """Return the newest state of the arm, and images.

        Raises:
            DeviceNotConnectedError: If it is not connected.
            LinkTimeout: If no state has arrived from the arm for a second.
            GripperFault: If the gripper reported a fault since the last action or observation.
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
        """Move the arm by an action.

        Returns:
            The action that was sent. No joint moves further than `URConfig.max_step` from its previous set-point, or
            beyond its limits.

        Raises:
            DeviceNotConnectedError: If it is not connected.
            BadValue: If a number is missing or not finite, or a pose is too far away. Nothing is sent.
            Unreachable: If a pose is out of reach. Nothing is sent.
            SafetyStop, NotRunning, NotEnabled: If the arm must not be moved now.
            GripperFault: If the gripper reported a fault since the last action or observation. Nothing is sent.
            ConnectionLost: If the arm has braked because no action came within `URConfig.watchdog` seconds, unless
                `URConfig.restart_after_pause` is set.
            LinkTimeout: If this process was recently interrupted, so that the action might be too old.
            LinkError: If another error ended the servo.
        """
        robot, actions, fingers = self._connected(), self._meaning(), self._fingers
        values, wanted = actions.read(action), None if fingers is None else closing(action)
        if fingers is not None:
            fingers.check()
        try:
            sent = self._move(robot, actions, values)
        except urlink.ConnectionLost:
            if self._expiry is None:
                raise
            self._expiry.check()
            sent = self._move(robot, actions, values)
        if fingers is not None and wanted is not None:
            fingers.wanted = lambda: wanted
            sent[GRIPPER] = wanted / 255.0
        return sent

    def _move(self, robot: urlink.Robot, actions: Actions, values: Any) -> dict[str, float]:
        """Send one set-point, and return the action that was sent."""
        servo = self._way
        if not isinstance(servo, urlink.motion.Servo):
            self._end_way()
            servo = robot.motion.servo(self.config.fps, watchdog=self.config.watchdog)
            servo.__enter__()
            self._way, self._commanded = servo, robot.realtime.wait(STATE_TIMEOUT).q_target
        commanded = self._commanded
        q = actions.setpoints(values, commanded)
        try:
            servo.send(q)
        except BadValue:
            raise
        except urlink.LinkError:
            self._end_way()
            raise
        self._commanded = q
        return actions.named(q, commanded)

    @property
    def chunk_delay(self) -> float:
        """Time in s from the observation of the last chunk until the chunk took effect; 0.0 before the first chunk.

        Divided by the period of the chunk, it is the delay of real-time chunking. The first chunk of a motion has no
        delay, because the arm is at rest until it arrives.
        """
        return self._chunk_delay

    @property
    def chunk_time(self) -> float:
        """Time in s from the first action of the last chunk to the last observation, as the arm executes it.

        Divided by the period of the chunk, it is the number of actions that the arm has executed. It does not grow
        while the arm is paused, or rests at the end of the chunk. It is 0.0 before the first chunk.
        """
        return 0.0 if self._observed is None else max(self._observed[1] - self._chunk_since, 0.0)

    def send_chunk(
        self, chunk: Sequence[dict[str, Any]], period: float | None = None, *, frozen: int = 0
    ) -> list[dict[str, float]]:
        """Move the arm through the actions that a policy computed from the last observation.

        The first action is for the moment of that observation, and each further action for `period` s later. The chunk
        replaces the rest of the previous chunk. The arm changes to the current point of the new chunk with continuous
        speed and acceleration, and brakes at its end unless another chunk arrives. A chunk may be late by up to its own
        length.

        Args:
            chunk: At least two actions.
            period: Time between two actions, in s; None for the period of `URConfig.fps`.
            frozen: Number of first actions that the arm takes from the previous chunk, for real-time chunking: the
                chunk takes effect after them. It has no effect if the arm is at rest.

        Returns:
            The actions that were sent. No joint moves further than `URConfig.max_step` from one action to the next, or
            from its set-point at the observation to the first action.

        Raises:
            LocalError: If there was no observation, or the firmware is older than 3.4.
            BadValue: If `send_action` would raise it, if all actions are in the past, if they are too far apart for
                the arm, if fewer than two actions follow the frozen ones, or if `period` is invalid. Nothing is sent.
            DeviceNotConnectedError, Unreachable, SafetyStop, NotRunning, NotEnabled, LinkError: If `send_action` would
                raise it.
        """
        robot, actions, fingers = self._connected(), self._meaning(), self._fingers
        if self._observed is None:
            raise urlink.LocalError("a chunk needs an observation to start from; call get_observation first")
        if len(chunk) < 2:
            raise BadValue(f"the chunk has {len(chunk)} actions; expected at least 2")
        if isinstance(frozen, bool) or not isinstance(frozen, int) or not 0 <= frozen <= len(chunk) - 2:
            raise BadValue(f"frozen={frozen!r}; expected 0 to {len(chunk) - 2}, so that two actions are left")
        commanded, since = self._observed
        seconds = 1.0 / self.config.fps if period is None else period
        if not seconds > 0.0:
            raise BadValue(f"period={period!r}; expected a time above 0 s")
        wanted = [] if fingers is None else [closing(action) for action in chunk]
        path, sent = [], []
        for action in chunk:
            q = actions.setpoints(actions.read(action), commanded)
            sent.append(actions.named(q, commanded))
            path.append(q)
            commanded = q
        if fingers is not None:
            fingers.check()
        stream = self._way
        if not isinstance(stream, urlink.motion.PointStream):
            self._end_way()
            stream, since = robot.motion.stream(watchdog=self.config.watchdog), 0.0
            stream.__enter__()
            self._way = stream
        if stream.is_dry:
            frozen = 0
        # With the speeds of the neighbouring actions, a chunk may begin and end while the arm moves.
        speeds = np.gradient(np.array(path), seconds, axis=0)
        points = [
            urlink.TrajectoryPoint(path[k], since + seconds * k, speeds[k]) for k in range(max(frozen, 1), len(path))
        ]
        try:
            self._chunk_delay = stream.replace(since + seconds * frozen, points) - since
            self._chunk_since = since
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
