"""Server of a mission, which opens a TCP port for programs that were written for MRC.

MRC listens on port 31001, or with its option `-t N` on 31000 + N. `dialogue` handles the commands of clients. This
module handles the sockets. The one driving thread serves them between the robot's answer and the script of the same
cycle.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable

from linkcore import clock
from linkcore.arguments import check_seconds
from linkcore.errors import BadValue, Closed
from linkcore.names import StrictAttributes
from linkcore.net.loop import Connection, Handler, SelectorLoop
from linkcore.threads import Runnable

from ..errors import MissionFailed
from ..host.plugin import Plugin
from .controller import MissionController
from .dialogue import ClientDialogue
from .execution import MissionExecution, WithCallbacks, leaving_at_exit, log_saver
from .plan import Failure
from .profile import Profile, find_profile
from .recipients import MOST_BACKLOG, Session
from .robot_conf import RobotConf
from .robot_link import AnyRobot, PluginLink, RobotLink, open_link, suitable_conf

_log = logging.getLogger(__name__)

#: Default port of MRC.
PORT = 31001

#: Time that a client gets to read the last answers, and time that other threads wait for the driving thread, in s.
_FINISH, _CLOSE_TIMEOUT = 0.5, 5.0


class MissionServer(StrictAttributes, Runnable, WithCallbacks):
    """Server that executes commands from clients on one robot.

    Use it as a context manager to start and close it.

    ``run()`` serves in this thread until `stop`. ``start()``, or a ``with`` block, serves in a dedicated thread. A
    server runs once.

    When the server ends, it sends the speed 0 to the robot. In the sound profile, it also does so if a client
    disconnects while a command of this client is executed. There is no password: anyone who can connect can drive the
    robot. By default, only programs on this computer can connect.

    Args:
        robot: Robot; see `Mission`. A plugin such as `Turtle()` runs in this process, in real time.
        port: TCP port; 0 for a free port.
        address: Address to listen on.
        compat: "sound", or "mrc". With "mrc", a client's `exit` ends the server, as it ends MRC.
        conf: Description of the robot; see `Mission`.
        clients: Maximum number of connected clients.
        inactivity_timeout: Seconds without a byte after which a client may lose its slot, if all slots are taken and
            another client connects. A client keeps its slot while one of its commands is queued or executed, and while
            it waits for an event.
        waits: Whether to connect to the robot only after the first client has connected, as MRC does. The default is
            True in MRC's profile.
        log_folder: Folder for the logs that clients save. By default, logs are not saved.

    Attributes:
        failure: Error that ended the server; None while it runs, and after `stop`.

    Raises:
        BadValue: If `clients` is less than one.
        BadAddress: When it runs, if the port is not available.
        BadConfiguration: When it runs, if `conf` cannot be read or contains an invalid setting.
        AccessDenied, WrongVariables: When it runs, if the robot cannot be driven. Connecting can raise other errors;
            see `rhdlink.connect`.
        ConnectionLost, LinkTimeout: When it runs, if the robot disconnects or does not answer.
        MissionFailed: When it runs, if a provider or a watch fails.
    """

    def __init__(
        self,
        robot: AnyRobot,
        *,
        port: int = PORT,
        address: str = "127.0.0.1",
        compat: Profile | str = "sound",
        conf: RobotConf | str | os.PathLike[str] | None = None,
        clients: int = 8,
        inactivity_timeout: float = 10.0,
        waits: bool | None = None,
        log_folder: str | os.PathLike[str] | None = None,
    ) -> None:
        if clients < 1:
            raise BadValue(f"clients is {clients}; expected at least 1")
        Runnable.__init__(self, "mission server", _CLOSE_TIMEOUT, "the robot")
        WithCallbacks.__init__(self)
        self._robot = robot
        self._place = address, port
        self._profile = find_profile(compat)
        self._conf = conf
        self._clients = clients
        self._inactivity_timeout = check_seconds(inactivity_timeout, "inactivity_timeout")
        self._waits = not self._profile.client_loss_stops if waits is None else waits
        self._save_log = self._saver(log_folder)
        self._loop: SelectorLoop | None = None
        self._dialogue: ClientDialogue | None = None
        self._handlers: list[_ClientHandler] = []
        self._link: RobotLink | None = None
        self._port = 0

    @property
    def port(self) -> int:
        """Port on which the server listens.

        Raises:
            Closed: If the server is not running.
        """
        if self._loop is None:
            raise Closed("the server is not running; start() it first")
        return self._port

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Failures of commands, the newest last."""
        return () if self._dialogue is None else tuple(self._dialogue.failures)

    def _saver(self, folder: str | os.PathLike[str] | None) -> Callable[[str, str], object] | None:
        """Return a function that saves clients' logs.

        If it fails, only the command fails, not the server.
        """
        save = log_saver(folder)
        if save is None:
            return None

        def save_or_note(name: str, text: str) -> None:
            try:
                save(name, text)
            except MissionFailed as error:
                _log.warning("%s", error)
                assert self._dialogue is not None
                self._dialogue.note(Failure(error.reason, 0, 0, ""))

        return save_or_note

    # -- life ------------------------------------------------------------------------------------------

    def _wake(self) -> None:
        loop = self._loop
        if loop is not None:
            loop.wake()

    def __repr__(self) -> str:
        state = "ended" if self._ended.is_set() else "serving" if self._is_used else "not started"
        return f"<MissionServer {self._place[0]}:{self._port or self._place[1]} {state}, profile {self._profile.name}>"

    # -- begin and end ---------------------------------------------------------------------------------

    def _begin(self) -> None:
        self._loop = loop = SelectorLoop()
        idle = self._inactivity_timeout
        self._port = loop.listen(*self._place, self._accept, limit=self._clients, idle=idle).number
        self._execution = None if self._waits else self._connect()

    def _give_up(self) -> None:
        """Clean up after a failed start."""
        if self._loop is not None:
            self._loop.close()
        self._close_link()

    def _close_link(self) -> None:
        if self._link is not None and self._link is not self._robot:
            self._link.close()

    def _connect(self) -> MissionExecution:
        """Connect to the robot, and pass the clients that connected earlier to its dialogue."""
        if isinstance(self._robot, Plugin):
            link: RobotLink = PluginLink([self._robot], is_realtime=True)
        else:
            link = open_link(self._robot)
        self._link = link
        controller = MissionController(
            suitable_conf(self._conf, link), link.read, link.write, profile=self._profile, hooks=self._callbacks.hooks
        )
        self._dialogue = controller.serve()
        for handler in self._handlers:
            handler.begin(self._dialogue.connect())
        return MissionExecution(link, controller, self._callbacks, self._save_log, self._listen)

    def _in_thread(self) -> None:
        with leaving_at_exit(self._leave):
            super()._in_thread()

    def _leave(self) -> None:
        self.stop()
        clock.wait(self._ended.wait, _CLOSE_TIMEOUT)

    def _serve(self) -> None:
        loop = self._loop
        assert loop is not None
        execution = self._execution
        try:
            while execution is None and not self._is_stopping:
                loop.serve_once()
                if self._handlers:
                    execution = self._connect()
            while execution is not None and not self._is_stopping and execution.cycle():
                self._answer()
            error = None if execution is None else execution.error
            if error is not None:
                raise error
        except Exception as error:
            _log.info("mission server %s:%s ended: %s", self._place[0], self._port, error)
            self.failure = error
        finally:
            if execution is not None and not execution.controller.is_finished:
                execution.stand()
            self._close_link()
            self._answer()
            loop.close(within=_FINISH)

    # -- clients ---------------------------------------------------------------------------------------

    def _accept(self, connection: Connection) -> Handler:
        handler = _ClientHandler(self, connection)
        self._handlers.append(handler)
        if self._dialogue is not None:
            handler.begin(self._dialogue.connect())
        return handler

    def _listen(self) -> None:
        """Receive bytes from all clients."""
        assert self._loop is not None
        self._loop.serve_once(self._loop.time())

    def _answer(self) -> None:
        """Send the answers of the dialogue."""
        for handler in list(self._handlers):
            handler.answer()

    def _lost(self, handler: _ClientHandler) -> None:
        self._handlers.remove(handler)
        if self._dialogue is not None and handler.session is not None:
            self._dialogue.disconnect(handler.session)


