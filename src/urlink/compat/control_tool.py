"""Tool, payload and kinematics of ur_rtde's control interface."""

from __future__ import annotations

from collections.abc import Sequence

from urlink import CartesianInfo
from urlink.kinematics import Unreachable
from urlink.poses import compose
from urlink.urscript import text

from .asking import ask
from .interface import NotOffered, RtdeInterface, succeeds

__all__ = ["STATE_TIMEOUT", "ControlTool"]

#: Seconds to wait for a state.
STATE_TIMEOUT = 5.0


class ControlTool(RtdeInterface):
    """What the arm carries and where it is."""

    def setTcp(self, tcp_offset: Sequence[float]) -> bool:
        """Put the tool centre point at a pose in the frame of the flange."""
        return succeeds(lambda: self._robot.set_tcp(tcp_offset))

    def getTCPOffset(self) -> list[float]:
        """The pose of the tool centre point in the frame of the flange, from 3.2 on."""
        feed = self._robot.primary.of(CartesianInfo)
        info = feed.latest or feed.wait(STATE_TIMEOUT)
        if info.tcp_offset_X is None:
            raise NotOffered("before 3.2 a controller does not tell the offset of its tool")
        turn = (info.tcp_offset_Rx, info.tcp_offset_Ry, info.tcp_offset_Rz)
        return [float(each or 0.0) for each in (info.tcp_offset_X, info.tcp_offset_Y, info.tcp_offset_Z, *turn)]

    def setPayload(self, mass: float, cog: Sequence[float] = ()) -> bool:
        """Tell what the arm carries: kg, and its centre of gravity in m."""
        return succeeds(lambda: self._robot.set_payload(mass, cog or None))

    def setTargetPayload(self, mass: float, cog: Sequence[float] = (), inertia: Sequence[float] = (0.0,) * 6) -> bool:
        """Tell what the arm carries, with its inertia in kg m²; from 5.10 on."""
        return succeeds(lambda: self._robot.set_payload(mass, cog or None, inertia))

    def getForwardKinematics(self, q: Sequence[float] = (), tcp_offset: Sequence[float] = ()) -> list[float]:
        """The pose of the tool at joint positions; at those of now, with the tool of now, where none are given."""
        values = q or self._robot.realtime.wait(STATE_TIMEOUT).q_actual
        pose: list[float] = self._robot.kinematics.forward(values, tcp_offset or self.getTCPOffset()).tolist()
        return pose

    def getInverseKinematics(
        self,
        x: Sequence[float],
        qnear: Sequence[float] = (),
        max_position_error: float = 1e-10,
        max_orientation_error: float = 1e-10,
    ) -> list[float]:
        """The joint positions for a pose of the tool that are nearest to others, or to where the joints are led.

        The errors have no effect: what is found is exact to 1e-12 m and rad.

        Raises:
            Unreachable: there are none.
        """
        near = qnear or self._robot.realtime.wait(STATE_TIMEOUT).q_target
        q: list[float] = self._robot.kinematics.inverse(x, near, self.getTCPOffset()).tolist()
        return q

    def getInverseKinematicsHasSolution(
        self,
        x: Sequence[float],
        qnear: Sequence[float] = (),
        max_position_error: float = 1e-10,
        max_orientation_error: float = 1e-10,
    ) -> bool:
        """Whether joint positions put the tool at a pose."""
        try:
            self.getInverseKinematics(x, qnear)
        except Unreachable:
            return False
        return True

    def getActualToolFlangePose(self) -> list[float]:
        """The pose of the flange."""
        pose: list[float] = self._robot.kinematics.forward(self._robot.realtime.wait(STATE_TIMEOUT).q_actual).tolist()
        return pose

    def poseTrans(self, p_from: Sequence[float], p_from_to: Sequence[float]) -> list[float]:
        """A pose that is given in the frame that another one describes, in the frame of that."""
        pose: list[float] = compose(p_from, p_from_to).tolist()
        return pose

    def isPoseWithinSafetyLimits(self, pose: Sequence[float]) -> bool:
        """Whether the safety configuration lets the tool be there; the controller is asked."""
        return ask(self._robot, f"is_within_safety_limits({text.pose(pose, 'pose')})") == "True"

    def isJointsWithinSafetyLimits(self, q: Sequence[float]) -> bool:
        """Whether the safety configuration lets the joints be there; the controller is asked."""
        return ask(self._robot, f"is_within_safety_limits({text.vector(q, 6, 'q')})") == "True"
