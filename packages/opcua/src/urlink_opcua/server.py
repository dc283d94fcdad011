"""OPC UA server of robots, which runs in its own thread with its own event loop."""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import logging
import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from asyncua import Server as AsyncuaServer
from asyncua import ua
from asyncua.common.connection import TransportLimits
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa

from urlink import BadValue, ConnectFailed, Expiry, LinkError, LinkTimeout, Robot

from .access import POLICIES, Access, InternalServer, Session, factories
from .commands import PROGRAMS, STOP, Outcome, RobotCommands
from .nodes import INPUTS, RobotNodes

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["HOST", "NAMESPACE", "PORT", "Server"]

_log = logging.getLogger("urlink.opcua")

#: Default address: this computer only.
HOST = "127.0.0.1"
#: Port that OPC UA servers use.
PORT = 4840
#: URI of the namespace of all nodes of robots.
NAMESPACE = "urn:urlink:opcua"
#: Maximum time, in s, for the server to start, and to end.
_START, _END = 60.0, 10.0
#: Maximum time, in s, to wait for each kind of output register.
_REGISTERS = 5.0
#: Bytes that may be queued for a client that does not read them. Then its connection is aborted.
_QUEUED = 1 << 20
#: Largest request of a client, in bytes.
_LARGEST = 1 << 20


