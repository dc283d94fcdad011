"""Use of the actions of `surface`: they are called with drawn arguments, entered, used, and checked."""

from __future__ import annotations

import contextlib
import inspect
import itertools
import random
import time
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import numpy as np

from linkcore.errors import LinkError, LocalError
from linkcore.streaming.subscription import Subscription
from urlink.arm.poses import rotvec_to_matrix
from urlink.motion.servo.jog import Jog
from urlink.simulator import Controller

from .surface import ACTIONS, OF_BLOCKS, Drawing, drawn_arguments
from .world import Ask

__all__ = [
    "begin",
    "call",
    "drawing",
    "during",
    "during_awaited",
    "effect",
    "limit",
    "on_call",
    "prepared",
    "use",
    "use_awaited",
]

#: Arguments that limit the duration of a call, in s.
_TIMES = ("timeout", "start_timeout", "finish_timeout", "duration", "seconds", "time", "goal_time", "transition_time")
#: Time that a call may take in addition to its arguments, in s: for connecting, sending and the confirmation.
_BESIDE = 12.0
#: Time for which a call with `wait=True` may wait for its motion, in s.
_WAITED = 60.0


def drawing(robot: Any, ask: Ask, step: int = 0) -> Drawing:
    """Return the source of drawn arguments for an ask. The same ask always gets the same arguments."""
    made = Drawing(random.Random(f"{ask.what} {ask.size} {step}"))
    state = None
    with contextlib.suppress(LinkError):
        state = robot.realtime.latest
    if state is not None:
        made.q, made.pose = state.q_target, state.tool_vector_actual
    return made


def limit(ask: Ask) -> float:
    """Return the time limit for the call of an ask, in s."""
    action = ACTIONS[ask.what]
    _, named = action.arguments(Drawing(random.Random(f"{ask.what} {ask.size} 0")))
    seconds = _BESIDE
    for each in action.parameters():
        value = named.get(each.name, each.default)
        if each.name in _TIMES and isinstance(value, (int, float)):
            seconds += value
        if each.name == "wait":
            seconds += _WAITED if value is True else float(value)
    return seconds


def begin(robot: Any, ask: Ask) -> Any:
    """Call the method of an action with drawn arguments."""
    action = ACTIONS[ask.what]
    drawn = drawing(robot, ask)
    drawn.on_call = lambda: on_call(robot, ask)
    positional, named = action.arguments(drawn)
    made = action.of(robot)(*positional, **named)
    _given[ask] = named, made
    return made


#: Arguments and result of the newest call of an ask.
_given: dict[Ask, tuple[dict[str, Any], Any]] = {}

Check = Callable[[Any, Any, dict[str, Any], Any], bool]


def effect(robot: Any, controller: Controller, ask: Ask) -> str | None:
    """Check the promised effect of the call of an ask; return a description of the difference, or None."""
    check = _EFFECTS.get(ask.what)
    named, made = _given.pop(ask, ({}, None))
    if check is None or named.get("confirm", 1.0) is None:
        return None
    is_right = True
    with contextlib.suppress(LinkError):
        if ask.what in _LATER:
            time.sleep(0.2)
        is_right = check(robot, controller, named, made)
    return None if is_right else f"it was called with {named} and returned {made!r}, but the robot differs from that"


def _signal(kind: str, first: int, argument: str | None = None) -> Check:
    """Return a check that a returned or set digital input or output equals the value of the controller."""

    def check(robot: Any, controller: Any, named: dict[str, Any], made: Any) -> bool:
        has = bool(getattr(controller.signals, kind) >> (first + named["number"]) & 1)
        return bool(has == (made if argument is None else named[argument]))

    return check


def _register(direction: str, kind: str) -> Check:
    def check(robot: Any, controller: Any, named: dict[str, Any], made: Any) -> bool:
        bank, number = getattr(controller.registers, direction), named["number"]
        has = bool(bank.bits >> number & 1) if kind == "bits" else getattr(bank, kind)[number]
        return bool(has == (made if direction == "outputs" else named["value"]))

    return check


