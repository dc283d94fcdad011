"""The robot of urx 0.11, over this library, with its most used calls.

Poses are lists of six numbers, except in `get_pose` and `set_pose`, which need math3d. The monitors and the reference
frame (`csys`) of urx are not offered.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import urlink
from urlink import BadValue, Feed, Joint, Linear, LinkError, LocalError, Motion
from urlink.arm import poses
from urlink.motion import Waypoint
from urlink.tools import Closing, six, text

__all__ = ["Robot", "RobotException"]


#: Exception by its name in urx; here, the base class of all errors of the library.
RobotException = LinkError

#: Maximum times in s to wait for the end of a motion, and for a state.
_LONGEST, _STATE_TIMEOUT = 300.0, 2.0
#: Number of the first of the two tool outputs in `set_digital_out`.
_TOOL = 8


class Robot(Closing):
    """Robot with the calls of urx. It is a context manager that closes itself.

    Args:
        host: Address of the robot, or any other address that `urlink.connect` accepts.
        use_rt: No effect: the real-time interface is used if it is needed.
        urFirm: No effect: the firmware is detected.
        limits: Limits of the session; see `urlink.SessionLimits`. The other client does not have this argument.

    Raises:
        RemoteError: If the robot cannot be reached.
    """

    def __init__(
        self,
        host: str,
        use_rt: bool = False,
        urFirm: float | None = None,
        *,
        limits: urlink.SessionLimits | None = None,
    ) -> None:
        self._robot = urlink.connect(host, limits=limits)

    def close(self) -> None:
        """Disconnect. A running motion ends as in `urlink.Robot.close`."""
        self._robot.close()

    def __repr__(self) -> str:
        return f"<Robot of urx over {self._robot!r}>"

    # -- positions ---------------------------------------------------------------------------------------

    def getj(self, wait: bool = False) -> list[float]:
        """Return the joint positions in rad; with `wait`, those of the next state."""
        return list(map(float, _newest(self._robot.realtime, wait).q_actual))

    def getl(self, wait: bool = False, _log: bool = True) -> list[float]:
        """Return the pose of the tool in the base frame (m, rotation vector in rad); with `wait`, of the next state."""
        return list(map(float, _newest(self._robot.realtime, wait).tool_vector_actual))

    def get_pose(self, wait: bool = False, _log: bool = True) -> Any:
        """Return the pose of the tool in the base frame, as a `math3d.Transform`; with `wait`, of the next state.

        Raises:
            LocalError: If math3d is not installed.
        """
        return _math3d().Transform(self.getl(wait))

    @property
    def x(self) -> float:
        """Position of the tool along the x axis of the base, in m. Setting it moves the tool, see `z`."""
        return self.getl()[0]

    @x.setter
    def x(self, value: float) -> None:
        self._move_along(0, value)

    @property
    def y(self) -> float:
        """Position of the tool along the y axis of the base, in m. Setting it moves the tool, see `z`."""
        return self.getl()[1]

    @y.setter
    def y(self, value: float) -> None:
        self._move_along(1, value)

    @property
    def z(self) -> float:
        """Position of the tool along the z axis of the base, in m.

        Setting it moves the tool in a line at 0.01 m/s, without turning it, and waits for the end.
        """
        return self.getl()[2]

    @z.setter
    def z(self, value: float) -> None:
        self._move_along(2, value)

    def _move_along(self, axis: int, value: float) -> None:
        pose = self.getl()
        pose[axis] = value
        self.movel(pose)

    def get_joint_temperature(self, wait: bool = False) -> list[float]:
        """Return the temperatures of the joints in °C; with `wait`, of the next state."""
        return list(map(float, _newest(self._robot.realtime, wait).motor_temperatures))

    def get_joint_voltage(self, wait: bool = False) -> list[float]:
        """Return the voltages of the joints in V; with `wait`, of the next state."""
        return list(map(float, _newest(self._robot.realtime, wait).V_actual))

    def get_joint_current(self, wait: bool = False) -> list[float]:
        """Return the currents of the joints in A; with `wait`, of the next state."""
        return list(map(float, _newest(self._robot.realtime, wait).I_actual))

    def get_main_voltage(self, wait: bool = False) -> float:
        """Return the voltage of the safety board in V; with `wait`, of the next state."""
        return float(_newest(self._robot.realtime, wait).V_main)

    def get_robot_voltage(self, wait: bool = False) -> float:
        """Return the supply voltage of the robot in V; with `wait`, of the next state."""
        return float(_newest(self._robot.realtime, wait).V_robot)

    def get_robot_current(self, wait: bool = False) -> float:
        """Return the supply current of the robot in A; with `wait`, of the next state."""
        return float(_newest(self._robot.realtime, wait).I_robot)

    def get_tcp_force(self, wait: bool = True) -> list[float]:
        """Return the force at the tool in N and Nm; with `wait`, of the next state."""
        return list(map(float, _newest(self._robot.realtime, wait).tcp_force))

    def get_force(self, wait: bool = True) -> float:
        """Return the Euclidean norm of the six numbers of `get_tcp_force`, as urx does."""
        return math.hypot(*self.get_tcp_force(wait))

    def is_running(self) -> bool:
        """Return whether the robot is switched on and no stop is active."""
        self._robot.primary.wait(_STATE_TIMEOUT)
        return self._robot.safety.cause is None

    def is_program_running(self) -> bool:
        """Return whether a program is running."""
        return bool(_newest(self._robot.primary.of(urlink.packets.RobotModeData), False).is_program_running)

    # -- motions -----------------------------------------------------------------------------------------

    def movej(
        self,
        joints: Sequence[float],
        acc: float = 0.1,
        vel: float = 0.05,
        wait: bool = True,
        relative: bool = False,
        threshold: float | None = None,
    ) -> list[float] | None:
        """Move the joints to positions in rad, or by these angles with `relative`.

        If it waits, it returns the positions at the end. The threshold has no effect, because the controller reports
        the end of the motion.
        """
        goal = [a + b for a, b in zip(joints, self.getj(), strict=True)] if relative else joints
        return self._moved(lambda: self._robot.motion.move_joints(goal, vel, acc), wait, self.getj)

    def movel(
        self,
        tpose: Sequence[float],
        acc: float = 0.01,
        vel: float = 0.01,
        wait: bool = True,
        relative: bool = False,
        threshold: float | None = None,
    ) -> list[float] | None:
        """Move the tool in a line to a pose, or by each coordinate with `relative`. See `movej`."""
        goal = [a + b for a, b in zip(tpose, self.getl(), strict=True)] if relative else tpose
        return self._moved(lambda: self._robot.motion.move_linear(goal, vel, acc), wait, self.getl)

    def set_pose(
        self,
        trans: Any,
        acc: float = 0.01,
        vel: float = 0.01,
        wait: bool = True,
        command: str = "movel",
        threshold: float | None = None,
    ) -> Any:
        """Move the tool to a `math3d.Transform` in the base frame. If it waits, it returns the transform at the end.

        Args:
            trans: Transform from the base frame to the tool.
            acc: Acceleration, in m/s².
            vel: Speed, in m/s.
            wait: Whether to wait for the end.
            command: Command: "movel" or "movep". "movej" is rejected.
            threshold: No effect.

        Raises:
            BadValue: If `command` is another command.
            LocalError: If math3d is not installed.
        """
        if command not in ("movel", "movep"):
            raise BadValue(f"command is {command!r}; expected 'movel' or 'movep'")
        pose = self.movel(list(map(float, trans.pose_vector)), acc, vel, wait)
        return None if pose is None else _math3d().Transform(pose)

    def movep(
        self,
        tpose: Sequence[float],
        acc: float = 0.01,
        vel: float = 0.01,
        wait: bool = True,
        relative: bool = False,
        threshold: float | None = None,
        radius: float = 0.0,
    ) -> list[float] | None:
        """Move the tool as `movel` does.

        The radius, which urx's own example passes, has no effect: a blend needs a motion after it, and each call is a
        program that ends the previous one.
        """
        return self.movel(tpose, acc, vel, wait, relative)

    def movec(
        self,
        pose_via: Sequence[float],
        pose_to: Sequence[float],
        acc: float = 0.01,
        vel: float = 0.01,
        wait: bool = True,
        threshold: float | None = None,
    ) -> list[float] | None:
        """Move the tool along the circle through one pose to another. See `movej`."""
        return self._moved(lambda: self._robot.motion.move_circular(pose_via, pose_to, vel, acc), wait, self.getl)

    def movels(
        self,
        pose_list: Sequence[Sequence[float]],
        acc: float = 0.01,
        vel: float = 0.01,
        radius: float = 0.01,
        wait: bool = True,
        threshold: float | None = None,
    ) -> list[float] | None:
        """Move the tool in lines through poses, with blends of a radius in m. See `movej`."""
        return self._path([Linear(pose, blend=radius) for pose in pose_list], acc, vel, wait)

    def movejs(
        self,
        joint_positions_list: Sequence[Sequence[float]],
        acc: float = 0.1,
        vel: float = 0.05,
        radius: float = 0.01,
        wait: bool = True,
        threshold: float | None = None,
    ) -> list[float] | None:
        """Move the joints through positions, with blends of a radius in m. See `movej`."""
        waypoints = [Joint(q, blend=radius, speed=vel, acceleration=acc) for q in joint_positions_list]
        return self._path(waypoints, acc, vel, wait)

    def _path(self, waypoints: Sequence[Waypoint], acc: float, vel: float, wait: bool) -> list[float] | None:
        if waypoints:
            waypoints[-1].blend = 0.0  # the motion ends at rest at the last waypoint
        return self._moved(lambda: self._robot.motion.path(waypoints, vel, acc), wait, self.getl)

    def translate(
        self, vect: Sequence[float], acc: float = 0.01, vel: float = 0.01, wait: bool = True
    ) -> list[float] | None:
        """Move the tool by a distance in the base frame, shape (3,), in m, without turning it. See `movej`."""
        return self.movel([*vect, 0.0, 0.0, 0.0], acc, vel, wait, relative=True)

    def translate_tool(
        self,
        vect: Sequence[float],
        acc: float = 0.01,
        vel: float = 0.01,
        wait: bool = True,
        threshold: float | None = None,
    ) -> list[float] | None:
        """Move the tool by a distance along its own axes, shape (3,), in m, without turning it. See `movej`."""
        return self.movel_tool([*vect, 0.0, 0.0, 0.0], acc, vel, wait)

    def movel_tool(
        self,
        pose: Sequence[float],
        acc: float = 0.01,
        vel: float = 0.01,
        wait: bool = True,
        threshold: float | None = None,
    ) -> list[float] | None:
        """Move the tool in a line to a pose in the tool frame. See `movej`."""
        return self.movel(poses.compose(self.getl(), pose).tolist(), acc, vel, wait)

    def up(self, z: float = 0.05, acc: float = 0.01, vel: float = 0.01) -> None:
        """Move the tool up by z, in m."""
        self.translate((0.0, 0.0, z), acc, vel)

    def down(self, z: float = 0.05, acc: float = 0.01, vel: float = 0.01) -> None:
        """Move the tool down by z, in m."""
        self.up(-z, acc, vel)

    def back(self, z: float = 0.05, acc: float = 0.01, vel: float = 0.01) -> None:
        """Move the tool back along its z axis by z, in m."""
        self.translate_tool((0.0, 0.0, -z), acc, vel)

    def speedj(self, velocities: Sequence[float], acc: float, min_time: float) -> None:
        """Move the joints at speeds in rad/s. They brake after `min_time` seconds, unless it is called again before."""
        self._robot.motion.speed_joints(velocities, acc, duration=min_time)

    def speedl(self, velocities: Sequence[float], acc: float, min_time: float) -> None:
        """Move the tool at a speed in the base frame, in m/s and rad/s; see `speedj`."""
        self._robot.motion.speed_linear(velocities, acc, duration=min_time)

    def speedl_tool(self, velocities: Sequence[float], acc: float, min_time: float) -> None:
        """Move the tool at a speed in its current frame, in m/s and rad/s; see `speedj`."""
        axes = poses.rotvec_to_matrix(self.getl()[3:])
        self.speedl((six(velocities, "velocities").reshape(2, 3) @ axes.T).ravel().tolist(), acc, min_time)

    def stopj(self, acc: float = 1.5) -> None:
        """Stop in joint space, at rad/s², and wait until the arm is at rest."""
        self._robot.motion.stop(acc).wait(_LONGEST)

    def stopl(self, acc: float = 0.5) -> None:
        """Stop along the path of the tool, at m/s², and wait until the arm is at rest."""
        self._robot.script.run(f"stopl({text.number(acc, 'acc', 0.0, 100.0)})").wait(_LONGEST)

    def stop(self) -> None:
        """Stop in joint space."""
        self.stopj()

    def _moved(self, begin: Callable[[], Motion], wait: bool, where: Callable[[], list[float]]) -> list[float] | None:
        motion = begin()
        if not wait:
            return None
        motion.wait(_LONGEST)
        return where()

    # -- tool, payload, inputs and outputs ---------------------------------------------------------------

    def set_tcp(self, tcp: Sequence[float]) -> None:
        """Set the TCP: a pose in the flange frame, in m and rad."""
        self._robot.set_tcp(tcp)

    def set_payload(self, weight: float, cog: Sequence[float] | None = None) -> None:
        """Set the payload: mass in kg, centre of gravity in m."""
        self._robot.set_payload(weight, cog)

    def set_gravity(self, vector: Sequence[float]) -> None:
        """Set gravity: a vector that points up in the base frame, shape (3,), in m/s²."""
        self._robot.set_gravity(vector)

    def set_digital_out(self, output: int, val: bool) -> None:
        """Switch an output: 0 to 7 of the control box, 8 and 9 of the tool."""
        if output in (_TOOL, _TOOL + 1):
            self._robot.io.set_tool_digital_out(output - _TOOL, bool(val))
        else:
            self._robot.io.set_digital_out(output, bool(val))

    def get_digital_out(self, val: int, wait: bool = False) -> bool:
        """Return whether an output is on, by its bit in the robot state: 8 to 15 configurable, 16 and 17 tool."""
        return bool(self.get_digital_out_bits(wait) >> val & 1)

    def get_digital_out_bits(self, wait: bool = False) -> int:
        """Return all digital outputs."""
        return int(_newest(self._robot.primary.of(urlink.packets.MasterboardData), wait).digital_output_bits)

    def get_digital_in(self, nb: int, wait: bool = False) -> bool:
        """Return whether an input is on, by its bit in the robot state: 8 to 15 configurable, 16 and 17 tool."""
        return bool(_newest(self._robot.primary.of(urlink.packets.MasterboardData), wait).digital_input_bits >> nb & 1)

    def get_digital_in_bits(self) -> int:
        """Return all digital inputs."""
        return int(_newest(self._robot.primary.of(urlink.packets.MasterboardData), False).digital_input_bits)

    def get_analog_in(self, nb: int, wait: bool = False) -> float:
        """Return analogue input 0 or 1 of the control box, in A or V."""
        return self._robot.io.analog_in(nb).value

    def get_analog_inputs(self) -> tuple[float, float]:
        """Return both analogue inputs of the control box."""
        return self.get_analog_in(0), self.get_analog_in(1)

    def set_analog_out(self, output: int, val: float) -> None:
        """Set analogue output 0 or 1 to a fraction of its range, 0 to 1."""
        self._robot.io.set_analog_out(output, val)

    def set_tool_voltage(self, val: int) -> None:
        """Supply the tool with 0, 12 or 24 V."""
        self._robot.io.set_tool_voltage(val)

    # -- programs ----------------------------------------------------------------------------------------

    def send_program(self, prog: str) -> None:
        """Send a program without waiting for its end."""
        self._robot.script.run(prog, detached=True)

    def send_message(self, msg: str) -> None:
        """Show a text on the pendant."""
        self._robot.popup(msg)


def _math3d() -> Any:
    """Return the package of urx's poses.

    Raises:
        LocalError: If it is not installed.
    """
    try:
        return import_module("math3d")
    except ImportError as error:
        raise LocalError("math3d is not installed; install it with pip install math3d==3.0.3") from error


def _newest(feed: Feed[Any], wait: bool) -> Any:
    """Return the newest packet of a feed; the next packet with `wait`, or if there is none."""
    return (None if wait else feed.latest) or feed.wait(_STATE_TIMEOUT)
