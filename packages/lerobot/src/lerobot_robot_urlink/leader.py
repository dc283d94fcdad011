"""Teleoperator "ur_leader": an arm that a person moves by hand, and that another arm follows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from lerobot.teleoperators import Teleoperator, TeleoperatorConfig
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

import urlink

from .joints import POSITIONS, named, newest

__all__ = ["URLeader", "URLeaderConfig"]


@TeleoperatorConfig.register_subclass("ur_leader")
@dataclass(kw_only=True)
class URLeaderConfig(TeleoperatorConfig):
    """Configuration of the leading arm.

    Attributes:
        address: Address of its controller.
    """

    address: str


class URLeader(Teleoperator):
    """Arm whose joint positions are actions.

    It is only read. To move it, a person presses its freedrive button.
    """

    config_class = URLeaderConfig
    name = "ur_leader"

    def __init__(self, config: URLeaderConfig) -> None:
        super().__init__(config)
        self.config = config
        self._robot: urlink.Robot | None = None

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Names and types of the joint positions."""
        return dict.fromkeys(POSITIONS, float)

    @cached_property
    def feedback_features(self) -> dict[str, type]:
        """Names and types of feedback; empty, because the arm accepts none."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether the arm is connected."""
        return self._robot is not None

    def connect(self, calibrate: bool = True) -> None:
        """Connect to the controller, read-only.

        Raises:
            DeviceAlreadyConnectedError: If it is already connected.
            LinkError: If the controller cannot be reached.
        """
        if self._robot is not None:
            raise DeviceAlreadyConnectedError(f"{self} is already connected")
        robot = urlink.connect(self.config.address, read_only=True)
        try:
            robot.realtime.wait(5.0)
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

    def get_action(self) -> dict[str, float]:
        """Return the joint positions.

        Raises:
            DeviceNotConnectedError: If it is not connected.
            LinkTimeout: If no state has arrived from the arm for a second.
        """
        if self._robot is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return named(POSITIONS, newest(self._robot).q_actual.tolist())

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing, because the arm accepts no feedback."""

    def disconnect(self) -> None:
        """Disconnect; do nothing if it is not connected."""
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()
