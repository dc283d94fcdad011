"""Public methods of a robot, found by introspection, with drawn arguments for every parameter.

An action is named by the attribute of the robot and the method: ``motion.jog``, ``io.set_digital_out``,
``robot.set_payload``. The methods of an entered block are used as well, such as ``Jog.move``. A new method is tried
automatically. A new parameter needs a row in `DRAWERS`; `test_surface.py` lists parameters without a row.
"""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

import urlink
from linkcore.handle import Handle
from linkcore.recording.recorder import Recorder
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import Subscription
from urlink.command.interpreter import Interpreter
from urlink.command.io import IO
from urlink.command.safety import Safety
from urlink.command.scripts import Scripts
from urlink.motion.motions import Motions
from urlink.motion.servo.force_control import ForceMode, Freedrive, Torque
from urlink.motion.servo.impedance import Impedance
from urlink.motion.servo.jog import Jog
from urlink.motion.servo.servo import Servo
from urlink.motion.stream.point_stream import PointStream
from urlink.motion.teaching import Teaching
from urlink.protocol.dashboard.client import Dashboard
from urlink.protocol.gripper.client import Gripper
from urlink.protocol.tool_serial import ToolSerial
from urlink.robot import Robot
from urlink.rtde.client import Rtde
from urlink.rtde.inputs import Inputs
from urlink.rtde.outputs import OutputStream
from urlink.rtde.registers import Registers

__all__ = ["ACTIONS", "BLOCKS", "DRAWERS", "LEFT_OUT", "Action", "Drawing", "kind_of", "lacking", "missing_parts"]

#: Attributes of a robot that have methods, and their classes; "robot" is the robot itself.
PARTS: Mapping[str, type] = {
    "robot": Robot,
    "motion": Motions,
    "io": IO,
    "script": Scripts,
    "safety": Safety,
    "gripper": Gripper,
    "dashboard": Dashboard,
    "rtde": Rtde,
    "registers": Registers,
    "tool_serial": ToolSerial,
    "realtime": Stream,
    "primary": Stream,
    "secondary": Stream,
}
#: Attributes of a robot that have no methods to try: values, the simulator itself, and the points, which need a file.
VALUES = {"clock", "controller", "firmware", "identity", "kinematics", "limits", "model", "points"}
#: Class of the entered block, by the action that opens it.
BLOCKS: Mapping[str, type] = {
    "motion.servo": Servo,
    "motion.stream": PointStream,
    "motion.jog": Jog,
    "motion.force_mode": ForceMode,
    "motion.torque": Torque,
    "motion.impedance": Impedance,
    "robot.freedrive": Freedrive,
    "robot.teach": Teaching,
    "robot.interpreter": Interpreter,
    "rtde.inputs": Inputs,
    "rtde.outputs": OutputStream,
}
#: Blocks in which the arm may move.
MOVING_BLOCKS = tuple(name for name in BLOCKS if not name.startswith("rtde"))
#: Actions that are not tried, with the reason.
LEFT_OUT: Mapping[str, str] = {
    "robot.view": "it opens a web server and windows",
    "robot.measure_payload": "it takes a minute; tests of the payload cover it",
    "robot.measure_payload_by_hand": "it needs a person; tests of the payload cover it",
    "robot.wrench": "it needs a measured payload; tests of the wrench cover it",
    "robot.record": "it writes files; tests of recordings cover it",
    "realtime.plot": "it needs matplotlib",
    "primary.plot": "it needs matplotlib",
    "secondary.plot": "it needs matplotlib",
    "realtime.join": "it waits until the stream is closed",
    "primary.join": "it waits until the stream is closed",
    "secondary.join": "it waits until the stream is closed",
    "dashboard.shutdown": "the controller does not start again on its own",
    "dashboard.download_program": "it needs a program of PolyScope X",
    "dashboard.upload_program": "it needs a file of PolyScope X",
    "dashboard.send": "it takes any text; the other methods send every command",
    "tool_serial.close": "it is a connection of its own; closing the robot covers it",
}