def _arrives(robot: Any, controller: Any, named: dict[str, Any], made: Any) -> bool:
    return np.allclose(robot.realtime.wait(2.0).q_actual, named["q"], atol=0.02)


def _arrives_at_pose(name: str) -> Check:
    def check(robot: Any, controller: Any, named: dict[str, Any], made: Any) -> bool:
        return np.allclose(robot.realtime.wait(2.0).tool_vector_actual[:3], named[name][:3], atol=0.01)

    return check


def _stands(robot: Any, controller: Any, named: dict[str, Any], made: Any) -> bool:
    return bool(np.abs(robot.realtime.wait(2.0).qd_actual).max() < 0.05)


def _ends_at(robot: Any, controller: Any, named: dict[str, Any], made: Any) -> bool:
    return np.allclose(robot.realtime.wait(2.0).q_actual, named["trajectory"].q[-1], atol=0.05)


#: Checks after a call has returned and its motion has ended; they get robot, controller, arguments and result.
_EFFECTS: dict[str, Check] = {
    "io.digital_in": _signal("digital_inputs", 0),
    "io.configurable_digital_in": _signal("digital_inputs", 8),
    "io.tool_digital_in": _signal("digital_inputs", 16),
    "io.digital_out": _signal("digital_outputs", 0),
    "io.configurable_digital_out": _signal("digital_outputs", 8),
    "io.tool_digital_out": _signal("digital_outputs", 16),
    "io.set_digital_out": _signal("digital_outputs", 0, "on"),
    "io.set_configurable_digital_out": _signal("digital_outputs", 8, "on"),
    "io.set_tool_digital_out": _signal("digital_outputs", 16, "on"),
    "io.set_tool_voltage": lambda robot, controller, named, made: (
        controller.signals.tool_output_voltage == named["volts"]
    ),
    "io.set_flag": lambda robot, controller, named, made: controller.flags[named["number"]] == named["on"],
    "robot.set_speed_slider": lambda robot, controller, named, made: (
        abs(controller.speed_fraction - named["fraction"]) < 0.01
    ),
    "registers.read_bit": _register("outputs", "bits"),
    "registers.read_integer": _register("outputs", "integers"),
    "registers.read_float": _register("outputs", "floats"),
    "registers.write_bit": _register("inputs", "bits"),
    "registers.write_integer": _register("inputs", "integers"),
    "registers.write_float": _register("inputs", "floats"),
    "motion.move_joints": _arrives,
    "motion.move_linear": _arrives_at_pose("pose"),
    "motion.move_circular": _arrives_at_pose("to"),
    "motion.follow": _ends_at,
    "motion.stop": _stands,
    "motion.speed_joints": _stands,
    "motion.speed_linear": _stands,
}
#: Calls that do not wait for the effect on the controller.
_LATER = ("io.set_flag", "registers.write_bit", "registers.write_integer", "registers.write_float")


def prepared(controller: Controller, seed: int) -> None:
    """Give the inputs and registers of a controller different values."""
    chance = random.Random(f"controller {seed}")
    controller.signals.digital_inputs = chance.getrandbits(18) & ~(1 << 7)
    outputs = controller.registers.outputs
    outputs.bits = chance.getrandbits(128)
    outputs.integers = [chance.randrange(1000) for _ in outputs.integers]
    outputs.floats = [chance.random() for _ in outputs.floats]


def on_call(robot: Any, ask: Ask) -> None:
    """Act as a drawn callback: do nothing, or sometimes cancel the current motion."""
    if ask.size > 0.8:
        motion = robot.motion.current
        if motion is not None:
            motion.cancel()


def call(robot: Any, ask: Ask) -> None:
    """Call a method that starts no motion, and use its result."""
    use(robot, begin(robot, ask), ask)


def use(robot: Any, made: Any, ask: Ask) -> None:
    """Use a result: read from iterators, enter and leave context managers, and close subscriptions."""
    if isinstance(made, Iterator):
        with contextlib.suppress(LinkError):
            for _ in itertools.islice(made, 1 + int(4 * ask.size)):
                pass
    elif isinstance(made, Subscription):
        time.sleep(min(ask.patience, 0.2))
        made.close()
    elif type(made) in OF_BLOCKS:
        with made:
            during(robot, made, ask)
    elif hasattr(made, "__exit__"):
        with made:
            time.sleep(min(ask.patience, 0.2))
    elif callable(made):  # the result of `on_stop`, which ends the subscription
        made()


