"""Objects and forces that act on a simulated arm, and the force sensor.

If the TCP is below a plane, the plane pushes the TCP back along its normal. The force is `stiffness` times the depth,
plus `damping` times the speed into the plane. A plane never pulls. Friction acts along the plane, against the direction
of sliding, with `friction` times the normal force. There is no static friction: below 1 mm/s, the friction decreases
with the speed. A spring pulls the TCP towards a point.

Planes and springs act only on the TCP: the tool has no size, and other parts of the arm touch nothing. These forces are
a model, which was not compared with measurements. Moving bodies are simulated by a `Scene`, which acts on the tool and
on the links.

The force sensor measures the forces of the surroundings, and the weight of a load that the controller does not know.
`zero` makes the current value the new zero. The offset is constant in the tool frame, as for a sensor in the tool. This
is assumed also for arms that have no such sensor and compute the force from their motor currents.

Forces are in N along the axes of the base frame, and moments are in Nm about the TCP. It is assumed that the sensor
measures the forces that act on the tool, not the forces that the tool exerts.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from linkcore.errors import BadValue
from linkcore.names import StrictAttributes
from urlink.arm.dynamics import GRAVITY
from urlink.arm.kinematics import Arm
from urlink.arm.parameters import number
from urlink.arm.poses import rotvec_to_matrix
from urlink.arm.rigid import floats
from urlink.arm.vectors import FloatArray

from .scene import Reaction, Scene
from .setpoint_sources import Setpoint

#: Sliding speed, in m/s, at which the friction is three quarters of its maximum.
_SLIDING = 1e-3
#: Force at the TCP, in N, above which the controller stops the arm. Real controllers have a setting for this limit; the
#: default is assumed.
FORCE_LIMIT = number("force_limit")
# Limit of the joint torque that contacts with the links cause, as a fraction of the maximum torque of the joint.
_TORQUE_SHARE = number("link_contact_limit")
# Limit of the joint torque that an unknown weight causes, as a fraction of the maximum torque of the joint.
_WEIGHT_SHARE = number("unknown_weight_limit")


class ContactModel(Protocol):
    """Object that exerts a force on the TCP."""

    def force(self, position: Sequence[float], velocity: Sequence[float]) -> tuple[float, float, float]:
        """Return the force on the TCP in the base frame, in N.

        Args:
            position: Position of the TCP, in m.
            velocity: Velocity of the TCP, in m/s.
        """


@dataclass(frozen=True)
class Plane:
    """Plane that the TCP can press on.

    Args:
        point: Any point of the plane in the base frame, shape (3,), in m.
        normal: Normal vector, which points to the free side, shape (3,), of any length.
        stiffness: Stiffness, in N/m.
        damping: Damping force per speed into the plane, in N per m/s.
        friction: Friction coefficient.

    Raises:
        BadValue: If a vector is not three finite numbers, if the normal is zero, or if another number is negative.
    """

    point: Sequence[float]
    normal: Sequence[float] = (0.0, 0.0, 1.0)
    stiffness: float = 20_000.0
    damping: float = 100.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        normal = _numbers(self.normal, 3, "a normal")
        length = math.hypot(*normal)
        if length == 0.0:
            raise BadValue("normal is zero; expected the direction towards the free side")
        object.__setattr__(self, "point", _numbers(self.point, 3, "a point"))
        object.__setattr__(self, "normal", tuple(each / length for each in normal))
        _check_figures(stiffness=self.stiffness, damping=self.damping, friction=self.friction)

    def force(self, position: Sequence[float], velocity: Sequence[float]) -> tuple[float, float, float]:
        """Return the force on the TCP in the base frame, in N; see `ContactModel.force`."""
        nx, ny, nz = self.normal
        px, py, pz = self.point
        depth = (px - position[0]) * nx + (py - position[1]) * ny + (pz - position[2]) * nz
        if depth <= 0.0:
            return 0.0, 0.0, 0.0
        vx, vy, vz = velocity
        away = vx * nx + vy * ny + vz * nz
        pressed = max(self.stiffness * depth - self.damping * away, 0.0)
        vx, vy, vz = vx - away * nx, vy - away * ny, vz - away * nz
        sliding = math.hypot(vx, vy, vz)
        rub = self.friction * pressed * math.tanh(sliding / _SLIDING) / sliding if sliding > 0.0 else 0.0
        return pressed * nx - rub * vx, pressed * ny - rub * vy, pressed * nz - rub * vz


@dataclass(frozen=True)
class Spring:
    """Spring that always pulls the TCP towards a point.

    The rest length of the spring is zero.

    Args:
        point: Point in the base frame, shape (3,), in m.
        stiffness: Stiffness, in N/m.
        damping: Damping force per speed of the TCP, in N per m/s.

    Raises:
        BadValue: If `point` is not three finite numbers, or a number is negative.
    """

    point: Sequence[float]
    stiffness: float = 500.0
    damping: float = 10.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _numbers(self.point, 3, "a point"))
        _check_figures(stiffness=self.stiffness, damping=self.damping)

    def force(self, position: Sequence[float], velocity: Sequence[float]) -> tuple[float, float, float]:
        """Return the force on the TCP in the base frame, in N; see `ContactModel.force`."""
        k, c = self.stiffness, self.damping
        x, y, z = (k * (there - here) - c * v for there, here, v in zip(self.point, position, velocity, strict=True))
        return x, y, z


class Surroundings(StrictAttributes):
    """Objects and forces that act on the arm of one controller. A reboot does not change them.

    Any thread may call the methods. Changes take effect in the next cycle.

    Attributes:
        force_limit: Force at the TCP, in N, above which the controller stops the arm protectively.
        scene: Scene with bodies around the arm; None if there is no scene.
    """

    def __init__(self) -> None:
        self.force_limit = FORCE_LIMIT
        self.scene: Scene | None = None
        # Each tuple is replaced as a whole, so that the thread that owns the controller reads either the old or the new
        # tuple.
        self._contacts: tuple[ContactModel, ...] = ()
        self._changing = threading.RLock()  # held while contacts are added or removed
        self._wrench: tuple[float, ...] = (0.0,) * 6
        self._torques: tuple[float, ...] = (0.0,) * 6
        self._load: tuple[float, tuple[float, ...]] | None = None

    # -- for tests -------------------------------------------------------------------------------------

    def add(self, contact: ContactModel) -> ContactModel:
        """Add a plane, a spring, or your own object with a method `force`, and return this object.

        Raises:
            BadValue: If the object has no such method.
        """
        if not callable(getattr(contact, "force", None)):
            raise BadValue(f"contact is {contact!r}; expected an object with a method force(position, velocity)")
        with self._changing:
            self._contacts = (*self._contacts, contact)
        return contact

    def remove(self, contact: ContactModel) -> None:
        """Remove an object.

        Raises:
            BadValue: If the object was not added.
        """
        with self._changing:
            left = tuple(each for each in self._contacts if each is not contact)
            if len(left) == len(self._contacts):
                raise BadValue(f"contact {contact!r} is not in the surroundings; expected one of `contacts`")
            self._contacts = left

    def clear(self) -> None:
        """Remove all objects and forces: the scene, planes and springs, pushes, and the load."""
        self.scene = None
        with self._changing:
            self._contacts = ()
        self._wrench = self._torques = (0.0,) * 6
        self._load = None

    @property
    def contacts(self) -> tuple[ContactModel, ...]:
        """Planes, springs and your own objects, in the order in which they were added."""
        return self._contacts

    def push(self, wrench: Sequence[float]) -> None:
        """Push the TCP with a constant wrench, as a hand does, until the next call; six zeros end the push.

        Args:
            wrench: Wrench, shape (6,): forces in N along the axes of the base frame, and torques in Nm about the TCP.

        Raises:
            BadValue: If `wrench` is not six finite numbers.
        """
        self._wrench = _numbers(wrench, 6, "a wrench")

    def push_joints(self, torques: Sequence[float]) -> None:
        """Push the joints with constant torques until the next call; six zeros end the push.

        Only an arm in freedrive or under direct torque yields to this push. The force at the TCP does not include these
        torques.

        Args:
            torques: Joint torques, shape (6,), in Nm.

        Raises:
            BadValue: If `torques` is not six finite numbers.
        """
        self._torques = _numbers(torques, 6, "torques")

    def carry(self, mass: float | None, cog: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Set the real load at the flange.

        If the load differs from the payload that the controller knows, the force sensor also shows the difference of
        the weights.

        Args:
            mass: Mass in kg. None (the initial value) means that the load equals the payload that the controller knows.
            cog: Centre of mass in the frame of the flange, shape (3,), in m.

        Raises:
            BadValue: If the mass is negative, or the centre is not three finite numbers.
        """
        if mass is None:
            self._load = None
            return
        _check_figures(mass=mass)
        self._load = float(mass), _numbers(cog, 3, "a centre of mass")

    # -- for the arm -----------------------------------------------------------------------------------

    @property
    def is_empty(self) -> bool:
        """Whether no object or force acts on the arm."""
        return not (self.scene or self._contacts or any(self._wrench) or any(self._torques) or self._load)

    @property
    def load(self) -> tuple[float, tuple[float, ...]] | None:
        """Mass in kg and centre of mass in m of the real load; None if it equals the known payload."""
        return self._load

    @property
    def joint_torques(self) -> tuple[float, ...]:
        """Joint torques that `push_joints` has set, shape (6,), in Nm."""
        return self._torques

    def wrench(self, position: Sequence[float], velocity: Sequence[float]) -> list[float]:
        """Return the wrench that pushes, planes and springs exert on the TCP, shape (6,), in N and Nm.

        Args:
            position: Position of the TCP, in m.
            velocity: Velocity of the TCP, in m/s.
        """
        total = list(self._wrench)
        for contact in self._contacts:
            for axis, part in enumerate(contact.force(position, velocity)):
                total[axis] += part
        return total

    def __repr__(self) -> str:
        return f"<Surroundings {list(self._contacts)}>"


