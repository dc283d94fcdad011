"""Server of robots over Zenoh: publishes their states, and executes commands that arrive as queries."""

from __future__ import annotations

import contextlib
import functools
import itertools
import logging
import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import zenoh

from linkcore import clock
from urlink import BadValue, ConnectionEvent, LinkError, LocalError, Motion, PendingCall, Robot, Subscription
from urlink.packets import RealtimeState, State

from .clients import Clients
from .commands import COMMANDS, Kind, failed, read_arguments
from .description import described, json_of, status_of
from .expiry import Expiry
from .keys import JSON, PREFIX, attachment, check_name, key_of, packets_of
from .publication import Publication

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Server"]

_log = logging.getLogger("urlink.zenoh")


class Server:
    """Serve robots over Zenoh until the server is closed; a context manager.

    Args:
        session: Zenoh session. Neither the session nor the robots are closed with the server.
        robots: Robots by name. Each name is one part of a key.
        prefix: First part of all keys.
        rate: Maximum number of real-time packets to publish per second; None for all packets.
        status_rate: Number of status messages per second.
        interfaces: Interfaces whose packets are published, out of "realtime" and "primary".
        watchdog: Default watchdog of trajectories, in s: without a set-point for this time, the arm brakes on its own.
            A client can pass another value.

    Raises:
        BadValue: If a name cannot be part of a key, or a rate is not positive.
        LocalError: If a robot with this name is already served.
        RemoteError: If a robot cannot be reached.
    """

    def __init__(
        self,
        session: zenoh.Session,
        robots: Mapping[str, Robot],
        *,
        prefix: str = PREFIX,
        rate: float | None = None,
        status_rate: float = 10.0,
        interfaces: tuple[str, ...] = ("realtime", "primary"),
        watchdog: float = 0.1,
    ) -> None:
        for value, name in ((rate, "rate"), (status_rate, "status_rate")):
            if value is not None and not 0 < value <= 1000:
                raise BadValue(f"{name}={value!r}; expected more than 0 and at most 1000 per second")
        self._ended = threading.Event()
        self._period = 1.0 / status_rate
        self._served: list[_Served] = []
        self._stack = contextlib.ExitStack()
        try:
            for name, robot in robots.items():
                served = _Served(session, key_of(prefix, check_name(name)), robot, rate, interfaces, watchdog)
                self._served.append(served)
                self._stack.callback(served.close)
        except BaseException:
            self._stack.close()
            raise
        self._thread = threading.Thread(target=self._tell, name="urlink-zenoh status", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the motions of clients, and remove the robots from the name space; idempotent."""
        self._ended.set()
        self._thread.join(5.0)
        self._stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _tell(self) -> None:
        """Publish the status of each robot at regular intervals."""
        due = clock.now()
        while not clock.wait(self._ended.wait, due - clock.now()):
            for served in self._served:
                try:
                    served.tell_status()
                except (LinkError, zenoh.ZError) as error:
                    _log.warning("%s: could not publish the status: %s", served.key, error)
            due = max(due + self._period, clock.now() - self._period)


class _Served:
    """A served robot."""

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        robot: Robot,
        rate: float | None,
        interfaces: tuple[str, ...],
        watchdog: float,
    ) -> None:
        self.key = key
        self._watchdog = watchdog
        self._robot = robot
        self._numbers = itertools.count(1)
        self._rate: float | None = None  # rate of the real-time packets that are published
        self._stack = contextlib.ExitStack()
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            alive = f"{key}/alive"
            if list(session.liveliness().get(alive, timeout=1.0)):
                raise LocalError(f"{key} is already served; choose another name")
            self._is_commanded = _takes_commands(robot)
            self._info, self._status, self._connection, self._motion = (
                self._published(session, name, JSON) for name in ("info", "status", "connection", "motion")
            )
            packets: list[Publication] = []
            for interface in interfaces:
                publication = self._published(session, interface, packets_of(interface, robot.firmware))
                packets.append(publication)
                self._publish_packets(interface, publication, rate if interface == "realtime" else None)
            publications = [self._info, self._status, self._connection, self._motion, *packets]
            self._describe()

            def answer(query: zenoh.Query) -> None:
                for publication in publications:
                    publication.answer(query)

            self._stack.callback(session.declare_queryable(f"{key}/*", answer).undeclare)
            if self._is_commanded:
                lanes = {kind: ThreadPoolExecutor(1, f"{key} {kind.value}") for kind in Kind}
                for lane in lanes.values():
                    self._stack.callback(lane.shutdown, cancel_futures=True)
                self._lanes = lanes
                self._expiry = Expiry()
                self._last: tuple[str, Motion] | None = None  # with the id of its command
                #: motions that were requested and have not started
                self._requested: list[PendingCall] = []
                self._clients = Clients(session, f"{key}/client", self._lost)
                self._stack.callback(self._clients.close)
                self._stack.callback(session.declare_queryable(f"{key}/clock", self._tell_time).undeclare)
                self._stack.callback(session.declare_queryable(f"{key}/command/*", self._asked).undeclare)
            # Last, so that a client that sees the token finds everything else.
            self._stack.callback(session.liveliness().declare_token(alive).undeclare)
            undo.pop_all()

    def close(self) -> None:
        self._stack.close()

    # -- state -----------------------------------------------------------------------------------------

    def _published(self, session: zenoh.Session, name: str, encoding: zenoh.Encoding) -> Publication:
        publication = Publication(session, f"{self.key}/{name}", encoding)
        self._stack.callback(publication.close)
        return publication

    def _publish_packets(self, interface: str, publication: Publication, rate: float | None) -> None:
        robot = self._robot
        stream = getattr(robot, interface)
        taken = itertools.count()
        last = -1
        subscriptions: list[Subscription] = []
        firmware = robot.firmware
        encoding = packets_of(interface, firmware)
        every = 1 if rate is None else max(round(firmware.rate / rate), 1)
        if interface == "realtime":
            self._rate = firmware.rate / every

        def put(packet: State) -> None:
            nonlocal firmware, encoding, last
            # Count all packets that the stream received, including packets that the queue of this callback dropped.
            number = (next(taken) + (subscriptions[-1].stats.dropped if subscriptions else 0)) // every
            if number == last or packet.received is None:
                return
            last = number
            with contextlib.suppress(LinkError):
                # After a reconnect the firmware may be different. It is still unknown at the first packet.
                now = robot.firmware
                if now != firmware:
                    firmware, encoding = now, packets_of(interface, now)
                    self._describe()
            publication.put(bytes(packet), encoding, attachment(number, packet.received))

        def tell(event: ConnectionEvent) -> None:
            error = None if event.error is None else str(event.error)
            said = {"interface": interface, "state": event.state.value, "error": error, "time": event.received.wall}
            self._connection.put(json_of(said))

        subscriptions.append(stream.subscribe(tell, ConnectionEvent))
        subscriptions.append(stream.subscribe(put, RealtimeState if interface == "realtime" else State))
        for subscription in subscriptions:
            self._stack.callback(subscription.close)

    def _describe(self) -> None:
        commands = sorted([*COMMANDS, "cancel"]) if self._is_commanded else []
        self._info.put(json_of({**described(self._robot), "published": self._rate, "commands": commands}))

    def tell_status(self) -> None:
        """Publish the status of the robot."""
        held = self._clients.current if self._is_commanded else None
        motion = None if held is None else _of_motion(*held)
        self._status.put(json_of({**status_of(self._robot, self._is_commanded), "motion": motion}))

    # -- commands --------------------------------------------------------------------------------------

    def _tell_time(self, query: zenoh.Query) -> None:
        """Answer with the time of the server.

        This does not run in a lane: waiting in a busy lane would make the time later than the question.
        """
        self._reply(query, self._expiry.described())

    def _asked(self, query: zenoh.Query) -> None:
        """Handle a command that arrived, in a thread of Zenoh that must not be blocked."""
        name = str(query.key_expr).rpartition("/")[2]
        command = COMMANDS.get(name)
        kind = Kind.STOP if name == "cancel" else Kind.SETTING if command is None else command.kind
        # The call counts as entered now, so that a stop which arrives later takes effect on it.
        call = PendingCall()
        if kind is Kind.MOTION:
            self._requested.append(call)
        requested = list(self._requested) if name == "cancel" else []
        with contextlib.suppress(RuntimeError):  # the lanes are shut down
            self._lanes[kind].submit(self._execute, name, query, call, requested)

    def _execute(self, name: str, query: zenoh.Query, call: PendingCall, requested: list[PendingCall]) -> None:
        try:
            handle = call.make(lambda: self._begun(name, query, requested))
        except Exception as error:
            if not isinstance(error, LinkError):
                _log.exception("%s: %s failed", self.key, name)
            _refuse(query, error)
            return
        finally:
            if call in self._requested:
                self._requested.remove(call)
        if handle is None:
            self._reply(query, {"phase": "done"})
        elif query.parameters.get("wait") is None:
            self._reply(query, handle)
        else:
            motion: Motion = handle["handle"]
            motion.add_done_callback(functools.partial(self._over, query, handle))

    def _begun(self, name: str, query: zenoh.Query, requested: list[PendingCall]) -> dict[str, Any] | None:
        arguments = read_arguments(None if query.payload is None else bytes(query.payload))
        client = query.parameters.get("client")
        if name == "cancel":
            self._cancel(arguments, requested)
            return None
        command = COMMANDS.get(name)
        if command is None:
            raise BadValue(f"unknown command {name!r}; expected one of cancel, {', '.join(sorted(COMMANDS))}")
        if name == "follow":
            arguments.setdefault("watchdog", self._watchdog)
        parameters = {name: query.parameters.get(name) for name in ("server", "time", "age", "command")}

        def execute() -> Any:
            if command.kind is not Kind.STOP:  # a late stop is better than no stop
                self._expiry.check(parameters)
            return command.call(self._robot, arguments)

        result = self._clients.begin(client, execute) if command.kind is Kind.MOTION else execute()
        if not isinstance(result, Motion):
            return None
        motion = result
        if (asked := parameters["command"]) is not None:
            self._last = (asked, motion)
            if self._expiry.is_given_up(asked):  # the client abandoned it while it was being sent
                motion.cancel()
        number = next(self._numbers)
        said = {"id": number, **_of_motion(client, motion)}
        self._motion.put(json_of(said))
        motion.add_done_callback(lambda motion: self._motion.put(json_of({"id": number, **_of_motion(client, motion)})))
        return {**said, "handle": motion}

    def _cancel(self, arguments: dict[str, Any], requested: list[PendingCall]) -> None:
        """Cancel the current motion and all requested motions, or only one command.

        The command might not have arrived yet.

        Raises:
            BadValue: If there is an argument other than `command`, or it is not a string.
        """
        asked = arguments.get("command")
        if arguments.keys() - {"command"} or not (asked is None or isinstance(asked, str)):
            raise BadValue(f"cancel got {arguments!r}; expected `command` with the id of a command, or no argument")
        held: tuple[str | None, Motion] | None = self._clients.current
        if asked is not None:
            self._expiry.give_up(asked)  # First, because a command that is being sent checks this after it has started.
            held = self._last if self._last is not None and self._last[0] == asked else None
        else:
            for call in requested:
                call.give_up()
        if held is not None:
            held[1].cancel()

    def _over(self, query: zenoh.Query, begun: dict[str, Any], motion: Motion) -> None:
        if motion.error is None:
            self._reply(query, {**begun, **_of_motion(begun["client"], motion)})
        else:
            _refuse(query, motion.error)

    def _reply(self, query: zenoh.Query, said: dict[str, Any]) -> None:
        said = {name: value for name, value in said.items() if name != "handle"}
        with contextlib.suppress(zenoh.ZError), query:  # the client no longer waits
            query.reply(query.key_expr, json_of(said), encoding=JSON)

    def _lost(self, client: str, motion: Motion) -> None:
        _log.warning("%s: client %s is lost: its %s is cancelled", self.key, client, motion.name)
        with contextlib.suppress(RuntimeError):
            self._lanes[Kind.STOP].submit(motion.cancel)


def _refuse(query: zenoh.Query, error: BaseException) -> None:
    with contextlib.suppress(zenoh.ZError), query:
        query.reply_err(json_of(failed(error)), encoding=JSON)


def _of_motion(client: str | None, motion: Motion) -> dict[str, Any]:
    error = None if motion.error is None else failed(motion.error)
    return {
        "client": client,
        "name": motion.name,
        "phase": motion.phase.value,
        "progress": motion.progress,
        "error": error,
    }


def _takes_commands(robot: Robot) -> bool:
    try:
        return robot.motion is not None
    except LocalError:
        return False