def _steps(block: Any, ask: Ask) -> Iterator[tuple[str, int, float]]:
    """Yield the actions in a block: the method, the number of calls, and the pause afterwards."""
    chance = random.Random(f"during {ask.what} {ask.size}")
    methods = OF_BLOCKS[type(block)]
    for _ in range(chance.randint(0, 5) if methods else 0):
        name = chance.choice(sorted(methods))
        often = chance.choice((1, 1, 25)) if name == "send" else 1
        yield name, often, chance.choice((0.0, 0.01, 0.1, 0.6, 2.0))


def during(robot: Any, block: Any, ask: Ask) -> None:
    """Call methods of an entered block with drawn arguments."""
    for step, (name, often, rest) in enumerate(_steps(block, ask)):
        for _ in range(often):
            with contextlib.suppress(LocalError):  # drawn values may be too far or too fast
                positional, named = _arguments(robot, block, name, ask, step)
                use(robot, getattr(block, name)(*positional, **named), ask)
            if often > 1:
                robot.realtime.wait(2.0)
        time.sleep(rest)
        if type(block) not in OF_BLOCKS:
            return


def _arguments(robot: Any, block: Any, name: str, ask: Ask, step: int) -> tuple[list[Any], dict[str, Any]]:
    drawn = drawing(robot, ask, step + 1)
    drawn.end = float(getattr(block, "end", 0.0) if not callable(getattr(block, "end", 0.0)) else 0.0)
    if name == "schedule":
        drawn.end = time.monotonic()
    method = OF_BLOCKS[type(getattr(block, "_part", block))][name]
    owner = f"{type(getattr(block, '_part', block)).__name__}.{name}"
    return drawn_arguments(owner, iter(list(inspect.signature(method).parameters.values())[1:]), drawn)


async def use_awaited(made: Any, ask: Ask) -> None:
    """Use a result of the asyncio interface; see `use`."""
    if isinstance(made, AsyncIterator):
        with contextlib.suppress(LinkError):
            for _ in range(1 + int(4 * ask.size)):
                await made.__anext__()
        close = getattr(made, "aclose", None)
        if close is not None:
            await close()
    elif isinstance(made, Subscription):
        made.close(0.0)
    elif callable(made):
        made()


def steps_awaited(block: Any, ask: Ask) -> Iterator[tuple[str, int, float]]:
    """Yield the actions in a block of the asyncio interface; see `_steps`."""
    part = getattr(block, "_part", block)
    yield from _steps(part, ask) if type(part) in OF_BLOCKS else ()


async def during_awaited(robot: Any, block: Any, name: str, ask: Ask, step: int) -> None:
    """Call one method of a block of the asyncio interface."""
    with contextlib.suppress(LocalError):
        positional, named = _arguments(robot, block, name, ask, step)
        if name == "measure_delay":  # the asyncio interface does not wrap this block
            await robot.call(block.measure_delay, *positional, **named)
            return
        made = getattr(block, name)(*positional, **named)
        if inspect.isawaitable(made):
            made = await made
        await use_awaited(made, ask)


def direction(jog: Jog, speeds: Any, state: Any) -> float | None:
    """Return the cosine between the requested and the actual speed, or None if the arm does not move."""
    wanted = np.asarray(speeds, dtype=float)
    if jog.frame == "joints":
        found = state.qd_actual
    else:
        found = state.tcp_speed_actual
        if jog.frame == "tool":
            turned = rotvec_to_matrix(state.tool_vector_actual[3:])
            wanted = np.concatenate([turned @ wanted[:3], turned @ wanted[3:]])
    sizes = float(np.linalg.norm(wanted) * np.linalg.norm(found))
    return None if np.linalg.norm(found) < 0.01 else float(wanted @ found) / sizes
