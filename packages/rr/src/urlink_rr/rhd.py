"""The variables of a mobile robot that runs RHD, as wires."""

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

#: Seconds between two ticks of the clock by which values expire.
_TICK = 0.1


def definition(name: str, robot: Variables) -> tuple[str, dict[str, str], dict[str, str]]:
    """The service definition of a robot: a wire for each variable, of its 32-bit words.

    Returns:
        the text; and wire -> variable, of the variables to read and of those to write, which begin with ``command_``.
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
    """The service object; `register_rhd` puts it into a node.

    Values go both ways as they are on the wire of RHD: 32-bit words. What a client writes is the robot's with its next
    sync. When that client is lost, what it has written is set to 0, which lets the robots that are known here stand.
    What may have waited while this process was held up is not written.

    Args:
        robot: which somebody keeps in sync: ``robot.background()``.
        read, write: wire -> variable.
    """

    def __init__(self, robot: Variables, read: Mapping[str, str], write: Mapping[str, str]) -> None:
        self._robot = robot
        self._read = dict(read)
        self._write = dict(write)
        self._wire_of = {variable: wire for wire, variable in read.items()}
        self._lock = threading.Lock()
        #: variable -> the client that wrote it last
        self._written: dict[str, int] = {}
        self._subscriptions: list[Any] = []
        self._expiry = Expiry(SETTLING)
        self._ended = threading.Event()

    @property
    def address(self) -> str:
        """Of the robot."""
        return self._robot.address

    def RRServiceObjectInit(self, context: Any, path: str) -> None:  # noqa: N802
        """Robot Raconteur has put the wires in place."""
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
        """Set what clients have written to 0, and tell no more; idempotent."""
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
                _log.warning("%s is not set: %s", variable, error)

        return receive

    def _heard(self, context: Any, event: int, endpoint: Any) -> None:
        if event == RR.ServerServiceListenerEventType_ClientDisconnected:
            self._lost(int(endpoint))

    def _lost(self, endpoint: int) -> None:
        with self._lock:
            for variable in [name for name, owner in self._written.items() if owner == endpoint]:
                del self._written[variable]
                _log.warning("%s is set to 0: the client that wrote it is lost", variable)
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
    """Serve a mobile robot in a node, under its name, until the service is closed and the node closes it."""
    type_name = f"experimental.rhd.{name}"
    text, read, write = definition(type_name, robot)
    node.RegisterServiceType(text)
    service = RhdService(robot, read, write)
    node.RegisterService(name, f"{type_name}.Robot", service)
    return service
