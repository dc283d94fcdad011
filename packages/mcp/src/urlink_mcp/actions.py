"""Requests that change something on a robot: their arguments, their checks, and the sentence that a person reads."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from urlink import BadValue, Cancelled, LocalError, Motion, PendingCall, Point, Robot
from urlink.arm.poses import compose, invert
from urlink.packets import RealtimeState
from urlink.tools import JOINTS, FloatArray, shown_tcp

__all__ = [
    "ACTIONS",
    "Action",
    "MoveJoints",
    "MoveLinear",
    "MoveToPoint",
    "OfRobot",
    "SetDigitalOutput",
    "prepare",
    "rehearse",
]

Six = Annotated[list[float], Field(min_length=6, max_length=6)]


class OfRobot(BaseModel):
    """Arguments of a tool that needs only a robot."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    robot: str | None = Field(None, description="name of the robot; needed only if the server has several")


class MoveJoints(OfRobot):
    """Arguments of `move_joints`."""

    q: Six = Field(description="joint positions from base to wrist 3, in rad")
    speed: float = Field(0.2, description="speed of the joint that moves furthest, in rad/s")
    acceleration: float = Field(0.5, description="acceleration of this joint, in rad/s^2")


class MoveLinear(OfRobot):
    """Arguments of `move_linear`."""

    pose: Six = Field(description="position in m, and rotation vector in rad, of the tool in the base frame")
    speed: float = Field(0.05, description="speed of the tool, in m/s")
    acceleration: float = Field(0.3, description="acceleration of the tool, in m/s^2")


class MoveToPoint(OfRobot):
    """Arguments of `move_to_point`."""

    point: str = Field(description="name of a taught point; list_points returns the names")
    linear: bool = Field(False, description="move the tool in a straight line; false moves the joints")
    speed: float | None = Field(None, description="in rad/s, or in m/s if linear (default: 0.2 rad/s, 0.05 m/s)")


class SetDigitalOutput(OfRobot):
    """Arguments of `set_digital_output`."""

    number: int = Field(description="number of the output, 0 to 7; 0 or 1 for the tool")
    on: bool = Field(description="true switches the output on")
    bank: Literal["standard", "configurable", "tool"] = Field("standard", description="group of outputs")


#: Tools whose requests need consent, and their arguments.
ACTIONS: dict[str, type[OfRobot]] = {
    "move_joints": MoveJoints,
    "move_linear": MoveLinear,
    "move_to_point": MoveToPoint,
    "set_digital_output": SetDigitalOutput,
}


@dataclasses.dataclass(frozen=True)
class Action:
    """Request that was checked.

    Attributes:
        sentence: What will happen, for the person who decides.
        execute: Function that starts it. It returns the motion, or None.
        moves: Whether the arm moves.
        q: Joint positions at the time of the checks, shape (6,), in rad.
        tcp: TCP in the flange frame at that time, shape (6,), in m and rad.
    """

    sentence: str
    execute: Callable[[], Motion | None]
    moves: bool
    q: FloatArray
    tcp: FloatArray


class _Rehearsal(PendingCall):
    """Abandoned call. Its waits for a state are not ended, because they come before some of the checks."""

    def __init__(self) -> None:
        super().__init__()
        self.give_up()

    @contextlib.contextmanager
    def interruptible(self, wake: Callable[[], object]) -> Iterator[None]:
        yield


def rehearse(call: Callable[[], object]) -> None:
    """Make all checks of a call without its effect: arguments, reach, and limits of the session.

    An abandoned call checks its arguments as always, and raises `Cancelled` before anything is sent. So this function
    and the later call cannot disagree.

    Raises:
        LinkError: If the call would be refused. Nothing is sent.
    """
    try:
        _Rehearsal().make(call)
    except Cancelled:
        return
    raise LocalError("the command did not notice that it was abandoned")