class Server:
    """Serve robots over OPC UA until the server is closed; a context manager.

    Args:
        robots: Robots by name. They are not closed with the server.
        host: Address to listen at.
        port: Port to listen at; 0 for any free port.
        rate: Number of updates per second.
        allow: Whether to accept commands.
        access: Credentials of clients.
        certificate: Certificate of the server; None if it only serves unencrypted reading.
        private_key: Private key of the certificate.
        settling: Seconds for which commands are refused after this process was interrupted for more than 2 s.

    Attributes:
        port: Port that the server listens at.
        url: Address for clients.

    Raises:
        BadValue: If the rate is not from 0.1 to 50, if only one of certificate and private key is given, or if `allow`
            is given without a certificate or without credentials.
        ConnectFailed: If the server cannot listen at this address.
        LinkTimeout: If the server does not start within 60 s.
    """

    def __init__(
        self,
        robots: Mapping[str, Robot],
        *,
        host: str = HOST,
        port: int = PORT,
        rate: float = 10.0,
        allow: bool = False,
        access: Access | None = None,
        certificate: x509.Certificate | None = None,
        private_key: rsa.RSAPrivateKey | None = None,
        settling: float = 5.0,
    ) -> None:
        access = Access() if access is None else access
        if not 0.1 <= rate <= 50:
            raise BadValue(f"rate={rate!r}; expected 0.1 to 50 updates per second")
        if not 0 <= port < 65536:
            raise BadValue(f"port={port!r}; expected 0 to 65535")
        if (certificate is None) != (private_key is None):
            raise BadValue("a certificate and its private key belong together; expected both or neither")
        if allow and certificate is None:
            raise BadValue("commands need encryption; give the server a certificate and its private key")
        if allow and not access.permits_commands:
            raise BadValue("commands need credentials; give the certificate of a client, or a user and a password")
        if not access.anonymous and not (access.permits_commands and certificate is not None):
            raise BadValue("no client could log in; give the server a certificate, and credentials of clients")
        self._access, self._allow = access, allow
        self._host, self.port = host, port
        self._period = 1.0 / rate
        self._keys = (certificate, private_key)
        self._is_ready = False
        self._ended = threading.Event()
        self._expiry = Expiry(settling)
        self._server = AsyncuaServer(iserver=InternalServer(access, self))
        self._robots = dict(robots)
        self._nodes: list[RobotNodes] = []
        self._commands: list[RobotCommands] = []
        self._tasks: list[asyncio.Task[None]] = []
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="opcua", daemon=True)
        self._thread.start()
        try:
            self._soon(self._start(), _START)
        except BaseException as error:
            self.close()
            if isinstance(error, concurrent.futures.TimeoutError):
                raise LinkTimeout(f"the OPC UA server did not start within {_START:g} s") from None
            if isinstance(error, OSError):
                raise ConnectFailed(f"cannot listen at {host}:{port}: {error.strerror or error}") from error
            raise

    @property
    def url(self) -> str:
        """Address for clients."""
        return f"opc.tcp://{f'[{self._host}]' if ':' in self._host else self._host}:{self.port}/urlink/"

    def close(self) -> None:
        """Refuse further commands, abandon pending ones, and disconnect all clients; idempotent."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._is_ready = False
        for commands in self._commands:
            commands.close()
        try:
            self._soon(self._stop(), _END)
        except (concurrent.futures.TimeoutError, OSError, RuntimeError) as error:
            _log.warning("the OPC UA server did not end in time: %r", error)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_END)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # -- in the thread of the server -------------------------------------------------------------------

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_forever()
        finally:
            for task in asyncio.all_tasks(self._loop):
                task.cancel()
            self._loop.run_until_complete(asyncio.sleep(0))
            self._loop.close()

    def _soon(self, coroutine: Any, timeout: float) -> None:
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            future.result(timeout)
        except concurrent.futures.TimeoutError:
            future.cancel()
            raise

    async def _start(self) -> None:
        server = self._server
        await server.init()
        server.set_endpoint(self.url)
        server.socket_address = (self._host, self.port)
        server.set_server_name("urlink")
        certificate, private_key = self._keys
        await server.set_application_uri(_application_uri(certificate))
        if certificate is not None:
            server.iserver.certificate, server.iserver.private_key = certificate, private_key
        server.set_security_policy(list(POLICIES if certificate is not None else POLICIES[:1]))
        tokens: list[type] = [ua.AnonymousIdentityToken]
        if certificate is not None:
            tokens += [ua.X509IdentityToken, ua.UserNameIdentityToken]
        server.set_identity_tokens(tokens)
        server.limits = TransportLimits(
            max_recv_buffer=65535,
            max_send_buffer=65535,
            max_chunk_count=_LARGEST // 65535 + 1,
            max_message_size=_LARGEST,
        )
        index = await server.register_namespace(NAMESPACE)
        for name, robot in self._robots.items():
            nodes = RobotNodes(server, index, name, robot)
            for kind, error in (await asyncio.to_thread(nodes.connect_registers, _REGISTERS)).items():
                _log.warning("%s: the output registers of kind %s are left out: %s", name, kind, error)
            await nodes.add(inputs=self._allow)
            await nodes.show(await asyncio.to_thread(nodes.values))
            self._nodes.append(nodes)
            report = partial(self._report, nodes)
            self._commands.append(RobotCommands(name, robot, allow=self._allow, expiry=self._expiry, report=report))
        await server.start()
        # asyncua listens with its own channels first. No client can log in before these have been replaced.
        server.bserver.set_policies(factories(certificate, private_key))
        for transport in tuple(server.iserver.asyncio_transports):
            transport.abort()
        self.port = server.bserver.port
        self._expiry.tick()
        self._tasks = [asyncio.create_task(self._tick()), asyncio.create_task(self._update())]
        self._is_ready = True

    async def _stop(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._server.bserver is not None:
            await self._server.stop()

    async def _tick(self) -> None:
        """Notice interruptions of this process, and disconnect clients that do not read."""
        while True:
            self._expiry.tick()
            for transport in tuple(self._server.iserver.asyncio_transports):
                if transport.get_write_buffer_size() > _QUEUED:
                    _log.warning("disconnected %s: it does not read", transport.get_extra_info("peername"))
                    transport.abort()
            await asyncio.sleep(0.1)

    async def _update(self) -> None:
        while True:
            for nodes in self._nodes:
                try:
                    # In another thread, because reading the robot can wait for a lock.
                    await nodes.show(await asyncio.to_thread(nodes.values))
                except LinkError as error:
                    _log.warning("could not update the nodes: %s", error)
            await asyncio.sleep(self._period)

    def _report(self, nodes: RobotNodes, outcome: Outcome) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            asyncio.run_coroutine_threadsafe(nodes.report(outcome), self._loop)

    # -- requests of clients ---------------------------------------------------------------------------

    def is_ready(self) -> bool:
        """Whether clients may log in."""
        return self._is_ready

    async def call(self, session: Session, request: ua.CallMethodRequest) -> ua.CallMethodResult:
        """Execute a method of a client; asyncua calls this method."""
        result = ua.CallMethodResult()
        found = [each for each in zip(self._nodes, self._commands, strict=True) if request.MethodId in each[0].methods]
        if not found or request.ObjectId != found[0][0].id:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadMethodInvalid)
            return result
        nodes, commands = found[0]
        name, robot = nodes.methods[request.MethodId], nodes.robot
        arguments = request.InputArguments or []
        call: Callable[[], object]
        if name == "LoadProgram":
            error = _wrong_path(arguments)
            if error:
                result.StatusCode = ua.StatusCode(error)
                return result
            call = partial(robot.dashboard.load, arguments[0].Value)
        elif arguments:
            result.StatusCode = ua.StatusCode(ua.StatusCodes.BadTooManyArguments)
            return result
        else:
            call = partial(PROGRAMS[name], robot)
        lane = "stops" if name == STOP else "programs"
        result.StatusCode = await commands.execute(name, session.user, session.client, lane, call)
        result.InputArgumentResults = [ua.StatusCode() for _ in arguments]
        return result

    async def write(self, session: Session, value: ua.WriteValue) -> ua.StatusCode:
        """Write a register for a client; asyncua calls this method."""
        for nodes, commands in zip(self._nodes, self._commands, strict=True):
            if value.NodeId not in nodes.inputs:
                continue
            if value.AttributeId != ua.AttributeIds.Value or value.IndexRange:
                return ua.StatusCode(ua.StatusCodes.BadWriteNotSupported)
            name = nodes.inputs[value.NodeId]
            variant, method, number = INPUTS[name]
            given = value.Value.Value
            if given is None or given.VariantType != variant or given.is_array or given.Value is None:
                return ua.StatusCode(ua.StatusCodes.BadTypeMismatch)
            call = partial(getattr(nodes.robot.registers, method), number, given.Value)
            status = await commands.execute(name, session.user, session.client, "registers", call)
            if status.is_good():
                await self._server.write_attribute_value(value.NodeId, ua.DataValue(ua.Variant(given.Value, variant)))
            return status
        return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)


def _wrong_path(arguments: list[ua.Variant]) -> int:
    """Return the status of unusable arguments of LoadProgram; 0 if they are usable."""
    if len(arguments) != 1:
        status = ua.StatusCodes.BadTooManyArguments if arguments else ua.StatusCodes.BadArgumentsMissing
    elif arguments[0].is_array or not isinstance(arguments[0].Value, str) or not arguments[0].Value:
        status = ua.StatusCodes.BadInvalidArgument
    else:
        return 0
    return int(status)


def _application_uri(certificate: x509.Certificate | None) -> str:
    """Return the URI of the server, which clients compare with the one in its certificate."""
    if certificate is not None:
        with contextlib.suppress(x509.ExtensionNotFound):
            names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
            for uri in names.get_values_for_type(x509.UniformResourceIdentifier):
                return str(uri)
    return "urn:urlink:server"
