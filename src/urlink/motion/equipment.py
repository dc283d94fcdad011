"""What every motion needs of its robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from linkcore.streaming.stream import Stream

from ..commanding.channel import Outlet
from ..commanding.programs import Scripts
from ..commanding.safety import Safety
from ..firmware import Firmware
from ..identity import Identity
from ..interfaces.realtime.packets import RealtimeState
from ..models import Model, UnknownModel, model

__all__ = ["Equipment"]


@dataclass(frozen=True)
class Equipment:
    """The robot, as motions use it.

    Attributes:
        scripts: uploads programs.
        outlet: sends set-points.
        safety: tells of stops.
        realtime: where the joints are, and the controller's clock.
        identity: tells who the controller is.
        host: where the controller is.
        reverse_host: address at which the robot finds this computer; None to find it out.
        reverse_port: port that its programs connect to; 0 for a free one.
    """

    scripts: Scripts
    outlet: Outlet
    safety: Safety
    realtime: Stream[RealtimeState]
    identity: Callable[[], Identity]
    host: str
    reverse_host: str | None
    reverse_port: int

    @property
    def firmware(self) -> Firmware:
        """What the controller runs."""
        return self.identity().firmware

    @property
    def model(self) -> Model | None:
        """The arm; None if the controller does not say, or its limits are not known."""
        name = self.identity().model
        try:
            return None if name is None else model(name)
        except UnknownModel:
            return None

    def state(self) -> RealtimeState:
        """The newest state, or the next one.

        Raises:
            LinkTimeout, RemoteError: none comes.
        """
        return self.realtime.latest or self.realtime.wait()