class _ClientHandler(Handler):
    """Handler of one client's connection.

    Attributes:
        session: Session of the client in the dialogue; None until the dialogue has begun.
    """

    def __init__(self, server: MissionServer, connection: Connection) -> None:
        self.session: Session | None = None
        self._server = server
        self._connection = connection
        self._waiting = bytearray()

    @property
    def is_busy(self) -> bool:
        """Whether a command of the client is queued or executed, or it waits for an event."""
        dialogue, session = self._server._dialogue, self.session
        return dialogue is not None and session is not None and dialogue.is_busy(session)

    def begin(self, session: Session) -> None:
        """Take the client's session when the dialogue begins."""
        self.session = session
        session.receive(bytes(self._waiting))
        self._waiting.clear()

    def data_received(self, data: bytes) -> None:
        """Pass received bytes to the session, or keep them until there is one."""
        if self.session is not None:
            self.session.receive(data)
            if self.session.backlog > MOST_BACKLOG:
                self._connection.pause_reading()
        else:
            self._waiting += data
            if len(self._waiting) > self._connection.port.output_limit:
                self._connection.close(reset=True, reason="sent too much before the robot was connected")

    def answer(self) -> None:
        """Send the answers, and end the connection of a client that has left."""
        session = self.session
        if session is None:
            return
        answers = session.take()
        if answers:
            self._connection.write(answers)
        if session.is_closed:
            self._connection.finish(_FINISH)
        elif session.backlog <= MOST_BACKLOG:
            self._connection.resume_reading()

    def connection_lost(self, reason: str, *, by_peer: bool) -> None:
        """Drop the client's commands."""
        self._server._lost(self)
