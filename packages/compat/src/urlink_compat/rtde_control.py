"""The control interface of ur_rtde, over `robot.motion`, `robot.script` and `robot.kinematics`.

No control script runs on the robot: each call is a separate motion, and set-points use a servo. Therefore no script has
to be uploaded, and nothing on the robot has to be protected from an installation or another client.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from enum import IntFlag
from pathlib import Path as FilePath
from queue import Empty, SimpleQueue
from typing import Any, NoReturn

from linkcore import clock
from urlink import BadValue, LinkTimeout, SessionLimits
from urlink.arm.poses import compose
from urlink.packets import RobotModeData, TextMessage
from urlink.tools import text

from .control_blocks import ControlBlocks, Feature
from .control_moves import LONGEST, STATE_TIMEOUT, AsyncOperationStatus, Path, PathEntry
from .interface import NotOffered, is_given, succeeds

__all__ = ["AsyncOperationStatus", "Path", "PathEntry", "RTDEControlInterface"]

#: Maximum time in s to wait for the end of a stop.
_CLEAR_TIMEOUT = 5.0
#: Maximum time in s to wait for an answer.
_ANSWER_TIMEOUT = 5.0

_numbers = itertools.count(1)


def _not_offered(name: str, instead: str) -> Callable[..., NoReturn]:
    """Return a method that raises `NotOffered` and names its replacement."""

    def refuse(*arguments: Any, **named: Any) -> NoReturn:
        raise NotOffered(f"{name} is not offered; use {instead}")

    refuse.__doc__ = f"Not offered; use {instead}."
    return refuse


class Flags(IntFlag):
    """Flags of the other client's constructor."""

    FLAG_UPLOAD_SCRIPT = 1
    FLAG_USE_EXT_UR_CAP = 2
    FLAG_VERBOSE = 4
    FLAG_UPPER_RANGE_REGISTERS = 8
    FLAG_NO_WAIT = 16
    FLAG_CUSTOM_SCRIPT = 32
    FLAG_NO_EXT_FT = 64
    FLAG_DISABLE_REMOTE_CONTROL_CHECK = 128
    FLAGS_DEFAULT = FLAG_UPLOAD_SCRIPT