@dataclass(frozen=True)
class Action:
    """Public method.

    Attributes:
        name: Name as "part.method".
        kind: "motion" if it returns a handle, "block" if its result is entered, "call" otherwise.
        method: Function of the class of the part.
    """

    name: str
    kind: str
    method: Callable[..., Any]

    @property
    def part(self) -> str:
        return self.name.partition(".")[0]

    def parameters(self) -> Iterator[inspect.Parameter]:
        """Yield its parameters without `self`."""
        yield from list(inspect.signature(self.method).parameters.values())[1:]

    def arguments(self, drawing: Drawing) -> tuple[list[Any], dict[str, Any]]:
        """Draw arguments for all required parameters, and for some parameters with a default."""
        return drawn_arguments(self.name, self.parameters(), drawing)

    def of(self, robot: Any) -> Callable[..., Any]:
        """Return the bound method of a robot, or of an asyncio robot.

        Raises:
            AttributeError: If the robot does not have the method.
        """
        method = self.name.partition(".")[2]
        part = robot if self.part == "robot" else getattr(robot, self.part)
        bound: Callable[..., Any] = getattr(part, method)
        return bound


@dataclass
class Drawing:
    """Source of drawn arguments.

    Attributes:
        chance: Random generator.
        q, pose: Target joint positions and pose of the tool.
        on_call: Function that drawn callbacks call; it may raise.
    """

    chance: random.Random
    q: np.ndarray = field(default_factory=lambda: np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0]))
    pose: np.ndarray = field(default_factory=lambda: np.array([-0.3, -0.1, 0.4, 0.0, 3.1, 0.0]))
    on_call: Callable[[], object] = lambda: None
    #: Time on the clock of a point stream after which the next point comes, in s.
    end: float = 0.0

    def between(self, least: float, most: float) -> float:
        return self.chance.uniform(least, most)

    def chosen(self, *values: Any) -> Any:
        return self.chance.choice(values)

    def near(self, radians: float = 0.3) -> list[float]:
        """Return joint positions near the current ones."""
        return [float(each + self.between(-radians, radians)) for each in self.q]

    def raised(self) -> list[float]:
        """Return a pose near the current one."""
        offset = [self.between(-0.04, 0.04) for _ in range(3)]
        return [*(float(a + b) for a, b in zip(self.pose[:3], offset, strict=True)), *map(float, self.pose[3:])]

    def wait(self) -> bool | float:
        return bool(self.chance.random() < 0.5) or self.chosen(False, self.between(0.02, 2.0))

    def six(self, most: float) -> list[float]:
        return [self.between(-most, most) for _ in range(6)]

    def one_of_six(self, most: float) -> list[float]:
        """Return a speed along or about one axis."""
        values = [0.0] * 6
        values[self.chance.randrange(6)] = self.chosen(-1, 1) * self.between(0.2 * most, most)
        return values

    def callback(self) -> Callable[..., object]:
        on_call = self.on_call
        return lambda *_: on_call()


Drawer = Callable[[Drawing], Any]
READY = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
_LINKS = ("reverse", "rtde")


def _waypoints(d: Drawing) -> list[Any]:
    """Draw waypoints with joint positions and poses, ending in joint positions."""
    ways: list[Any] = [urlink.Joint(d.near(0.15), blend=d.chosen(0.0, 0.02))]
    if d.chance.random() < 0.5:
        ways.append(urlink.Linear(d.raised()))
    return [*ways, urlink.Joint(d.near(0.2))]


def _trajectory(d: Drawing) -> urlink.Trajectory:
    step = np.array(d.six(0.1))
    return urlink.Trajectory.from_arrays([0.0, 0.3, 0.7], np.array([d.q, d.q + step, d.q + 2 * step]))


def _points(d: Drawing) -> Any:
    time = d.end
    points = []
    for _ in range(d.chance.randint(1, 4)):
        time += d.between(0.1, 0.4)
        points.append(urlink.TrajectoryPoint(d.near(0.03), time, [0.0] * 6))
    return points if d.chance.random() < 0.7 else points[0]


def _source(d: Drawing) -> str:
    q = d.near()
    texts = (
        f"def p():\n  movej({q}, v=0.5)\n  textmsg(1)\nend\n",
        f"movej({q}, v=0.5)\nsleep({d.between(0.0, 0.3)})\nmovej({list(READY)}, v=0.5)",
        f"def p():\n  movj({q})\nend\n",
        f"def p():\n  movej({q}, v=0.5)\n  movej([1, 2], v=0.5)\nend\n",
        "sec s():\n  set_flag(1, True)\nend",
    )
    return str(d.chosen(*texts))


def _statement(d: Drawing) -> str:
    return str(
        d.chosen(f"movej({d.near()}, v=0.3)", f"movej({d.near()}, v=0.6)", "set_digital_out(1, True)", "sleep(0.2)")
    )


