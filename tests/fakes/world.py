"""World of a URScript program (`urlink.simulator.urscript.world`) that records the requests of the program."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

from linkcore.errors import BadValue
from urlink.arm.dynamics import Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.motors import Motors, motors_of
from urlink.arm.vectors import FloatArray
from urlink.protocol.firmware import Firmware
from urlink.simulator.registers import Action, RegisterBanks
from urlink.simulator.robot.generator import ForceTask, OutOfReach
from urlink.simulator.robot.setpoint_sources import HOME
from urlink.simulator.robot.signals import ModbusSignals, Signals
from urlink.simulator.urscript import Execution, compile_script

State = Literal["connecting", "open", "failed", "closed"]


def short(values: Sequence[float] | None) -> str:
    return "-" if values is None else "[" + ",".join(f"{value:g}" for value in values) + "]"


class NotedMove:
    """Movement that ends after a number of cycles."""

    def __init__(self, world: NotedWorld, cycles: int) -> None:
        self._world = world
        self._end = world.cycle + cycles

    @property
    def is_over(self) -> bool:
        return self._world.cycle >= self._end


class NotedMotion:
    """Motions of an arm that reaches its goal immediately, while the movement lasts some cycles."""

    def __init__(self, world: NotedWorld) -> None:
        self._world = world
        self.is_standing = True

    @property
    def waypoint(self) -> Sequence[float] | None:
        return None

    def _begin(self, cycles: int, text: str) -> NotedMove:
        self._world.note(text)
        return NotedMove(self._world, cycles)

    def movej(self, q: Sequence[float], a: float, v: float, t: float, r: float) -> NotedMove:
        self._world.q_target = list(q)
        return self._begin(3, f"movej {short(q)} a={a:g} v={v:g} t={t:g} r={r:g}")

    def movel(self, pose: Sequence[float], a: float, v: float, t: float, r: float) -> NotedMove:
        if pose[2] > 2.0:
            raise OutOfReach("out of reach")
        return self._begin(4, f"movel {short(pose)} a={a:g} v={v:g} t={t:g} r={r:g}")

    def optimovel(self, pose: Sequence[float], a: float, v: float, r: float) -> NotedMove:
        return self._begin(4, f"optimovel {short(pose)} a={a:g} v={v:g} r={r:g}")

    def movep(self, pose: Sequence[float], a: float, v: float, r: float) -> NotedMove:
        return self._begin(4, f"movep {short(pose)} a={a:g} v={v:g} r={r:g}")

    def movec(self, via: Sequence[float], to: Sequence[float], a: float, v: float, r: float, mode: int) -> NotedMove:
        return self._begin(5, f"movec {short(via)} {short(to)} a={a:g} v={v:g} r={r:g} mode={mode}")

    def servoj(self, q: Sequence[float], t: float, lookahead_time: float, gain: float) -> NotedMove:
        self._world.q_target = list(q)
        return self._begin(1, f"servoj {short(q)} t={t:g} lookahead_time={lookahead_time:g} gain={gain:g}")

    def servoc(self, pose: Sequence[float], a: float, v: float, r: float) -> NotedMove:
        return self._begin(2, f"servoc {short(pose)} a={a:g} v={v:g} r={r:g}")

    def speedj(self, qd: Sequence[float], a: float, t: float | None) -> NotedMove:
        return self._begin(2, f"speedj {short(qd)} a={a:g} t={t}")

    def speedl(self, xd: Sequence[float], a: float, t: float | None, a_rot: float) -> NotedMove:
        return self._begin(2, f"speedl {short(xd)} a={a:g} t={t} aRot={a_rot:g}")

    def stopj(self, a: float) -> NotedMove:
        return self._begin(2, f"stopj a={a:g}")

    def stopl(self, a: float, a_rot: float) -> NotedMove:
        return self._begin(2, f"stopl a={a:g} aRot={a_rot:g}")

    def direct_torque(
        self, dynamics: Dynamics, motors: Motors, torque: FloatArray, friction: Sequence[float]
    ) -> NotedMove:
        return self._begin(1, f"direct torque {short(torque.tolist())} friction={short(friction)}")

    def release(self) -> None:
        self._world.note("release")


class NotedSockets:
    """Sockets of a program, with peers that send the data of the test."""

    def __init__(self, world: NotedWorld) -> None:
        self._world = world
        self._states: dict[str, State] = {}
        self._buffers: dict[str, bytearray] = {}
        #: Data that a peer sends, by port. No peer listens at the other ports.
        self.peers: dict[int, list[bytes]] = {}
        self._coming: dict[str, deque[bytes]] = {}

    def open(self, name: str, host: str, port: int) -> None:
        self._world.note(f"open {name} {host}:{port}")
        self._states[name] = "connecting"
        self._buffers[name] = bytearray()
        self._coming[name] = deque(self.peers.get(port, ()))
        if port not in self.peers:
            self._states[name] = "failed" if port else "connecting"

    def step(self) -> None:
        """Advance by one cycle: connecting sockets become connected, and each peer sends one piece."""
        for name, state in self._states.items():
            if state == "connecting" and self._coming[name]:
                self._states[name] = "open"
            if self._states[name] == "open" and self._coming[name]:
                piece = self._coming[name].popleft()
                if piece == b"EOF":
                    self._states[name] = "closed"
                else:
                    self._buffers[name] += piece

    def state(self, name: str) -> State:
        return self._states.get(name, "closed")

    def send(self, name: str, data: bytes) -> bool:
        if self.state(name) != "open":
            return False
        self._world.note(f"send {name} {data!r}")
        return True

    def received(self, name: str) -> bytearray:
        return self._buffers.setdefault(name, bytearray())

    def close(self, name: str) -> None:
        if self._states.pop(name, None) is not None:
            self._world.note(f"close {name}")

    def close_all(self) -> None:
        for name in list(self._states):
            self.close(name)


class NotedSensors(NamedTuple):
    """Sensors of one cycle."""

    q_actual: tuple[float, ...]


class NotedWorld:
    """Controller of a firmware, with an arm that moves immediately.

    Attributes:
        notes: Requests of the program, as "<cycle> <request>".
    """

    def __init__(self, firmware: str = "5.11") -> None:
        self.firmware = Firmware.parse(firmware)
        self.kinematics = Arm("UR5e")
        self.period = 1.0 / self.firmware.rate if hasattr(self.firmware, "rate") else 0.002
        self.cycle = 0
        self.notes: list[str] = []
        self.q_target: list[float] = list(HOME)
        self.qd_target: Sequence[float] = [0.0] * 6
        self.qd_actual: Sequence[float] = [0.0] * 6
        self.qdd_target: Sequence[float] = [0.0] * 6
        self.speed_actual: Sequence[float] = [0.0] * 6
        self.speed_target: Sequence[float] = [0.0, 0.0, -0.1, 0.0, 0.0, 0.0]
        self.force: Sequence[float] = [1.0, 2.0, 2.0, 0.0, 0.0, 0.0]
        self.torques: Sequence[float] = [0.0, 10.0, 5.0, 1.0, 0.0, 0.0]
        self.tcp: Sequence[float] = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
        self.payload = 1.5
        self.payload_cog: Sequence[float] = [0.0, 0.0, 0.05]
        self.payload_inertia: Sequence[float] = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0]
        self.dynamics, self.motors = Dynamics("UR5e", rotors=True), motors_of("UR5e")
        self.flags = [False] * 32
        self.registers = RegisterBanks()
        self.modbus = ModbusSignals(lambda: self.cycle * self.period)
        self.has_popup = False
        self.signals = Signals()
        self.motion = NotedMotion(self)
        self.sockets = NotedSockets(self)

    def note(self, text: str) -> None:
        self.notes.append(f"{self.cycle} {text}")

    @property
    def q_actual(self) -> Sequence[float]:
        return self.q_target

    @property
    def sensors(self) -> NotedSensors:
        return NotedSensors(tuple(self.q_target))

    @property
    def pose_target(self) -> Sequence[float]:
        found: list[float] = self.kinematics.forward(self.q_target, self.tcp).tolist()
        return found

    pose_actual = pose_target

    def set_tcp(self, pose: Sequence[float]) -> None:
        self.tcp = pose
        self.note(f"tcp {short(pose)}")

    def set_payload(
        self, mass: float, cog: Sequence[float] | None, inertia: Sequence[float] | None, seconds: float = 0.0
    ) -> None:
        self.payload = mass
        self.payload_cog = cog or self.payload_cog
        self.note(f"payload {mass:g} {short(cog)} {short(inertia)}")

    def set_gravity(self, vector: Sequence[float]) -> None:
        self.note(f"gravity {short(vector)}")

    def set_watchdog(self, variable: str, frequency: float, action: Action) -> None:
        self.note(f"watchdog {variable} {frequency:g} {action}")

    def use_external_force(self, is_used: bool) -> None:
        self.note(f"external force {is_used}")

    @property
    def external_torques(self) -> Sequence[float]:
        return [0.0] * 6

    def zero_force(self) -> None:
        self.note("zero force")

    def contact_steps(self, direction: Sequence[float]) -> int:
        self.note(f"contact {short(direction)}")
        return 0

    def force_mode(self, task: ForceTask) -> None:
        self.note(f"force mode {short(task.frame)} {short(task.selection)} {short(task.wrench)} {task.kind}")

    def set_force_damping(self, damping: float) -> None:
        self.note(f"force damping {damping:g}")

    def set_force_gain(self, gain: float) -> None:
        self.note(f"force gain {gain:g}")

    def freedrive(self, axes: Sequence[bool], frame: Sequence[float]) -> None:
        self.note(f"freedrive {short(axes)} {short(frame)}")

    def end_compliance(self) -> None:
        self.note("end compliance")

    def text_message(self, text: str) -> None:
        self.note(f"textmsg {text}")

    def rtde_value(self, name: str) -> Any:
        if name not in ("target_q", "runtime_state"):
            raise BadValue(f"there is no RTDE output '{name}'")
        return self.q_target if name == "target_q" else 2

    def protective_stop(self) -> None:
        self.note("protective stop")

    def popup(self, text: str, title: str, is_warning: bool, is_error: bool, is_blocking: bool) -> None:
        self.has_popup = is_blocking
        self.note(f"popup {title}: {text} warning={is_warning} error={is_error} blocking={is_blocking}")


def run(text: str, world: NotedWorld | None = None, cycles: int = 200) -> NotedWorld:
    """Run a program to its end, or for at most `cycles`; the last note describes its end.

    Raises:
        ProgramError: If the program does not compile.
    """
    world = world or NotedWorld()
    execution = Execution(compile_script(text, world.firmware), world)
    for _ in range(cycles):
        outputs = world.signals.digital_outputs
        execution.advance()
        if world.signals.digital_outputs != outputs:
            world.note(f"digital outputs {world.signals.digital_outputs:#x}")
        if execution.is_over:
            break
        world.cycle += 1
        world.sockets.step()
    else:
        execution.stop()
        world.note("stopped")
        return world
    world.note(f"error {execution.error}" if execution.error else "over")
    return world