class RTDEControlInterface(ControlBlocks):
    """Interface that commands a robot.

    A method that moves the arm waits for its end, unless `asynchronous`, and returns whether the goal was reached.

    Args:
        hostname: Address of the robot.
        frequency: Frequency of the loop for `initPeriod` and `waitPeriod`, in Hz; -1 for the controller's rate.
        flags: Flags. `FLAG_USE_EXT_UR_CAP` and `FLAG_CUSTOM_SCRIPT` are not offered; the others have no effect.
        ur_cap_port: No effect.
        rt_priority: No effect.
        limits: Limits of the session; see `urlink.SessionLimits`. The other client does not have this argument.

    Raises:
        RemoteError: If the robot cannot be reached.
        NotOffered: If a flag is not offered.
    """

    Flags, Feature = Flags, Feature
    FLAG_UPLOAD_SCRIPT = Flags.FLAG_UPLOAD_SCRIPT
    FLAG_USE_EXT_UR_CAP = Flags.FLAG_USE_EXT_UR_CAP
    FLAG_VERBOSE = Flags.FLAG_VERBOSE
    FLAG_UPPER_RANGE_REGISTERS = Flags.FLAG_UPPER_RANGE_REGISTERS
    FLAG_NO_WAIT = Flags.FLAG_NO_WAIT
    FLAG_CUSTOM_SCRIPT = Flags.FLAG_CUSTOM_SCRIPT
    FLAG_NO_EXT_FT = Flags.FLAG_NO_EXT_FT
    FLAG_DISABLE_REMOTE_CONTROL_CHECK = Flags.FLAG_DISABLE_REMOTE_CONTROL_CHECK
    FLAGS_DEFAULT = Flags.FLAGS_DEFAULT
    FEATURE_BASE, FEATURE_TOOL, FEATURE_CUSTOM = Feature

    def __init__(
        self,
        hostname: str,
        frequency: float = -1.0,
        flags: int = Flags.FLAGS_DEFAULT,
        ur_cap_port: int = 50002,
        rt_priority: int = 0,
        *,
        limits: SessionLimits | None = None,
    ) -> None:
        for each in (Flags.FLAG_USE_EXT_UR_CAP, Flags.FLAG_CUSTOM_SCRIPT):
            if flags & each:
                raise NotOffered(f"{each.name} is not offered, because there is no control script; omit this flag")
        super().__init__(hostname, frequency, limits=limits)

    # -- tool and payload --------------------------------------------------------------------------------

    def setTcp(self, tcp_offset: Sequence[float]) -> bool:
        """Set the TCP: a pose in the flange frame, in m and rad."""
        return succeeds(lambda: self._robot.set_tcp(tcp_offset))

    def setPayload(self, mass: float, cog: Sequence[float] = ()) -> bool:
        """Set the payload: mass in kg, centre of gravity in m."""
        return succeeds(lambda: self._robot.set_payload(mass, cog if is_given(cog) else None))

    def setTargetPayload(self, mass: float, cog: Sequence[float] = (), inertia: Sequence[float] = (0.0,) * 6) -> bool:
        """Set the payload with its inertia, shape (6,), in kg m² (firmware 5.10 or later)."""
        return succeeds(lambda: self._robot.set_payload(mass, cog if is_given(cog) else None, inertia))

    def poseTrans(self, p_from: Sequence[float], p_from_to: Sequence[float]) -> list[float]:
        """Transform the pose `p_from_to` from the frame `p_from` to the reference frame of `p_from`."""
        return list(map(float, compose(p_from, p_from_to)))

    # -- state of the robot ------------------------------------------------------------------------------

    def isSteady(self) -> bool:
        """Return whether the arm is fully at rest, as computed by the controller."""
        return self._ask("is_steady()") == "True"

    def getStepTime(self) -> float:
        """Return the time between two cycles of the controller, in s."""
        return 1.0 / self._robot.firmware.rate

    def getJointTorques(self) -> list[float]:
        """Return the joint torques in Nm that the controller computes, without the torques that move the arm."""
        return [float(each) for each in self._ask("get_joint_torques()").strip("[]").split(",")]

    def isProgramRunning(self) -> bool:
        """Return whether motions are allowed now. There is no control script that could have ended."""
        return self._robot.safety.is_enabled and self._robot.safety.cause is None

    def getRobotStatus(self) -> int:
        """Return the status bits: 0 power on, 1 program running."""
        modes = self._robot.primary.of(RobotModeData)
        mode = modes.latest or modes.wait(STATE_TIMEOUT)
        return int(mode.is_power_on) | int(mode.is_program_running) << 1

    def isPoseWithinSafetyLimits(self, pose: Sequence[float]) -> bool:
        """Return whether the safety configuration allows this pose of the tool, as computed by the controller."""
        return self._ask(f"is_within_safety_limits({text.pose(pose, 'pose')})") == "True"

    def isJointsWithinSafetyLimits(self, q: Sequence[float]) -> bool:
        """Return whether the safety configuration allows these joint positions, as computed by the controller."""
        return self._ask(f"is_within_safety_limits({text.vector(q, 6, 'q')})") == "True"

    def _ask(self, expression: str) -> str:
        """Return the value of an expression, as the text that the controller makes of it.

        A secondary program evaluates it, while another program may move the arm.

        Raises:
            SafetyStop: If a stop blocks programs now.
            NotRunning: If the robot is not running.
            CompileError: If a function does not exist on this controller.
            LinkTimeout: If no answer arrives within 5 s.
        """
        mark = f"urlink answer {next(_numbers)} "
        answers: SimpleQueue[str] = SimpleQueue()

        def on_message(message: TextMessage) -> None:
            if message.text.startswith(mark):
                answers.put(message.text[len(mark) :])

        # Subscribe to the stream rather than to the program, because a text message does not identify its program.
        with self._robot.primary.subscribe(on_message, TextMessage, inline=True):
            self._robot.script.run(f'sec urlink_question():\n  textmsg("{mark}", {expression})\nend')
            try:
                return clock.get(answers, _ANSWER_TIMEOUT)
            except Empty:
                raise LinkTimeout(f"no answer to {expression} arrived within {_ANSWER_TIMEOUT:g} s") from None

    def zeroFtSensor(self) -> bool:
        """Zero the force sensor: the current force at the tool becomes zero."""
        return self._run("zero_ftsensor()")

    def setGravity(self, direction: Sequence[float]) -> bool:
        """Set gravity: a vector that points up in the base frame, shape (3,), in m/s²."""
        return self._run(f"set_gravity({text.vector(direction, 3, 'direction')})")

    def triggerProtectiveStop(self) -> bool:
        """Make the controller enter a protective stop."""
        return succeeds(lambda: self._robot.script.run("protective_stop()"))

    def ftRtdeInputEnable(
        self,
        enable: bool,
        sensor_mass: float = 0.0,
        sensor_measuring_offset: Sequence[float] = (0.0, 0.0, 0.0),
        sensor_cog: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> bool:
        """Make the controller use the tool force from `setExternalForceTorque` (firmware 5.9 or later)."""
        return self._run(f"ft_rtde_input_enable({_sensor(enable, sensor_mass, sensor_measuring_offset, sensor_cog)})")

    def enableExternalFtSensor(
        self,
        enable: bool,
        sensor_mass: float = 0.0,
        sensor_measuring_offset: Sequence[float] = (0.0, 0.0, 0.0),
        sensor_cog: Sequence[float] = (0.0, 0.0, 0.0),
    ) -> bool:
        """Enable an external force sensor as `ftRtdeInputEnable` does, before firmware 5.9."""
        return self._run(
            f"enable_external_ft_sensor({_sensor(enable, sensor_mass, sensor_measuring_offset, sensor_cog)})"
        )

    def setExternalForceTorque(self, external_force_torque: Sequence[float]) -> bool:
        """Send the force at the tool, in N and Nm. It is used after `ftRtdeInputEnable`."""

        def write() -> None:
            with self._robot.rtde.inputs("external_force_torque") as inputs:
                inputs.send(external_force_torque=external_force_torque)

        return succeeds(write)

    def _run(self, statement: str) -> bool:
        """Run a statement as a secondary program, while another program may move the arm."""
        return succeeds(lambda: self._robot.script.run(f"sec urlink_compat():\n  {statement}\nend", wait=True))

    # -- programs ----------------------------------------------------------------------------------------

    def reuploadScript(self) -> bool:
        """Wait until a stop has ended, and enable motions again. There is no script to upload."""

        def clear() -> None:
            self._robot.safety.wait_until_clear(_CLEAR_TIMEOUT)
            self._robot.safety.enable()

        return succeeds(clear)

    def stopScript(self) -> None:
        """End the block or the motion that moves the arm."""

        def stop() -> None:
            self._end_block()
            if self._robot.motion.current is not None:
                self._robot.motion.stop().wait(LONGEST)

        succeeds(stop)

    def sendCustomScript(self, script: str) -> bool:
        """Run a program, and wait for its end."""

        def run() -> None:
            self._end_block()
            self._robot.script.run(script).wait(LONGEST)

        return succeeds(run)

    def sendCustomScriptFunction(self, function_name: str, script: str) -> bool:
        """Run the lines of a function body as a program, and wait for its end."""
        body = "\n".join(f"  {line}" for line in script.splitlines())
        return self.sendCustomScript(f"def {function_name}():\n{body}\nend")

    def sendCustomScriptFile(self, file_path: str) -> bool:
        """Run the program in a file, and wait for its end.

        Raises:
            BadValue: If the file cannot be read.
        """
        try:
            return self.sendCustomScript(FilePath(file_path).read_text(encoding="utf-8"))
        except OSError as error:
            raise BadValue(f"cannot read {file_path}: {error.strerror or error}") from error

    def reconnect(self) -> bool:
        """Wait until data arrives again, and enable motions."""
        return super().reconnect() and self.reuploadScript()

    def disconnect(self) -> None:
        """Stop the arm if set-points move it, and disconnect. The object cannot be used again."""
        succeeds(self._end_block)
        super().disconnect()

    # -- not offered -------------------------------------------------------------------------------------

    servoC = _not_offered("servoC", "robot.motion.move_circular, or robot.motion.path with arcs and blends")
    toolContact = _not_offered("toolContact", "robot.motion.until_contact")
    startContactDetection = _not_offered("startContactDetection", "robot.motion.until_contact")
    readContactDetection = _not_offered("readContactDetection", "robot.motion.until_contact")
    stopContactDetection = _not_offered("stopContactDetection", "robot.motion.until_contact")
    getFreedriveStatus = _not_offered("getFreedriveStatus", "freedriveMode, which ends if it cannot continue")
    setCustomScriptFile = _not_offered("setCustomScriptFile", "robot.script.run")
    getMassMatrix = _not_offered("getMassMatrix", "urlink.arm.dynamics.Dynamics")
    getCoriolisAndCentrifugalTorques = _not_offered("getCoriolisAndCentrifugalTorques", "urlink.arm.dynamics.Dynamics")
    getJacobian = _not_offered("getJacobian", "robot.kinematics.jacobian")
    getJacobianTimeDerivative = _not_offered("getJacobianTimeDerivative", "robot.kinematics.jacobian")
    getTargetJointAccelerations = _not_offered("getTargetJointAccelerations", "getTargetQdd of the receive interface")
    getTargetWaypoint = _not_offered("getTargetWaypoint", "the handle of a motion, which reports its progress")
    getActualJointPositionsHistory = _not_offered("getActualJointPositionsHistory", "robot.realtime.history")


def _sensor(enable: bool, mass: float, offset: Sequence[float], cog: Sequence[float]) -> str:
    """Return the arguments of a force sensor, as URScript."""
    values = [text.vector(each, 3, name) for each, name in ((offset, "sensor_measuring_offset"), (cog, "sensor_cog"))]
    return f"{text.boolean(enable, 'enable')}, {text.number(mass, 'sensor_mass', 0.0, 100.0)}, {', '.join(values)}"
