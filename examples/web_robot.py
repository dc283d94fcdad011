"""Serve a robot over HTTP: its state, a WebSocket with states, and motions that end with their request.

    pip install fastapi uvicorn
    ROBOT=192.168.56.101 uvicorn web_robot:app            # or ROBOT=sim://
    curl localhost:8000/state
    curl localhost:8000/move_joints --json '{"q": [0, -1.5, 1.5, -1.5, -1.5, 0]}'

The answer to a motion is sent when the motion has ended. If the client closes the connection earlier, the arm stops.

A browser sends requests for every open page, even to a robot in its network, and includes the origin of the page.
Origins that are not allowed are rejected, over HTTP and WebSocket. By default, the origins of port 8000 of this
computer are allowed; ORIGINS="http://cell.local:8000 https://lab" replaces them. Programs other than browsers send no
origin, so this is not a login.

A web site can also give its own host name the address of this computer (DNS rebinding). Its pages then have the same
origin as this server, so the browser lets them read the answers and sends no origin for them. Therefore the header Host
must be the host of an allowed origin, or an IP address, which such an attack cannot use.
"""

import asyncio
import contextlib
import ipaddress
import os
from collections.abc import AsyncIterator
from typing import Any
from urllib.parse import urlsplit

from fastapi import FastAPI, HTTPException, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import PlainTextResponse
from pydantic import BaseModel, Field
from starlette.websockets import WebSocketClose

import urlink

#: Interval, in s, for checking whether a client is still connected, and for the states of a WebSocket.
LOOK, PERIOD = 0.05, 0.1

#: Default origins of pages whose requests are accepted.
ORIGINS = frozenset(("http://localhost:8000", "http://127.0.0.1:8000"))


class OriginCheck:
    """Rejection of requests that a browser sends for a page of another origin or host."""

    def __init__(self, app: Any, origins: frozenset[str]) -> None:
        self.app = app
        self.origins = origins
        self.hosts = frozenset(urlsplit(origin).hostname for origin in origins)

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        headers = [(name, value.decode("latin-1")) for name, value in scope.get("headers", ())]
        rejected = [f"origin {value}" for name, value in headers if name == b"origin" and value not in self.origins]
        rejected += [f"host {value}" for name, value in headers if name == b"host" and not self._is_known(value)]
        if not rejected:
            await self.app(scope, receive, send)
        elif scope["type"] == "websocket":
            await WebSocketClose(1008)(scope, receive, send)
        else:
            await PlainTextResponse(f"the {rejected[0]} is not allowed", 403)(scope, receive, send)

    def _is_known(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
            return name in self.hosts or bool(ipaddress.ip_address(name))
        except ValueError:
            return False


class Move(BaseModel):
    q: list[float] = Field(description="positions of the joints, base to wrist 3, rad")
    speed: float = Field(1.05, description="speed of the joint with the longest distance, rad/s")


def create_app(address: str, origins: frozenset[str] = ORIGINS) -> FastAPI:
    """Create the application of one robot, for pages of these origins."""

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        with urlink.connect(address) as robot:
            await asyncio.to_thread(robot.realtime.wait)
            app.state.robot = robot
            yield

    app = FastAPI(title="A robot", lifespan=lifespan)
    app.add_middleware(OriginCheck, origins=origins)

    @app.get("/state")
    def state() -> dict[str, Any]:
        robot: urlink.Robot = app.state.robot
        latest = robot.realtime.latest
        if latest is None or latest.received is None:
            raise HTTPException(503, "no state has arrived from the robot")
        refusal = robot.safety.refusal
        return {
            "q": latest.q_actual.tolist(),
            "pose": latest.tool_vector_actual.tolist(),
            "age": latest.received.age,
            "refusal": None if refusal is None else str(refusal),
        }

    @app.websocket("/states")
    async def states(socket: WebSocket) -> None:
        await socket.accept()
        with contextlib.suppress(WebSocketDisconnect):
            while True:
                await socket.send_json(state())
                await asyncio.sleep(PERIOD)

    @app.post("/move_joints")
    async def move_joints(move: Move, request: Request) -> dict[str, str]:
        robot: urlink.Robot = app.state.robot
        try:
            # In a thread, because starting a motion may wait for the robot.
            motion = await asyncio.to_thread(robot.motion.move_joints, move.q, move.speed)
            with motion:  # cancels the motion if the block is left early
                while not motion.done:
                    if await request.is_disconnected():
                        raise HTTPException(499, "the client has disconnected; the arm brakes")
                    await asyncio.sleep(LOOK)
            motion.wait()
        except urlink.BadValue as error:
            raise HTTPException(422, str(error)) from error
        except urlink.LinkError as error:
            raise HTTPException(409, f"{type(error).__name__}: {error}") from error
        return {"phase": motion.phase.value}

    @app.post("/stop")
    async def stop() -> dict[str, str]:
        motion = app.state.robot.motion.current
        if motion is not None:
            motion.cancel()
        return {"phase": "done" if motion is None else motion.phase.value}

    return app


if "ROBOT" in os.environ:
    app = create_app(os.environ["ROBOT"], frozenset(os.environ.get("ORIGINS", "").split()) or ORIGINS)
