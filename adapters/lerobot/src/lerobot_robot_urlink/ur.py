"""The robot "ur": observations out of the real-time stream, actions as set-points of a servo."""

from __future__ import annotations

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

from .joints import POSITIONS, STATE_TIMEOUT, TOOL, VELOCITIES, named, newest

__all__ = ["UR", "URConfig"]


@RobotConfig.register_subclass("ur")
@dataclass(kw_only=True)
class URConfig(RobotConfig):
    """How an arm is used.

    Attributes:
        address: of the controller: ``192.168.56.101``, or ``sim://ur5e``.
        fps: actions a second that are meant to be sent.
        max_step: rad that a joint is led further by one action, at most; what an action asks for beyond is left out.
        watchdog: seconds without an action after which the robot brakes by itself.
        observe_tool: pose and force of the tool are part of an observation.
        cameras: name -> configuration of a camera.
    """

    address: str
    fps: float = 30.0
    max_step: float = 0.04
    watchdog: float = 0.5
    observe_tool: bool = True
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


class UR(Robot):
    """An arm as LeRobot has it.

    The arm moves from the first action on, by a servo of the library: it passes the interlock, ends with a stop, whose
    error the next action raises, and brakes by itself where no action comes for `URConfig.watchdog` seconds, also
    because this process has died. After such an end the next action begins anew from where the arm is.
    """

    config_class = URConfig
    name = "ur"

    def __init__(self, config: URConfig) -> None:
        super().__init__(config)
        if not (0.0 < config.fps <= 500.0 and config.max_step > 0.0):
            raise BadValue(f"fps={config.fps}, max_step={config.max_step}; expected 0 to 500, and more than 0")
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        self._robot: urlink.Robot | None = None
        self._servo: urlink.motion.Servo | None = None
        self._led: Any = None

    # -- what it has -----------------------------------------------------------------------------------

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """Positions and velocities of the joints, what the tool does, and pictures."""
        names = [*POSITIONS, *VELOCITIES, *(TOOL if self.config.observe_tool else ())]
        pictures = {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}
        return dict.fromkeys(names, float) | pictures

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Positions of the joints."""
        return dict.fromkeys(POSITIONS, float)

    # -- its connection --------------------------------------------------------------------------------

    @property
    def is_connected(self) -> bool:
        """The arm and every camera are."""
        return self._robot is not None and all(camera.is_connected for camera in self.cameras.values())

    def connect(self, calibrate: bool = True) -> None:
        """Connect to the controller and the cameras; the arm does not move.

        Raises:
            DeviceAlreadyConnectedError: it is connected.
            LinkError: the controller is not there.
        """
        if self._robot is not None:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        robot = urlink.connect(self.config.address)
        try:
            robot.realtime.wait(5.0)
            for camera in self.cameras.values():
                camera.connect()
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
        try:
            self._end_servo()
        finally:
            robot.close()
            for camera in self.cameras.values():
                camera.disconnect()

    # -- the loop --------------------------------------------------------------------------------------

    def get_observation(self) -> dict[str, Any]:
        """The newest state of the arm, and pictures.

        Raises:
            DeviceNotConnectedError: it is not connected.
            LinkTimeout: nothing has come of the arm for a second.
        """
        state = newest(self._connected())
        found: dict[str, Any] = named(POSITIONS, state.q_actual.tolist()) | named(VELOCITIES, state.qd_actual.tolist())
        if self.config.observe_tool:
            found |= named(TOOL, [*state.tool_vector_actual.tolist(), *state.tcp_force.tolist()])
        for name, camera in self.cameras.items():
            found[name] = camera.async_read()
        return found

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Lead the arm towards the positions of an action.

        Returns:
            the positions that were sent: no joint further than `URConfig.max_step` from where it was led before, and
            none beyond its limits.

        Raises:
            DeviceNotConnectedError: it is not connected.
            BadValue: a joint is missing, or is no finite number; nothing was sent.
            SafetyStop, NotRunning, NotEnabled: the arm may not be moved now.
            LinkError: what else ended the servo.
        """
        robot = self._connected()
        try:
            wanted = np.array([float(action[name]) for name in POSITIONS])
        except (KeyError, TypeError, ValueError) as error:
            raise BadValue(f"an action needs {', '.join(POSITIONS)}: {error!r}") from None
        if not np.isfinite(wanted).all():
            raise BadValue(f"an action of {wanted.tolist()}; expected finite numbers")
        servo = self._servo
        if servo is None:
            servo = robot.motion.servo(self.config.fps, watchdog=self.config.watchdog)
            servo.__enter__()
            self._servo, self._led = servo, robot.realtime.wait(STATE_TIMEOUT).q_target
        limits = robot.kinematics.position_limits
        step = self.config.max_step
        q = np.clip(np.clip(wanted, limits[:, 0], limits[:, 1]), self._led - step, self._led + step)
        try:
            servo.send(q)
        except BadValue:
            raise
        except urlink.LinkError:
            self._end_servo()
            raise
        self._led = q
        return named(POSITIONS, q.tolist())

    def _end_servo(self) -> None:
        servo, self._servo = self._servo, None
        if servo is not None:
            servo.__exit__(None, None, None)

    def _connected(self) -> urlink.Robot:
        if self._robot is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return self._robot