def prepare(robot: Robot, state: RealtimeState, given: OfRobot) -> Action:
    """Check a request, and describe it.

    Args:
        robot: Robot to command.
        state: Current state of the robot.
        given: Arguments of the tool.

    Raises:
        LinkError: If the request would be refused. Nothing is sent.
    """
    arm = robot.kinematics
    tcp = shown_tcp(arm, state)
    if isinstance(given, SetDigitalOutput):
        execute = partial(_switch, robot, given)
        rehearse(execute)
        sentence = (
            f"The {given.bank} digital output {given.number} will be switched {'on' if given.on else 'off'}. "
            "Equipment that is connected to it might start to move."
        )
        return Action(sentence, execute, False, state.q_actual, tcp)
    start: Callable[[], Motion]
    if isinstance(given, MoveJoints):
        start = partial(robot.motion.move_joints, given.q, given.speed, given.acceleration)
        rehearse(start)
        sentence = _joints_sentence(robot, state, tcp, np.array(given.q), given.speed)
    elif isinstance(given, MoveLinear):
        start = partial(robot.motion.move_linear, given.pose, given.speed, given.acceleration)
        rehearse(start)
        sentence = _linear_sentence(robot, state, np.array(given.pose), given.speed)
    elif isinstance(given, MoveToPoint):
        start, sentence = _to_point(robot, state, tcp, given)
    else:
        raise BadValue(f"{type(given).__name__} is not a request that needs consent")
    if state.qd_target.any():
        raise LocalError("the arm is moving; wait until it is at rest, or call stop")
    return Action(sentence, start, True, state.q_actual, tcp)


def _switch(robot: Robot, given: SetDigitalOutput) -> None:
    setters = {
        "standard": robot.io.set_digital_out,
        "configurable": robot.io.set_configurable_digital_out,
        "tool": robot.io.set_tool_digital_out,
    }
    setters[given.bank](given.number, given.on)


def _to_point(
    robot: Robot, state: RealtimeState, tcp: FloatArray, given: MoveToPoint
) -> tuple[Callable[[], Motion], str]:
    # Read once: a point that another program changes while a person decides must not move the arm elsewhere.
    point: Point = robot.points[given.point]
    start: Callable[[], Motion]
    if given.linear:
        speed = MoveLinear.model_fields["speed"].default if given.speed is None else given.speed
        start = partial(robot.motion.move_linear, point, speed, MoveLinear.model_fields["acceleration"].default)
        rehearse(start)
        sentence = _linear_sentence(robot, state, point.pose, speed)
    else:
        speed = MoveJoints.model_fields["speed"].default if given.speed is None else given.speed
        start = partial(robot.motion.move_joints, point, speed, MoveJoints.model_fields["acceleration"].default)
        rehearse(start)
        sentence = _joints_sentence(robot, state, tcp, point.q, speed)
    return start, f"The arm will move to the point {given.point!r}. {sentence}"


def _joints_sentence(robot: Robot, state: RealtimeState, tcp: FloatArray, q: FloatArray, speed: float) -> str:
    turns = np.abs(q - state.q_actual)
    furthest = int(turns.argmax())
    end = robot.kinematics.forward(q, tcp)
    return (
        f"The joints will turn by up to {math.degrees(turns[furthest]):.1f} degrees ({JOINTS[furthest]}), "
        f"at up to {math.degrees(speed):.1f} degrees per second. {_end_of_tool(state, end)}"
    )


def _linear_sentence(robot: Robot, state: RealtimeState, pose: FloatArray, speed: float) -> str:
    turn = math.degrees(float(np.linalg.norm(compose(invert(state.tool_vector_actual), pose)[3:])))
    turned = f", and turn by {turn:.0f} degrees" if turn >= 1.0 else ""
    return f"The tool will move in a straight line at up to {speed:g} m/s{turned}. {_end_of_tool(state, pose)}"


def _end_of_tool(state: RealtimeState, end: Sequence[float] | FloatArray | Any) -> str:
    distance = float(np.linalg.norm(np.array(end[:3]) - state.tool_vector_actual[:3]))
    at = ", ".join(f"{name} {value:.3f}" for name, value in zip("xyz", end[:3], strict=True))
    return f"The tool ends {distance:.3f} m from where it is now, at {at} (m, in the base frame)."