#: Functions that draw arguments, by "part.method.parameter", "Class.method.parameter", "part.parameter" or "parameter".
DRAWERS: Mapping[str, Drawer] = MappingProxyType(
    {
        # motions
        "q": lambda d: d.near(),
        "pose": lambda d: d.raised(),
        "via": lambda d: d.raised(),
        "to": lambda d: d.raised(),
        "speed": lambda d: d.between(0.05, 0.4),
        "motion.until_contact.speed": lambda d: d.between(0.01, 0.08),
        "motion.impedance.speed": lambda d: d.between(0.5, 1.5),
        "motion.servo.speed": lambda d: d.between(0.3, 1.0),
        "joint_speed": lambda d: d.between(0.2, 1.0),
        "joint_acceleration": lambda d: d.between(0.5, 2.0),
        "acceleration": lambda d: d.between(0.3, 2.0),
        "robot.set_gravity.acceleration": lambda d: [0.0, 0.0, 9.82],
        "motion.stream.acceleration": lambda d: d.between(5.0, 12.0),
        "jerk": lambda d: d.between(30.0, 100.0),
        "time": lambda d: d.between(0.5, 2.0),
        "wait": lambda d: d.wait(),
        "waypoints": _waypoints,
        "trajectory": _trajectory,
        "low_bandwidth": lambda d: d.chosen(False, True),
        "path_tolerance": lambda d: d.chosen(None, 0.2),
        "goal_tolerance": lambda d: d.between(0.01, 0.05),
        "goal_time": lambda d: d.between(0.5, 1.5),
        "start_tolerance": lambda d: d.between(0.05, 0.1),
        "feedback": lambda d: d.callback(),
        "delay": lambda d: d.chosen(None, 0.02),
        "watchdog": lambda d: d.between(0.15, 0.5),
        "lookahead_time": lambda d: d.between(0.03, 0.1),
        "gain": lambda d: d.between(200.0, 600.0),
        "motion.force_mode.gain": lambda d: d.chosen(None, 1.0),
        "scaling": lambda d: d.chosen("follow", "ignore"),
        "qd": lambda d: d.six(0.3),
        "xd": lambda d: d.one_of_six(0.06),
        "duration": lambda d: d.between(0.05, 1.2),
        "Servo.measure_delay.duration": lambda d: d.between(0.3, 0.6),
        "link": lambda d: d.chosen(*_LINKS),
        "direction": lambda d: d.chosen([0, 0, -1], [0, 1, 0]),
        "distance": lambda d: d.between(0.01, 0.06),
        "force": lambda d: d.chosen(None, 20.0),
        "motion.impedance.force": lambda d: None,
        "retract": lambda d: d.chosen(True, False),
        "rate": lambda d: None,
        "target_filter": lambda d: d.chosen(None, "jerk_limited"),
        "buffer": lambda d: d.between(0.1, 0.8),
        "frame": lambda d: d.chosen("joints", "base", "tool"),
        "motion.force_mode.frame": lambda d: d.chosen("base", "tool", [0.0] * 6),
        "robot.freedrive.frame": lambda d: d.chosen("base", "tool"),
        "robot.teach.frame": lambda d: d.chosen("base", "tool"),
        "selection": lambda d: d.chosen([0, 0, 1, 0, 0, 0], [1, 1, 0, 0, 0, 0]),
        "wrench": lambda d: [0.0, 0.0, d.between(-15.0, 5.0), 0.0, 0.0, 0.0],
        "limits": lambda d: [d.between(0.03, 0.1)] * 6,
        "motion.torque.limits": lambda d: None,
        "kind": lambda d: d.chosen(1, 2, 3),
        "damping": lambda d: d.chosen(None, 0.1),
        "motion.impedance.damping": lambda d: d.between(0.5, 1.5),
        "stiffness": lambda d: None,
        "Impedance.set_gains.stiffness": lambda d: d.between(100.0, 400.0),
        "Impedance.set_gains.damping": lambda d: d.between(0.5, 1.5),
        "torque": lambda d: None,
        "Torque.send.torque": lambda d: [0.0, 0.0, 0.0, 0.0, 0.0, d.between(-0.5, 0.5)],
        "error": lambda d: None,
        "robot.popup.error": lambda d: d.chosen(False, True),
        "posture_stiffness": lambda d: None,
        "friction_compensation": lambda d: d.chosen(True, False),
        "axes": lambda d: d.chosen(None, [1, 1, 1, 0, 0, 0]),
        "digital_input": lambda d: d.chosen(None, 0),
        "bank": lambda d: "standard",
        "button": lambda d: d.chosen(False, True),
        "on_point": lambda d: d.callback(),
        # methods of blocks
        "Servo.send.q": lambda d: d.near(0.01),
        "target": lambda d: d.near(0.05),
        "Impedance.send.target": lambda d: d.near(0.02),
        "posture": lambda d: None,
        "at": lambda d: d.end + d.between(0.1, 0.5),
        "joint": lambda d: d.chance.randrange(6),
        "amplitude": lambda d: d.between(0.01, 0.05),
        "speeds": lambda d: d.one_of_six(0.1),
        "points": _points,
        "from_time": lambda d: d.end + d.between(-0.1, 0.2),
        "statement": _statement,
        # programs, inputs and outputs
        "source": _source,
        # A detached program keeps running after the end, and could not be distinguished from a forgotten one.
        "detached": lambda d: False,
        "on_text": lambda d: d.callback(),
        "line": lambda d: d.chosen("set_digital_out(2, True)", f"movej({d.near(0.1)}, v=0.5)"),
        "start_timeout": lambda d: d.between(1.0, 4.0),
        "finish_timeout": lambda d: d.between(1.0, 5.0),
        "number": lambda d: d.chance.randrange(2),
        "registers.number": lambda d: d.chance.randrange(24, 48),
        "registers.read_bit.number": lambda d: d.chance.randrange(64, 128),
        "registers.write_bit.number": lambda d: d.chance.randrange(64, 128),
        "on": lambda d: d.chosen(True, False),
        "fraction": lambda d: d.between(0.2, 1.0),
        "confirm": lambda d: d.chosen(None, 0.3, 1.0),
        "enabled": lambda d: d.chosen(True, False),
        "baud_rate": lambda d: d.chosen(9600, 115200),
        "parity": lambda d: d.chosen("none", "odd", "even"),
        "stop_bits": lambda d: d.chosen(1, 2),
        "rx_idle_chars": lambda d: d.between(1.0, 5.0),
        "tx_idle_chars": lambda d: d.between(0.0, 5.0),
        "volts": lambda d: d.chosen(0, 12, 24),
        "value": lambda d: d.chance.randrange(100),
        "registers.write_bit.value": lambda d: d.chosen(True, False),
        "registers.write_float.value": lambda d: d.between(0.0, 1.0),
        "mass": lambda d: d.between(0.0, 2.0),
        "cog": lambda d: d.chosen(None, [0.0, 0.0, 0.02]),
        "inertia": lambda d: None,
        "transition_time": lambda d: d.chosen(0.0, 0.2),
        "robot.set_tcp.pose": lambda d: [0.0, 0.0, d.between(0.0, 0.1), 0.0, 0.0, 0.0],
        "warning": lambda d: d.chosen(False, True),
        "text": lambda d: "hello",
        "title": lambda d: "title",
        "message": lambda d: "hello",
        # waiting
        "timeout": lambda d: d.between(0.05, 2.0),
        "robot.close.timeout": lambda d: 2.0,
        "Interpreter.end.timeout": lambda d: d.between(1.0, 4.0),
        "dashboard.start.timeout": lambda d: d.between(2.0, 6.0),
        "seconds": lambda d: d.between(0.1, 1.0),
        "condition": lambda d: lambda state: d.chance.random() < 0.1,
        "policy": lambda d: d.chosen(None, urlink.latest, urlink.drop_oldest(3)),
        "lifespan": lambda d: d.chosen(None, 0.5),
        "deadline": lambda d: d.chosen(None, 0.05),
        "on_deadline": lambda d: None,
        "inline": lambda d: False,
        "callback": lambda d: d.callback(),
        # others
        "path": lambda d: "/programs/pick.urp",
        "name": lambda d: d.chosen("POS", "OBJ", "FLT"),
        "directory": lambda d: "/programs",
        "mode": lambda d: d.chosen("manual", "automatic"),
        "role": lambda d: d.chosen("programmer", "operator"),
        "dashboard.generate_flight_report.kind": lambda d: "system",
        "realtime.subscribe.kind": lambda d: None,
        "primary.subscribe.kind": lambda d: None,
        "secondary.subscribe.kind": lambda d: None,
        "realtime.of.kind": lambda d: urlink.RealtimeState,
        "primary.of.kind": lambda d: urlink.packets.RobotState,
        "secondary.of.kind": lambda d: urlink.packets.RobotState,
        "again": lambda d: d.chosen(False, True),
        "position": lambda d: d.chance.randrange(256),
        "gripper.speed": lambda d: d.chance.randrange(256),
        "gripper.force": lambda d: d.chance.randrange(256),
        "gripper.set.values": lambda d: {"SPE": d.chance.randrange(256)},
        "names": lambda d: d.chosen(("actual_q",), ("actual_q", "output_int_register_47")),
        "rtde.inputs.names": lambda d: d.chosen(("speed_slider_fraction",), ("standard_digital_output",)),
        "Inputs.send.values": lambda d: {},
        "frequency": lambda d: d.chosen(None, 25.0, 125.0),
        "missing": lambda d: "leave_out",
        "lower": lambda d: False,
        "request": lambda d: b"\x01\x03",
        "data": lambda d: b"\x01\x03",
        # It applies only to a point by name.
        "keep": lambda d: None,
        "size": lambda d: d.chance.randint(1, 4),
    }
)