def _numbers(values: Sequence[float], n: int, what: str) -> tuple[float, ...]:
    return tuple(map(float, floats(values, n, what)))


def _check_figures(**figures: float) -> None:
    for name, value in figures.items():
        if not 0.0 <= value < math.inf:
            raise BadValue(f"{name}={value!r}; expected a finite number, 0 or more")


# Force, in N, above which a contact is detected; force, in N, at which this contact has begun. The values of real
# controllers are not published.
_NOTICED, _BEGUN = 5.0, 1.0
# Number of latest cycles whose forces are stored.
_REMEMBERED = 500
_NONE = [0.0] * 6


class Overload(NamedTuple):
    """Reason for a protective stop that the sensors of the arm have detected.

    Attributes:
        reason: Reason, as a text.
        code: Number and argument of the code that the controller reports. The choice of the code is assumed.
    """

    reason: str
    code: tuple[int, int]


#: Codes of the vendor's list: a collision that a joint has detected; a load that the arm cannot hold.
_COLLISION, _CANNOT_HOLD = 157, (155, 0)


class ForceSensor:
    """Force sensor of one arm.

    Args:
        kinematics: Kinematics of the arm.
        surroundings: Surroundings that act on the arm.

    Attributes:
        external: Wrench on the TCP in this cycle, including the weight that the controller does not know, shape (6,).
        wrench: The same wrench minus the offset that `zero` has stored, shape (6,).
        torques: Joint torques from contacts with the links, shape (6,), in Nm.
        weight: Force of the unknown weight on the tool in this cycle, in N.
        overload: Reason for a protective stop; None if there is no overload. There is an overload if the force at the
            TCP, or the torque of a joint, exceeds its limit and has grown since the previous cycle. There is also an
            overload if a joint must hold too much of a weight that the controller does not know.
    """

    def __init__(self, kinematics: Arm, surroundings: Surroundings) -> None:
        self._kinematics = kinematics
        self._surroundings = surroundings
        self._offset: FloatArray | None = None  # in the frame of the TCP
        self._turn: list[float] = [0.0] * 3  # rotation vector of the TCP in the base frame
        self._felt: deque[Sequence[float]] = deque(maxlen=_REMEMBERED)
        self.external: Sequence[float] = _NONE
        self.wrench: Sequence[float] = _NONE
        self.torques: Sequence[float] = _NONE
        self.overload: Overload | None = None
        self.weight = 0.0
        self._lifted = 0.0
        self._max_torque = kinematics.model.max_torque
        self._torque_limits = (_TORQUE_SHARE * self._max_torque).tolist()

    @property
    def is_unchanging(self) -> bool:
        """Whether the sensor shows nothing, and will show nothing while nothing acts on the arm."""
        return self._offset is None and self.external is _NONE and self._surroundings.is_empty

    def advance(
        self, setpoint: Setpoint, tcp: Sequence[float], payload: float, cog: Sequence[float], seconds: float
    ) -> None:
        """Advance by one cycle.

        Args:
            setpoint: Targets of the cycle.
            tcp: Tool centre point in the flange frame, in m and rad.
            payload: Mass of the load that the controller knows, in kg.
            cog: Centre of mass of this load in the flange frame, in m.
            seconds: Duration of the cycle, in s.
        """
        self.overload = None
        if self._surroundings.is_empty and self._offset is None:
            self.external = self.wrench = self.torques = _NONE
            self._felt.clear()
            self.weight = self._lifted = 0.0
            return
        before, turned, held = math.hypot(*self.wrench[:3]), self.torques, self._lifted
        weight = self._feel(setpoint, tcp, payload, cog, seconds)
        across = self._kinematics.jacobian(setpoint.q, tcp).T
        force, limit = self.wrench[:3], self._surroundings.force_limit
        self._felt.append(force)
        if math.hypot(*force) > max(limit, before + 1e-6):
            joint = int(np.argmax(np.abs(across @ np.asarray(self.wrench)) / self._max_torque))
            self.overload = Overload(f"a force of more than {limit:g} N at the TCP", (_COLLISION, joint))
        for i, (torque, last, most) in enumerate(zip(self.torques, turned, self._torque_limits, strict=True)):
            if abs(torque) > max(most, abs(last) + 1e-6):
                self.overload = Overload(
                    f"a contact of the arm that turns joint {i + 1} by more than {most:g} Nm", (_COLLISION, i)
                )
        self._lifted = 0.0 if not weight.any() else float(np.max(np.abs(across @ weight) / self._max_torque))
        if self._lifted > max(_WEIGHT_SHARE, held + 1e-6):
            self.overload = Overload("the arm cannot hold a load that differs from the payload", _CANNOT_HOLD)

    def _feel(
        self, setpoint: Setpoint, tcp: Sequence[float], payload: float, cog: Sequence[float], seconds: float
    ) -> FloatArray:
        """Measure the wrench of this cycle, and return the part that an unknown weight causes."""
        pose: list[float] = self._kinematics.forward(setpoint.q, tcp).tolist()
        velocity = _NONE
        if self._surroundings.contacts and any(setpoint.qd):
            velocity = self._kinematics.velocity(setpoint.q, setpoint.qd, tcp).tolist()
        external = np.array(self._surroundings.wrench(pose[:3], velocity[:3]))
        scene = self._surroundings.scene
        reaction = Reaction(_NONE) if scene is None else scene.advance(setpoint, pose, seconds)
        external += reaction.wrench
        self.torques = reaction.torques
        self._turn = pose[3:]
        weight: FloatArray = np.zeros(6)
        load = self._surroundings.load
        if load is not None and load != (payload, tuple(cog)):
            # Transform the centres of mass from the flange frame to the TCP frame.
            turn, way = rotvec_to_matrix(tcp[3:]), np.array(tcp[:3])
            weight = self._weight(load[0], turn.T @ (np.array(load[1]) - way))
            weight -= self._weight(payload, turn.T @ (np.array(cog) - way))
            external += weight
        self.weight = float(np.linalg.norm(weight[:3]))
        self.external = external.tolist()
        if self._offset is None:
            self.wrench = self.external
        else:
            rotation = rotvec_to_matrix(self._turn)
            self.wrench = (
                external - np.concatenate((rotation @ self._offset[:3], rotation @ self._offset[3:]))
            ).tolist()
        return weight

    def _weight(self, mass: float, place: FloatArray) -> FloatArray:
        """Return the force and the moment about the TCP that a weight causes; `place` is in the TCP frame."""
        force = np.array((0.0, 0.0, -GRAVITY * mass))
        return np.concatenate((force, np.cross(rotvec_to_matrix(self._turn) @ place, force)))

    def zero(self) -> None:
        """Make the current value the new zero. If nothing acts on the tool, the offset is zero."""
        self._offset = None
        self.wrench = _NONE
        if any(self.external):
            back, external = rotvec_to_matrix(self._turn).T, np.array(self.external)
            self._offset = np.concatenate((back @ external[:3], back @ external[3:]))

    def contact_steps(self, direction: Sequence[float]) -> int:
        """Return the number of cycles since the start of a contact that opposes a motion of the tool.

        Return 0 if there is no such contact.

        Args:
            direction: Direction of the motion in the base frame, shape (3,), of any length. Three zeros select contacts
                from every direction.
        """
        length = math.hypot(*direction)

        def opposed(force: Sequence[float]) -> float:
            if length == 0.0:
                return math.hypot(*force)
            return -sum(f * d for f, d in zip(force, direction, strict=True)) / length

        if not self._felt or opposed(self._felt[-1]) < _NOTICED:
            return 0
        steps = 0
        for force in reversed(self._felt):
            if opposed(force) < _BEGUN:
                break
            steps += 1
        return steps
