"""Compensated wrench: the force and torque on the tool, without the weight of the payload and the offset of the sensor.

The controller reports the wrench on the tool at the TCP, along the axes of the base (`tcp_force`), minus the weight of
the payload that is set. The offset of the sensor turns with the tool, and the rest of the weight always points down.
Each state is compensated with plain floats, because calls into numpy would take longer than the arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Literal

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

#: Names of frames of a wrench.
WrenchFrame = Literal["tcp", "base"]
# Longest time in s of a software zero.
_LONGEST_ZERO = 60.0


class Wrench(StrictAttributes):
    """Wrench on the tool in one state, in N and Nm. It is what the surroundings exert on the tool.

    Attributes:
        state: State from which the wrench was computed.
        frame: Frame of the wrench: "tcp", "base", or a pose in the base frame; see `Robot.wrench`.
    """

    __slots__ = ("_values", "frame", "state")

    def __init__(
        self, state: RealtimeState, frame: str | tuple[float, ...], values: tuple[float, float, float, float, float, float]
    ) -> None:
        self.state = state
        self.frame = frame
        self._values = values

    @property
    def values(self) -> FloatArray:
        """Compensated force and torque along the axes of the frame, shape (6,), in N and Nm."""
        return np.array(self._values)

    @property
    def force(self) -> tuple[float, float, float]:
        """Compensated force along the axes of the frame: x, y, z, in N."""
        return self._values[:3]

    @property
    def torque(self) -> tuple[float, float, float]:
        """Compensated torque about the origin of the frame ("base": about the TCP): x, y, z, in Nm."""
        return self._values[3:]

    @property
    def raw(self) -> FloatArray:
        """Wrench as reported (`tcp_force`), shape (6,), in N and Nm: along the axes of the base, about the TCP."""
        return self.state.tcp_force

    def __repr__(self) -> str:
        x, y, z, rx, ry, rz = self._values
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
        self._shown: tuple[float | None, bytes] | None = None
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
        mass_shown = state.payload_mass
        if mass_shown is not None:
            cog = state.payload_cog
            shown = mass_shown, b"" if cog is None else cog.tobytes()
            if shown != self._shown:
                x, y, z = (0.0, 0.0, 0.0) if cog is None else cog.tolist()
                self._left, self._shown = self._weight((mass_shown, x, y, z)), shown
        pose = state.tool_vector_actual.tolist()
        r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = rigid.from_pose(pose)
        fx, fy, fz, tx, ty, tz = state.tcp_force.tolist()
        ox, oy, oz, ax, ay, az = self._offset
        mass, mx, my, mz = self._left
        gx, gy, gz = self._down
        # First moment of the weight that the controller does not know, along the axes of the base.
        sx = r00 * mx + r01 * my + r02 * mz
        sy = r10 * mx + r11 * my + r12 * mz
        sz = r20 * mx + r21 * my + r22 * mz
        fx -= r00 * ox + r01 * oy + r02 * oz + mass * gx
        fy -= r10 * ox + r11 * oy + r12 * oz + mass * gy
        fz -= r20 * ox + r21 * oy + r22 * oz + mass * gz
        tx -= r00 * ax + r01 * ay + r02 * az + sy * gz - sz * gy
        ty -= r10 * ax + r11 * ay + r12 * az + sz * gx - sx * gz
        tz -= r20 * ax + r21 * ay + r22 * az + sx * gy - sy * gx
        if self._given is not None:
            r00, r01, r02, r10, r11, r12, r20, r21, r22, qx, qy, qz = self._given
            px, py, pz = px - qx, py - qy, pz - qz
            tx += py * fz - pz * fy
            ty += pz * fx - px * fz
            tz += px * fy - py * fx
        elif self._frame == "base":
            return Wrench(state, "base", (fx, fy, fz, tx, ty, tz))
        return Wrench(
            state,
            self._frame,
            (
                r00 * fx + r10 * fy + r20 * fz,
                r01 * fx + r11 * fy + r21 * fz,
                r02 * fx + r12 * fy + r22 * fz,
                r00 * tx + r10 * ty + r20 * tz,
                r01 * tx + r11 * ty + r21 * tz,
                r02 * tx + r12 * ty + r22 * tz,
            ),
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
        found: list[list[float]] = []
        begun: list[float] = []

        def is_complete(state: RealtimeState) -> bool:
            if not begun:
                begun.append(state.time)
            turn = rotvec_to_matrix(state.tool_vector_actual[3:]).T
            left = self._along_base(state)
            found.append([*(turn @ left[:3]).tolist(), *(turn @ left[3:]).tolist()])
            return state.time - begun[0] >= seconds

        self._realtime.wait_until(is_complete, seconds + 5.0)
        mean = np.mean(found, axis=0).tolist()
        self._offset = tuple(a + b for a, b in zip(self._offset, mean, strict=True))

    def _along_base(self, state: RealtimeState) -> FloatArray:
        """Return the compensated wrench along the axes of the base, about the TCP, shape (6,)."""
        wrench = self.compensate(state).values
        if self._frame == "base":
            return wrench
        if self._given is None:
            turn = rotvec_to_matrix(state.tool_vector_actual[3:])
            return np.concatenate((turn @ wrench[:3], turn @ wrench[3:]))
        turn = np.array(self._given[:9]).reshape(3, 3)
        force, torque = turn @ wrench[:3], turn @ wrench[3:]
        lever = state.tool_vector_actual[:3] - np.array(self._given[9:])
        return np.concatenate((force, torque - np.cross(lever, force)))

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