def drawer_of(owner: str, parameter: str) -> Drawer | None:
    """Return the drawer for an argument of "part.method", or None without a row in `DRAWERS`."""
    part = owner.partition(".")[0]
    for key in (f"{owner}.{parameter}", f"{part}.{parameter}", parameter):
        if key in DRAWERS:
            return DRAWERS[key]
    return None


def drawn_arguments(
    owner: str, parameters: Iterator[inspect.Parameter], drawing: Drawing
) -> tuple[list[Any], dict[str, Any]]:
    """Draw positional and named arguments for these parameters."""
    positional: list[Any] = []
    named: dict[str, Any] = {}
    for each in parameters:
        drawer = drawer_of(owner, each.name)
        assert drawer is not None, f"{owner} has no drawer for {each.name!r}: add it to DRAWERS"
        if each.kind is each.VAR_POSITIONAL:
            positional += drawer(drawing)
        elif each.kind is each.VAR_KEYWORD:
            named |= drawer(drawing)
        elif each.default is each.empty or drawing.chance.random() < 0.4:
            if each.kind is each.POSITIONAL_ONLY:
                positional.append(drawer(drawing))
            else:
                named[each.name] = drawer(drawing)
    return positional, named


def public_methods(cls: type) -> dict[str, Callable[..., Any]]:
    """Return the methods of a class by name, without names that begin with an underscore."""
    found: dict[str, Callable[..., Any]] = {}
    for name in sorted(dir(cls)):
        member = inspect.getattr_static(cls, name)
        if not name.startswith("_") and inspect.isfunction(member):
            found[name] = member
    return found


