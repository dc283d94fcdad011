"""All that commands one robot, wired up: the gate, the outlet, and who sends by it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from linkcore.errors import Closed, LinkError, LocalError
from linkcore.streaming.stream import Stream

from ..identity import Identity
from ..interfaces.primary.robot_state import RobotState
from ..interfaces.realtime.packets import RealtimeState
from .channel import Outlet
from .interlock import Policy
from .io import IO
from .programs import Scripts
from .safety import Safety

if TYPE_CHECKING:
    from ..interfaces.dashboard.client import Dashboard
    from ..motion import Motions

__all__ = ["Control"]

_log = logging.getLogger(__name__)


class Control:
    """What a robot is commanded by; nothing connects before it is used.

    Args:
        host: where the controller is.
        dashboard_port: of its dashboard; None if it serves none.
        primary: makes the primary stream.
        realtime: makes the real-time stream.
        identity: tells who the controller is.
        policy: whether a person has to enable motions.
        reverse_host: address at which the robot finds this computer; None to find it out.
        reverse_port: port for what the robot's programs connect to; 0 for a free one.
        timeout: seconds for a connection to the dashboard.
    """

    def __init__(
        self,
        host: str,
        dashboard_port: int | None,
        primary: Callable[[], Stream[RobotState]],
        realtime: Callable[[], Stream[RealtimeState]],
        identity: Callable[[], Identity],
        *,
        policy: Policy,
        reverse_host: str | None,
        reverse_port: int,
        timeout: float,
    ) -> None:
        self._host = host
        self._dashboard_port = dashboard_port
        self._realtime = realtime
        self._identity = identity
        self._reverse_host = reverse_host
        self._reverse_port = reverse_port
        self._timeout = timeout
        self._lock = threading.Lock()
        self._is_closed = False
        self._motion: Motions | None = None
        self._dashboard: Dashboard | None = None
        self.safety = Safety(primary, realtime, policy)
        self.outlet = Outlet(primary, self.safety)
        self.script = Scripts(primary, self.outlet, self.safety)
        self.io = IO(self.outlet, primary, lambda: identity().firmware)

    @property
    def motion(self) -> Motions:
        """Moves the arm."""
        with self._lock:
            if self._motion is None:
                from ..motion import Motions

                self._motion = Motions(
                    self.script,
                    self.outlet,
                    self.safety,
                    self._realtime(),
                    self._identity,
                    self._host,
                    self._reverse_host,
                    self._reverse_port,
                )
            return self._motion

    @property
    def dashboard(self) -> Dashboard:
        """The dashboard server.

        Raises:
            LocalError: a simulated controller that was told not to serve one.
            Closed: the robot was closed before it was used.
        """
        if self._dashboard_port is None:
            raise LocalError("the controller serves no dashboard")
        with self._lock:
            if self._dashboard is None:
                if self._is_closed:
                    raise Closed("the robot was closed")
                from ..interfaces.dashboard.client import Dashboard

                self._dashboard = Dashboard(
                    self._host, self._dashboard_port, lambda: self._identity().firmware, timeout=self._timeout
                )
            return self._dashboard

    def close(self, timeout: float) -> None:
        """End motions, programs and the dashboard's connection."""
        until = time.monotonic() + timeout
        with self._lock:
            self._is_closed = True
            motion, dashboard = self._motion, self._dashboard
        if motion is not None:
            try:
                motion.close()
            except LinkError as error:
                _log.warning("the motion that ran could not be stopped from here: %s", error)
        self.script.close()
        self.safety.close(max(until - time.monotonic(), 0.0))
        if dashboard is not None:
            dashboard.close()
