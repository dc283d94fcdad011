"""Compensated wrench: the force and torque on the tool, without the weight of the payload and the offset of the sensor.

The controller reports the wrench on the tool at the TCP, along the axes of the base (`tcp_force`), minus the weight of
the payload that is set. The offset of the sensor turns with the tool, and the rest of the weight always points down.
Each state is compensated with plain floats, because calls into numpy would take longer than the arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from linkcore.arguments import check_number
from linkcore.errors import BadValue
from linkcore.names import StrictAttributes
from linkcore.streaming.stream import Stream

from ..arm import rigid
from ..arm.bounds import check_pose
from ..arm.kinematics import Arm
from ..arm.payload import MeasuredPayload
from ..arm.poses import rotvec_to_matrix
from ..arm.vectors import FloatArray, Numbers
from ..protocol.realtime.packets import RealtimeState
from .moves.path import shown_tcp

# Longest time in s of a software zero.
_LONGEST_ZERO = 60.0


class Wrench(NamedTuple):
    """Wrench on the tool in one state, in N and Nm. It is what the surroundings exert on the tool.

    Attributes:
        force: Compensated force along the axes of the frame: x, y, z, in N.
        torque: Compensated torque about the origin of the frame ("base": about the TCP): x, y, z, in Nm.
        frame: Frame of the wrench: "tcp", "base", or a pose in the base frame; see `Robot.wrench`.
        state: State from which the wrench was computed.
    """

    force: tuple[float, float, float]
    torque: tuple[float, float, float]
    frame: str | tuple[float, ...]
    state: RealtimeState

    @property
    def values(self) -> FloatArray:
        """Compensated force and torque along the axes of the frame, shape (6,), in N and Nm."""
        return np.array((*self.force, *self.torque))

    @property
    def raw(self) -> FloatArray:
        """Wrench as reported (`tcp_force`), shape (6,), in N and Nm: along the axes of the base, about the TCP."""
        return self.state.tcp_force

    def __repr__(self) -> str:
        (x, y, z), (rx, ry, rz) = self.force, self.torque
        name = self.frame if isinstance(self.frame, str) else "frame"
        return f"<Wrench {name}: {x:.2f} {y:.2f} {z:.2f} N, {rx:.3f} {ry:.3f} {rz:.3f} Nm>"


class WrenchStream(StrictAttributes):
    """Compensated wrenches, one for each real-time state; see `Robot.wrench`.

    Args:
        realtime: Stream of states.
        arm: Arm, with its calibration if it is known.
        payload: Measured payload.
        frame: See `Robot.wrench`.

    Attributes:
        payload: Measured payload.
    """

    def __init__(
        self, realtime: Stream[RealtimeState], arm: Arm, payload: MeasuredPayload, frame: Numbers | str = "tcp"
    ) -> None:
        if not isinstance(payload, MeasuredPayload):
            raise BadValue(f"payload is {payload!r}; expected the result of measure_payload")
        offset = [each.value for each in payload.force_offset]
        if any(math.isnan(each) for each in offset):
            raise BadValue("the payload was measured without a force sensor, so the offset of the sensor is unknown")
        self.payload = payload
        self._realtime = realtime
        self._arm = arm
        self._frame: str | tuple[float, ...]
        # Rotation and position of a given frame in the base frame.
        self._given: rigid.Rigid[float] | None = None
        if isinstance(frame, str):
            if frame not in ("tcp", "base"):
                raise BadValue(f"frame is {frame!r}; expected 'tcp', 'base', or a pose in the base frame")
            self._frame = frame
        else:
            pose = check_pose(frame, "frame").tolist()
            self._frame, self._given = tuple(pose), rigid.from_pose(pose)
        self._tcp = shown_tcp(arm, realtime.latest or realtime.wait())
        # Offset about the TCP, along the axes of the TCP.
        turn = rotvec_to_matrix(self._tcp[3:]).T
        force = np.array(offset[:3])
        torque = np.array(offset[3:]) - np.cross(self._tcp[:3], force)
        self._offset: tuple[float, ...] = (*(turn @ force).tolist(), *(turn @ torque).tolist())
        self._down = tuple(-each for each in payload.gravity)
        self._turn = turn
        # Last payload that a state has shown, and the weight that it leaves: mass in kg, first moment about the TCP.
        self._shown: tuple[float, bytes] | None = None
        self._left = self._weight(payload.set_payload)

    @property
    def frame(self) -> str | tuple[float, ...]:
        """Frame of the wrenches."""
        return self._frame

    @property
    def latest(self) -> Wrench | None:
        """Wrench of the newest state; None if there is none. Never blocks. See `Feed.latest`."""
        state = self._realtime.latest
        return None if state is None else self.compensate(state)

    def wait(self, timeout: float = 5.0) -> Wrench:
        """Wait for the next state, and return its wrench.

        Raises:
            LinkTimeout, RemoteError, LocalError, Closed: See `Feed.wait`.
        """
        return self.compensate(self._realtime.wait(timeout))

    def wait_until(self, condition: Callable[[Wrench], object], timeout: float = 5.0) -> Wrench:
        """Wait for a wrench that meets a condition, and return it.

        Raises:
            LinkTimeout, RemoteError, LocalError, Closed: See `Feed.wait_until`.
        """
        return self.compensate(self._realtime.wait_until(lambda state: condition(self.compensate(state)), timeout))

    def __iter__(self) -> Iterator[Wrench]:
        for state in self._realtime:
            yield self.compensate(state)

    def compensate(self, state: RealtimeState) -> Wrench:
        """Return the wrench of a state, for example in a callback of `robot.realtime`."""
        known, cog = state.payload_mass, state.payload_cog
        if known is not None and cog is not None:
            shown = known, cog.tobytes()
            if shown != self._shown:
                x, y, z = cog.tolist()
                self._left, self._shown = self._weight((known, x, y, z)), shown
        r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = rigid.from_pose(state.tool_vector_actual.tolist())
        ux, uy, uz, vx, vy, vz = state.tcp_force.tolist()
        ox, oy, oz, ax, ay, az = self._offset
        mass, sx, sy, sz = self._left
        gx, gy, gz = self._down
        # Gravity, force and torque along the axes of the TCP.
        hx = r00 * gx + r10 * gy + r20 * gz
        hy = r01 * gx + r11 * gy + r21 * gz
        hz = r02 * gx + r12 * gy + r22 * gz
        fx = r00 * ux + r10 * uy + r20 * uz - ox - mass * hx
        fy = r01 * ux + r11 * uy + r21 * uz - oy - mass * hy
        fz = r02 * ux + r12 * uy + r22 * uz - oz - mass * hz
        tx = r00 * vx + r10 * vy + r20 * vz - ax - sy * hz + sz * hy
        ty = r01 * vx + r11 * vy + r21 * vz - ay - sz * hx + sx * hz
        tz = r02 * vx + r12 * vy + r22 * vz - az - sx * hy + sy * hx
        if self._frame == "tcp":
            return Wrench((fx, fy, fz), (tx, ty, tz), "tcp", state)
        ux, uy, uz = (r00 * fx + r01 * fy + r02 * fz, r10 * fx + r11 * fy + r12 * fz, r20 * fx + r21 * fy + r22 * fz)
        vx, vy, vz = (r00 * tx + r01 * ty + r02 * tz, r10 * tx + r11 * ty + r12 * tz, r20 * tx + r21 * ty + r22 * tz)
        if self._given is None:
            return Wrench((ux, uy, uz), (vx, vy, vz), "base", state)
        r00, r01, r02, r10, r11, r12, r20, r21, r22, qx, qy, qz = self._given
        px, py, pz = px - qx, py - qy, pz - qz
        vx, vy, vz = vx + py * uz - pz * uy, vy + pz * ux - px * uz, vz + px * uy - py * ux
        return Wrench(
            (r00 * ux + r10 * uy + r20 * uz, r01 * ux + r11 * uy + r21 * uz, r02 * ux + r12 * uy + r22 * uz),
            (r00 * vx + r10 * vy + r20 * vz, r01 * vx + r11 * vy + r21 * vz, r02 * vx + r12 * vy + r22 * vz),
            self._frame,
            state,
        )

    def zero(self, duration: float = 0.5) -> None:
        """Make the mean wrench of the next states the new zero, in this stream only.

        Nothing may touch the tool meanwhile, and the arm should be at rest. Use it after the offset has drifted, or
        after the sensor of the controller was zeroed. The controller does not notice it.

        Args:
            duration: Time, in s.

        Raises:
            BadValue: If `duration` is not 0.01 to 60 s.
            LinkTimeout, RemoteError, LocalError, Closed: See `Feed.wait_until`.
        """
        seconds = check_number(duration, "duration", 0.01, _LONGEST_ZERO, "s")
        tool = WrenchStream(self._realtime, self._arm, self.payload)
        tool._offset = self._offset
        found: list[Wrench] = []

        def is_complete(wrench: Wrench) -> bool:
            found.append(wrench)
            return wrench.state.time - found[0].state.time >= seconds

        tool.wait_until(is_complete, seconds + 5.0)
        mean = np.mean([each.values for each in found], axis=0)
        self._offset = tuple((np.array(self._offset) + mean).tolist())

    def _weight(self, shown: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        """Return the weight that the controller does not subtract: mass, and first moment about the TCP in its axes."""
        known, *centre = shown
        # An unknown centre belongs to a mass that might be 0, so the tool has no known moment.
        own = np.array([each.value if each.is_known else 0.0 for each in self.payload.cog])
        mass = self.payload.mass.value - known
        moment = self.payload.mass.value * own - known * np.array(centre) - mass * self._tcp[:3]
        x, y, z = (self._turn @ moment).tolist()
        return mass, x, y, z

    def __repr__(self) -> str:
        return f"<WrenchStream {self._frame}: {self.payload}>"
