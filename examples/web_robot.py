"""A robot behind HTTP: its state, states as they come over a WebSocket, and motions that end with their request.

    pip install fastapi uvicorn
    ROBOT=192.168.56.101 uvicorn web_robot:app            # or ROBOT=sim://
    curl localhost:8000/state
    curl localhost:8000/move_joints --json '{"q": [0, -1.5, 1.5, -1.5, -1.5, 0]}'

A motion is answered when it is over. Whoever closes the connection before stops the arm.
"""

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator
from typing import Any

from fastapi import FastAPI, HTTPException, Request, WebSocket, WebSocketDisconnect
from pydantic import BaseModel, Field

import urlink

#: Seconds between two looks whether a client is still there, and between two states of a WebSocket.
LOOK, PERIOD = 0.05, 0.1


class Move(BaseModel):
    q: list[float] = Field(description="positions of the joints, base to wrist 3, rad")
    speed: float = Field(1.05, description="rad/s of the joint that is furthest")


def create_app(address: str) -> FastAPI:
    """The application of one robot."""

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        with urlink.connect(address) as robot:
            await asyncio.to_thread(robot.realtime.wait)
            app.state.robot = robot
            yield

    app = FastAPI(title="A robot", lifespan=lifespan)

    @app.get("/state")
    def state() -> dict[str, Any]:
        robot: urlink.Robot = app.state.robot
        latest = robot.realtime.latest
        if latest is None or latest.received is None:
            raise HTTPException(503, "nothing has come of the robot")
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
            # In a thread: to begin a motion may take until the robot has answered.
            motion = await asyncio.to_thread(robot.motion.move_joints, move.q, move.speed)
            with motion:  # which cancels it, where it is left before it is over
                while not motion.done:
                    if await request.is_disconnected():
                        raise HTTPException(499, "the client has gone; the arm brakes")
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
    app = create_app(os.environ["ROBOT"])
