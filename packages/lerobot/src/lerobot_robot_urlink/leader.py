"""The teleoperator "ur_leader": an arm that a person leads by hand, and another one follows."""

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
    """Which arm leads.

    Attributes:
        address: of its controller.
    """

    address: str


class URLeader(Teleoperator):
    """An arm whose joint positions are actions. It is only read: a person lets it go by the button for freedrive."""

    config_class = URLeaderConfig
    name = "ur_leader"

    def __init__(self, config: URLeaderConfig) -> None:
        super().__init__(config)
        self.config = config
        self._robot: urlink.Robot | None = None

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Positions of the joints."""
        return dict.fromkeys(POSITIONS, float)

    @cached_property
    def feedback_features(self) -> dict[str, type]:
        """It takes none."""
        return {}

    @property
    def is_connected(self) -> bool:
        """It is connected."""
        return self._robot is not None

    def connect(self, calibrate: bool = True) -> None:
        """Connect to the controller, to read.

        Raises:
            DeviceAlreadyConnectedError: it is connected.
            LinkError: the controller is not there.
        """
        if self._robot is not None:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        robot = urlink.connect(self.config.address, read_only=True)
        try:
            robot.realtime.wait(5.0)
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

    def get_action(self) -> dict[str, float]:
        """Where the joints are.

        Raises:
            DeviceNotConnectedError: it is not connected.
            LinkTimeout: nothing has come of the arm for a second.
        """
        if self._robot is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return named(POSITIONS, newest(self._robot).q_actual.tolist())

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """It takes none."""

    def disconnect(self) -> None:
        """Disconnect; without effect if it is not connected."""
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()
