"""Service with the variables of a mobile robot that runs RHD, as wires."""

from __future__ import annotations

import contextlib
import logging
import re
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
import RobotRaconteur as RR

from linkcore import clock
from rhdlink import ConnectionState, LinkError, Variables
from rhdlink.variables import ConnectionEvent, Update
from urlink import Expiry

from .service import SETTLING

__all__ = ["RhdService", "definition", "register_rhd"]

_log = logging.getLogger("urlink.rr")

#: Interval, in s, between two ticks of the clock that expires values.
_TICK = 0.1


def definition(name: str, robot: Variables) -> tuple[str, dict[str, str], dict[str, str]]:
    """Return the service definition of a robot, with a wire of 32-bit words for each variable.

    Returns:
        The text of the definition; the variables to read, by wire; and the variables to write, by wire. The names of
        the wires to write begin with ``command_``.
    """
    read: dict[str, str] = {}
    write: dict[str, str] = {}
    for variable in robot.variables:
        plain = re.sub(r"\W", "_", variable.name, flags=re.ASCII)
        if variable.direction == "r":
            read[plain] = variable.name
        elif robot.access == "w":
            write[f"command_{plain}"] = variable.name
    lines = [
        f"service {name}",
        "stdver 0.10",
        "object Robot",
        "property string address [readonly]",
        "wire uint8 connected [readonly]",
        *(f"wire int32[] {wire} [readonly]" for wire in read),
        *(f"wire int32[] {wire} [writeonly]" for wire in write),
        "end",
    ]
    return "\n".join(lines) + "\n", read, write


class RhdService:
    """Service object of a mobile robot; `register_rhd` registers it in a node.

    In both directions, values are the 32-bit words of RHD. A value that a client writes is sent to the robot at the
    next sync. When this client is lost, the variables that it wrote are set to 0, which stops the robots that are known
    here. A value is not written if it might have been delayed while this process was interrupted.

    Args:
        robot: Variables of a robot, which the caller keeps in sync, for example with ``robot.background()``.
        read, write: Names of variables, by wire.
    """

    def __init__(self, robot: Variables, read: Mapping[str, str], write: Mapping[str, str]) -> None:
        self._robot = robot
        self._read = dict(read)
        self._write = dict(write)
        self._wire_of = {variable: wire for wire, variable in read.items()}
        self._lock = threading.Lock()
        #: endpoint of the client that wrote each variable last
        self._written: dict[str, int] = {}
        self._subscriptions: list[Any] = []
        self._expiry = Expiry(SETTLING)
        self._ended = threading.Event()

    @property
    def address(self) -> str:
        """Address of the robot."""
        return self._robot.address

    def RRServiceObjectInit(self, context: Any, path: str) -> None:  # noqa: N802
        """Start serving; Robot Raconteur calls this when the wires exist."""
        for wire, variable in self._write.items():
            getattr(self, wire).InValueChanged += self._receiver(variable)
        context.AddServerServiceListener(self._heard)
        for variable in self._wire_of:
            self._tell(variable, self._robot[variable])
        self.connected.OutValue = int(self._robot.connection is ConnectionState.CONNECTED)  # type: ignore[attr-defined]
        self._subscriptions = [
            self._robot.subscribe(self._changed),
            self._robot.subscribe_connection(self._connection_changed),
        ]
        self._expiry.tick()
        threading.Thread(target=self._tick, name="urlink-rr tick", daemon=True).start()

    def close(self) -> None:
        """Set the variables that clients wrote to 0, and stop sending; idempotent."""
        self._ended.set()
        for subscription in self._subscriptions:
            subscription.close()
        for endpoint in set(self._written.values()):
            self._lost(endpoint)

    def _tick(self) -> None:
        while not clock.wait(self._ended.wait, _TICK):
            self._expiry.tick()

    def _receiver(self, variable: str) -> Any:
        def receive(value: Any, stamp: Any, endpoint: int) -> None:
            try:
                self._expiry.check()
                with self._lock:
                    self._robot[variable] = int(value[0]) if len(value) == 1 else np.asarray(value)
                    self._written[variable] = int(endpoint)
            except LinkError as error:
                _log.warning("%s: not set: %s", variable, error)

        return receive

    def _heard(self, context: Any, event: int, endpoint: Any) -> None:
        if event == RR.ServerServiceListenerEventType_ClientDisconnected:
            self._lost(int(endpoint))

    def _lost(self, endpoint: int) -> None:
        with self._lock:
            for variable in [name for name, owner in self._written.items() if owner == endpoint]:
                del self._written[variable]
                _log.warning("%s: set to 0: the client that wrote it is lost", variable)
                with contextlib.suppress(LinkError):
                    words = np.asarray(self._robot[variable])
                    self._robot[variable] = 0 if words.ndim == 0 else np.zeros_like(words)

    def _changed(self, update: Update) -> None:
        for variable in update.changes:
            if variable in self._wire_of:
                self._tell(variable, self._robot[variable])

    def _connection_changed(self, event: ConnectionEvent) -> None:
        self.connected.OutValue = int(event.state is ConnectionState.CONNECTED)  # type: ignore[attr-defined]

    def _tell(self, variable: str, words: Any) -> None:
        getattr(self, self._wire_of[variable]).OutValue = np.atleast_1d(np.asarray(words, np.int32))


def register_rhd(node: Any, name: str, robot: Variables) -> RhdService:
    """Serve a mobile robot in a node until the service is closed and the node closes it."""
    type_name = f"experimental.rhd.{name}"
    text, read, write = definition(type_name, robot)
    node.RegisterServiceType(text)
    service = RhdService(robot, read, write)
    node.RegisterService(name, f"{type_name}.Robot", service)
    return service
