"""MCP server of robots, which runs in its own thread with its own event loop."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import hmac
import logging
import os
import socket
import threading
from collections.abc import Awaitable, Callable, Mapping
from typing import TYPE_CHECKING, Any

import anyio
import mcp_types as types
import uvicorn
from mcp.server.auth.provider import AccessToken
from mcp.server.auth.settings import AuthSettings
from mcp.server.context import ServerRequestContext
from mcp.server.lowlevel import Server as SdkServer
from mcp.server.request_state import RequestStateBoundary, RequestStateSecurity
from mcp.server.stdio import stdio_server
from mcp.shared.message import ServerMessageMetadata
from mcp_types.version import MODERN_PROTOCOL_VERSIONS
from pydantic import ValidationError

from urlink import BadValue, ConnectFailed, Expiry, LinkError, LinkTimeout, LocalError, Robot
from urlink.tools import bound_socket, strict_json

from .actions import ACTIONS, OfRobot
from .commands import Answer, RobotCommands
from .questions import SCHEMA
from .readings import READINGS
from .request_log import Client, RequestLog
from .standard_streams import StandardStreams

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["PATH", "PORT", "SHORTEST_TOKEN", "Server"]

_log = logging.getLogger("urlink.mcp")

#: Address of the HTTP server: programs of this computer only.
_HOST = "127.0.0.1"
#: Default port, and path of the URL.
PORT, PATH = 8765, "/mcp"
#: Smallest length of a token, because a client can try tokens without a limit.
SHORTEST_TOKEN = 24
#: Range of the time for an answer and of the time for a motion, in s.
_CONSENT_TIMES, _MOTION_TIMES = (1.0, 300.0), (1.0, 600.0)
#: Maximum time, in s, for the server to start, and to end.
_START, _END = 30.0, 10.0
#: Maximum number of requests that have not ended, and maximum size of a request over HTTP, in bytes.
_MOST, _LARGEST = 64, 1 << 20
#: Interval, in s, at which the server checks whether it was interrupted.
_TICK = 0.1
#: Key of the question in a result of protocol 2026-07-28 or later.
_KEY = "consent"

_INSTRUCTIONS = (
    "Tools for robot arms of Universal Robots. Lengths are in m, and angles in rad unless a name says degrees. Poses "
    "are position and rotation vector in the base frame. Read get_state and get_limits before you plan a motion."
)
_MOTION_INSTRUCTIONS = (
    " Each motion and each output needs the consent of a person, who is asked by this client. Ask for one motion at a "
    "time, and wait for its result. If a request is refused, tell the person why instead of repeating it. stop needs "
    "no consent."
)

_DESCRIPTIONS = {
    "move_joints": "Move all joints to a position, in a straight line in joint space. A person must consent.",
    "move_linear": "Move the tool to a pose, in a straight line. A person must consent.",
    "move_to_point": "Move the arm to a taught point. A person must consent.",
    "set_digital_output": "Switch a digital output. Connected equipment might move. A person must consent.",
    "stop": "Stop the arm now, and abandon all requests that wait for consent. It needs no consent.",
}

#: Arguments of each tool.
_ARGUMENTS: dict[str, type[OfRobot]] = {
    **{name: arguments for name, (arguments, _, _) in READINGS.items()},
    **ACTIONS,
    "stop": OfRobot,
    "list_robots": OfRobot,
}


class Server:
    """Serve robots to MCP clients until the server is closed; a context manager.

    Args:
        robots: Robots by name. They are not closed with the server.
        port: Port of 127.0.0.1 for HTTP; 0 for any free port. If None, the client is the process that has started this
            one, over standard input and output.
        token: Token that each HTTP request must contain, at least 24 characters. Only for HTTP.
        allow: Whether to offer tools that change something. Each robot then needs limits of the session.
        consent_time: Seconds for which a person can consent to a request, 1 to 300.
        motion_time: Seconds after which a motion is stopped, 1 to 600.
        log: File to which each request is appended; None for no file.
        settling: Seconds for which requests that need consent are refused after this process was interrupted for more
            than 2 s.

    Attributes:
        port: Port of the server, or None.
        ended: Event that is set when the server has ended, for example because its client has closed standard input.

    Raises:
        BadAddress: If the port cannot be used.
        BadValue: If a number is out of range, the token is missing or too short, or the log cannot be written.
        LocalError: With `allow`, if a robot has no limits of the session, or does not accept commands.
        ConnectFailed, LinkTimeout: If the server does not start.
    """

    def __init__(
        self,
        robots: Mapping[str, Robot],
        *,
        port: int | None = None,
        token: str | None = None,
        allow: bool = False,
        consent_time: float = 30.0,
        motion_time: float = 60.0,
        log: str | os.PathLike[str] | None = None,
        settling: float = 5.0,
    ) -> None:
        for name, value, (least, most) in (
            ("consent_time", consent_time, _CONSENT_TIMES),
            ("motion_time", motion_time, _MOTION_TIMES),
        ):
            if not least <= value <= most:
                raise BadValue(f"{name} is {value!r} s; expected {least:g} to {most:g} s")
        if port is not None and (token is None or len(token) < SHORTEST_TOKEN):
            found = "no token was given" if token is None else f"the token has {len(token)} characters"
            raise BadValue(f"{found}; HTTP needs one with at least {SHORTEST_TOKEN} characters")
        self._robots = dict(robots)
        self._expiry = Expiry(settling)
        self._requests = RequestLog(log)
        self._is_given_up = False
        self._pending = 0
        try:
            made = functools.partial(
                RobotCommands,
                expiry=self._expiry,
                log=self._requests,
                consent_time=consent_time,
                motion_time=motion_time,
            )
            self._commands = {name: made(name, robot) for name, robot in self._robots.items()} if allow else {}
            self._socket = None if port is None else bound_socket(_HOST, port, purpose="MCP")
        except BaseException:
            self._requests.close()
            raise
        self.port: int | None = None if self._socket is None else self._socket.getsockname()[1]
        self._server = SdkServer(
            "urlink",
            instructions=_INSTRUCTIONS + (_MOTION_INSTRUCTIONS if allow else ""),
            on_list_tools=self._list,
            on_call_tool=self._call,
        )
        # Encrypts and authenticates the id of a question on its way through the client.
        self._server.middleware.append(
            RequestStateBoundary(RequestStateSecurity.ephemeral(), default_audience="urlink")
        )
        self._token = token or ""
        self.ended = threading.Event()
        self._started = threading.Event()
        self._failure: BaseException | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ending: asyncio.Event | None = None
        self._thread = threading.Thread(target=self._run, name="mcp", daemon=True)
        self._thread.start()
        if not self._started.wait(_START) or self._failure is not None:
            failure = self._failure
            self.close()
            if failure is None:
                raise LinkTimeout(f"the MCP server did not start within {_START:g} s")
            raise ConnectFailed(f"the MCP server did not start: {failure}") from failure

    @property
    def url(self) -> str | None:
        """Address for clients over HTTP; None over standard input and output."""
        return None if self.port is None else f"http://{_HOST}:{self.port}{PATH}"

    def close(self) -> None:
        """Refuse further requests, stop motions of clients, and disconnect all clients; idempotent."""
        for commands in self._commands.values():
            commands.close()
        self._is_given_up = True
        loop, ending = self._loop, self._ending
        if loop is not None and ending is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(ending.set)
        self._thread.join(_END)
        if self._thread.is_alive():
            _log.warning("the MCP server did not end within %g s", _END)
        if self._socket is not None:
            self._socket.close()
        self._requests.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # -- thread of the server --------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._failure = error
            if self._started.is_set():
                _log.exception("the MCP server failed")
        finally:
            # Motions must not outlive the connection of their client.
            for commands in self._commands.values():
                commands.close()
            self._started.set()
            self.ended.set()

    async def _serve(self) -> None:
        self._loop, self._ending = asyncio.get_running_loop(), asyncio.Event()
        if self._is_given_up:
            return
        self._expiry.tick()
        async with anyio.create_task_group() as group:
            group.start_soon(self._tick)
            await (self._serve_stdio(self._ending) if self._socket is None else self._serve_http(self._ending))
            group.cancel_scope.cancel()

    async def _tick(self) -> None:
        while True:
            await anyio.sleep(_TICK)
            self._expiry.tick()

    async def _serve_stdio(self, ending: asyncio.Event) -> None:
        async with (
            StandardStreams() as streams,
            stdio_server(streams, streams) as (reading, writing),
            anyio.create_task_group() as group,
        ):
            group.start_soon(_cancel_when, ending, group.cancel_scope)
            self._started.set()
            await self._server.run(reading, writing, self._server.create_initialization_options())
            group.cancel_scope.cancel()

    async def _serve_http(self, ending: asyncio.Event) -> None:
        settings = AuthSettings(issuer_url=f"http://{_HOST}:{self.port}", resource_server_url=None)
        app = self._server.streamable_http_app(
            streamable_http_path=PATH,
            # Refuses requests of web pages: other origins, and names of other hosts that lead to this computer.
            host=_HOST,
            max_request_body_size=_LARGEST,
            auth=settings,
            token_verifier=_Token(self._token),
        )
        config = uvicorn.Config(
            _noting_disconnects(app),
            log_config=None,
            access_log=False,
            # More than the pending requests, so that a stop still gets a connection.
            limit_concurrency=4 * _MOST,
            timeout_graceful_shutdown=1,
        )
        server = _Uvicorn(config, self._started.set)

        async def end() -> None:
            await ending.wait()
            server.should_exit = True

        async with anyio.create_task_group() as group:
            group.start_soon(end)
            await server.serve(sockets=[self._socket])
            group.cancel_scope.cancel()

    # -- requests --------------------------------------------------------------------------------------

    async def _list(
        self, ctx: ServerRequestContext, params: types.PaginatedRequestParams | None
    ) -> types.ListToolsResult:
        reads = [("list_robots", "Names, models and addresses of the robots.")]
        reads += [(name, description) for name, (_, description, _) in READINGS.items()]
        tools = [_tool(name, description, reads=True) for name, description in reads]
        if self._commands:
            tools += [_tool(name, description, reads=False) for name, description in _DESCRIPTIONS.items()]
        return types.ListToolsResult(tools=tools)

    async def _call(
        self, ctx: ServerRequestContext, params: types.CallToolRequestParams
    ) -> types.CallToolResult | types.InputRequiredResult:
        """Execute one request. If its client disconnects, the request is cancelled."""
        client, result = _client(ctx), _failed("the client has disconnected")
        gone: asyncio.Event | None = None if ctx.request is None else ctx.request.scope.get(_GONE)
        if self._pending >= _MOST and params.name != "stop":
            return _failed(f"{_MOST} requests have not ended yet; wait for one of them")
        self._pending += 1
        try:
            async with anyio.create_task_group() as group:
                if gone is not None:
                    group.start_soon(_cancel_when, gone, group.cancel_scope)
                result = await self._answer(ctx, client, params)
                group.cancel_scope.cancel()
        finally:
            self._pending -= 1
        return result

    async def _answer(
        self, ctx: ServerRequestContext, client: Client, params: types.CallToolRequestParams
    ) -> types.CallToolResult | types.InputRequiredResult:
        tool, arguments = params.name, params.arguments or {}
        acts = tool in ACTIONS or tool == "stop"
        try:
            try:
                name, given = self._admitted(tool, arguments)
            except LinkError as error:
                self._requests.note(
                    client, "*", tool[:60], "refused", acts=acts, arguments=arguments, reason=str(error)
                )
                raise
            if tool == "stop":
                return _done(await self._commands[name].stop(client))
            if acts:
                return await self._act(ctx, client, name, given, params)
            self._requests.note(client, name, tool, "asked", acts=False, arguments=arguments)
            if tool == "list_robots":
                return _done(self._listed())
            return _done(await anyio.to_thread.run_sync(READINGS[tool][2], self._robots[name], given))
        except LinkError as error:
            return _failed(str(error))
        except Exception:
            _log.exception("%s of %s failed", tool, client)
            return _failed("internal error; the log of the server contains the reason")

    def _admitted(self, tool: str, arguments: Mapping[str, Any]) -> tuple[str, OfRobot]:
        """Return the name of the robot, and the arguments of a tool that is offered.

        Raises:
            BadValue: If the tool is not offered, or its arguments do not fit.
        """
        if tool not in _ARGUMENTS or (tool in _DESCRIPTIONS and not self._commands):
            raise BadValue(self._unknown(tool))
        given = _parsed(tool, arguments)
        return "*" if tool == "list_robots" else self._robot_named(given.robot), given

    async def _act(
        self,
        ctx: ServerRequestContext,
        client: Client,
        name: str,
        given: OfRobot,
        params: types.CallToolRequestParams,
    ) -> types.CallToolResult | types.InputRequiredResult:
        """Ask for consent and execute. Clients of protocol 2026-07-28 repeat the request with the answer."""
        commands, tool, arguments = self._commands[name], params.name, params.arguments or {}
        if params.request_state is not None:
            answer = (params.input_responses or {}).get(_KEY)
            if not isinstance(answer, types.ElicitResult):
                raise LocalError("the request was repeated without an answer to the question; send it again")
            said = (answer.action, answer.content)
            return _done(await commands.answered(client, params.request_state, tool, arguments, said))
        self._requests.note(client, name, tool, "asked", acts=True, arguments=arguments)
        try:
            if not _can_ask(ctx):
                raise LocalError(
                    "this client cannot ask a person (it did not declare the capability elicitation), so this tool is "
                    "refused; use a client that supports elicitation"
                )
            question = await commands.prepare(client, tool, given, arguments)
        except LinkError as error:
            self._requests.note(client, name, tool, "refused", acts=True, reason=str(error))
            raise
        if ctx.protocol_version in MODERN_PROTOCOL_VERSIONS:
            return types.InputRequiredResult(
                input_requests={_KEY: _elicitation(commands.text(question))}, request_state=question.id
            )
        return _done(await commands.decide(question, functools.partial(_ask, ctx)))

    def _unknown(self, tool: str) -> str:
        if tool in _DESCRIPTIONS:
            return f"{tool} is not offered, because this server only reads; start it with --allow and --limits"
        offered = [*READINGS, "list_robots", *(_DESCRIPTIONS if self._commands else ())]
        return f"unknown tool {tool[:60]!r}; expected one of {', '.join(sorted(offered))}"

    def _robot_named(self, name: str | None) -> str:
        if name is None and len(self._robots) == 1:
            return next(iter(self._robots))
        if name not in self._robots:
            given = "robot is missing" if name is None else f"robot is {name[:60]!r}"
            raise BadValue(f"{given}; expected one of {', '.join(self._robots)}")
        return name

    def _listed(self) -> dict[str, Any]:
        return {
            "robots": [
                {
                    "name": name,
                    "model": robot.model,
                    "firmware": str(robot.firmware),
                    "address": robot.address,
                    "connection": robot.realtime.connection.value,
                    "accepts_motions": name in self._commands,
                }
                for name, robot in self._robots.items()
            ]
        }


# -- requests and results ----------------------------------------------------------------------------


def _client(ctx: ServerRequestContext) -> Client:
    known = ctx.session.client_params
    info = None if known is None else known.client_info
    session = "stdio"
    if ctx.request is not None:
        address = ctx.request.client
        session = "HTTP" if address is None else f"HTTP {address.host}:{address.port}"
        number = ctx.request.headers.get("mcp-session-id")
        session += f", session {number[:8]}" if number else ""
    return Client("" if info is None else info.name, "" if info is None else info.version, session)


def _can_ask(ctx: ServerRequestContext) -> bool:
    """Whether the client can show a form to a person. A client that names no kinds of elicitation can show forms."""
    declared = ctx.session.client_capabilities
    elicitation = None if declared is None else declared.elicitation
    return elicitation is not None and (elicitation.form is not None or elicitation.url is None)


def _elicitation(text: str) -> types.ElicitRequest:
    return types.ElicitRequest(params=types.ElicitRequestFormParams(message=text, requested_schema=SCHEMA))


async def _ask(ctx: ServerRequestContext, text: str, seconds: float) -> Answer | None:
    """Ask with a request to the client, which clients before protocol 2026-07-28 need."""
    answer = None
    with anyio.move_on_after(seconds):
        answer = await ctx.session.send_request(
            _elicitation(text), types.ElicitResult, metadata=ServerMessageMetadata(related_request_id=ctx.request_id)
        )
    return None if answer is None else (answer.action, answer.content)


def _parsed(tool: str, arguments: Mapping[str, Any]) -> OfRobot:
    try:
        given: OfRobot = _ARGUMENTS[tool].model_validate(arguments)
    except ValidationError as error:
        wrong = "; ".join(
            f"{'.'.join(map(str, each['loc'])) or 'arguments'}: {each['msg']}" for each in error.errors()[:3]
        )
        raise BadValue(f"{tool}: {wrong}") from None
    return given


def _tool(name: str, description: str, *, reads: bool) -> types.Tool:
    hints = types.ToolAnnotations(
        read_only_hint=reads, destructive_hint=not reads and name != "stop", open_world_hint=False
    )
    schema = _ARGUMENTS[name].model_json_schema()
    return types.Tool(name=name, description=description, input_schema=schema, annotations=hints)


def _done(said: dict[str, Any]) -> types.CallToolResult:
    # Older clients show only the text.
    return types.CallToolResult(content=[types.TextContent(text=strict_json(said))], structured_content=said)


def _failed(reason: str) -> types.CallToolResult:
    return types.CallToolResult(content=[types.TextContent(text=reason)], is_error=True)


# -- HTTP --------------------------------------------------------------------------------------------

#: Key of the event in the scope of an HTTP request.
_GONE = "urlink.disconnected"


def _noting_disconnects(app: Callable[..., Awaitable[None]]) -> Callable[..., Awaitable[None]]:
    """Return an application that notes when the client of a request disconnects.

    Before protocol 2026-07-28, the SDK lets a request continue when its connection is lost.
    """

    async def noting(scope: dict[str, Any], receive: Callable[[], Awaitable[Any]], send: Any) -> None:
        gone = scope[_GONE] = asyncio.Event()

        async def receive_and_note() -> Any:
            message = await receive()
            if message["type"] == "http.disconnect":
                gone.set()
            return message

        await app(scope, receive_and_note, send)

    return noting


async def _cancel_when(event: asyncio.Event, scope: anyio.CancelScope) -> None:
    await event.wait()
    scope.cancel()


class _Token:
    """Verifier of the SDK that accepts one token."""

    def __init__(self, token: str) -> None:
        self._token = token.encode()

    async def verify_token(self, token: str) -> AccessToken | None:
        """Return the rights of a token, or None. The duration does not reveal how much of a wrong token was right."""
        if not hmac.compare_digest(token.encode(), self._token):
            return None
        return AccessToken(token=token, client_id="urlink", scopes=[])


class _Uvicorn(uvicorn.Server):
    """HTTP server that reports its start. Signals are handled by the program, because this is not its main thread."""

    def __init__(self, config: uvicorn.Config, started: Callable[[], object]) -> None:
        super().__init__(config)
        self._report = started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start listening. uvicorn calls this method."""
        await super().startup(sockets)
        self._report()