def kind_of(name: str, method: Callable[..., Any]) -> str:
    """Return the kind of an action: "motion", "block" or "call"."""
    if name in MOVING_BLOCKS:
        return "block"
    returned = str(inspect.signature(method).return_annotation)
    return "motion" if returned in ("Motion", "PathMotion", "ContactMotion", "Program") else "call"


def _actions() -> Iterator[Action]:
    for part, cls in PARTS.items():
        for name, method in public_methods(cls).items():
            path = f"{part}.{name}"
            if path not in LEFT_OUT:
                yield Action(path, kind_of(path, method), method)


#: Actions by name.
ACTIONS: Mapping[str, Action] = MappingProxyType({each.name: each for each in _actions()})
#: Class of block -> its own methods, without the methods that every handle has, which are called in other places.
OF_BLOCKS: Mapping[type, Mapping[str, Callable[..., Any]]] = MappingProxyType(
    {
        cls: {
            name: method
            for name, method in public_methods(cls).items()
            if name not in {*public_methods(Handle), "plot", "join"}
        }
        for cls in BLOCKS.values()
    }
)
#: Classes of results that must be closed.
CLOSED = (Subscription, Recorder)


def lacking() -> list[str]:
    """Return the parameters without a drawer."""
    found = []
    for action in ACTIONS.values():
        found += [f"{action.name}.{each.name}" for each in action.parameters() if not drawer_of(action.name, each.name)]
    for cls, methods in OF_BLOCKS.items():
        for name, method in methods.items():
            owner = f"{cls.__name__}.{name}"
            parameters = list(inspect.signature(method).parameters)[1:]
            found += [f"{owner}.{each}" for each in parameters if not drawer_of(owner, each)]
    return found


def missing_parts() -> list[str]:
    """Return the attributes of a robot that are neither in `PARTS` nor in `VALUES`."""
    properties = {name for name in dir(Robot) if isinstance(inspect.getattr_static(Robot, name), property)}
    return sorted(name for name in properties if not name.startswith("_") and name not in PARTS.keys() | VALUES)
