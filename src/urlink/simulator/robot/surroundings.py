"""The surroundings of a simulated arm's tool, which push and pull it, and the sensor that measures their force.

A plane pushes back along its normal where the TCP is below it: `stiffness` times the depth and `damping` times the
speed into it, never pulling. Along the plane it rubs: `friction` times that force, against the direction of sliding. A
spring pulls the TCP towards a point. Both act on the TCP alone: the tool has no size, and no other part of the arm
touches anything. Friction does not stick: below 1 mm/s it fades with the speed. All of this is a model, not a
measurement.

Bodies that move are a `Scene`, which acts on the tool and on the links.

The sensor measures the forces of the surroundings, and the weight of a load that the controller does not know; `zero`
makes the present value the new zero. That the offset turns with the tool, as with a sensor in the tool, is a guess for
arms that have none and compute the force from their currents.

Forces are those that act on the tool, in N and Nm, in the directions of the base frame, moments about the TCP; that the
sensor measures those on the tool, and not those of the tool, is a guess.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

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

#: m/s of sliding at which friction has three quarters of its full size.
_SLIDING = 1e-3
#: N at the TCP above which the controller stops the arm. On controllers it can be set; this default is a guess.
FORCE_LIMIT = number("force_limit")
# The same for the links: part of the largest torque of a joint.
_TORQUE_SHARE = number("link_contact_limit")


class ContactModel(Protocol):
    """Something that acts on the TCP."""

    def force(self, position: Sequence[float], velocity: Sequence[float]) -> tuple[float, float, float]:
        """N in the base frame, of a TCP at a position in m that moves at a velocity in m/s."""


@dataclass(frozen=True)
class Plane:
    """A plane that the TCP can be pressed on.

    Args:
        point: (3,) any point of it in the base frame, m.
        normal: (3,) towards the free side, of any length.
        stiffness: N/m.
        damping: N per m/s into it.
        friction: part of the normal force that opposes sliding.

    Raises:
        BadValue: a vector is not three finite numbers, the normal is zero, or a figure is negative.
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
            raise BadValue("the normal of a plane is not zero")
        object.__setattr__(self, "point", _numbers(self.point, 3, "a point"))
        object.__setattr__(self, "normal", tuple(each / length for each in normal))
        _check_figures(stiffness=self.stiffness, damping=self.damping, friction=self.friction)

    def force(self, position: Sequence[float], velocity: Sequence[float]) -> tuple[float, float, float]:
        """N in the base frame, of a TCP at a position in m that moves at a velocity in m/s."""
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
    """A spring between a point and the TCP; its length at rest is zero, so it always pulls the TCP to the point.

    Args:
        point: (3,) its other end, in the base frame, m.
        stiffness: N/m.
        damping: N per m/s of the TCP.

    Raises:
        BadValue: a point that is not three finite numbers, or a negative figure.
    """

    point: Sequence[float]
    stiffness: float = 500.0
    damping: float = 10.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _numbers(self.point, 3, "a point"))
        _check_figures(stiffness=self.stiffness, damping=self.damping)

    def force(self, position: Sequence[float], velocity: Sequence[float]) -> tuple[float, float, float]:
        """N in the base frame, of a TCP at a position in m that moves at a velocity in m/s."""
        k, c = self.stiffness, self.damping
        x, y, z = (k * (there - here) - c * v for there, here, v in zip(self.point, position, velocity, strict=True))
        return x, y, z


class Surroundings(StrictAttributes):
    """The surroundings of the arm of one controller. A reboot does not change them.

    Each method may be called from any thread; changes have an effect from the next cycle on.

    Attributes:
        force_limit: N at the TCP above which the controller stops the arm protectively.
        scene: bodies around the arm; None for none.
    """

    def __init__(self) -> None:
        self.force_limit = FORCE_LIMIT
        self.scene: Scene | None = None
        # Replaced as a whole, so that the thread that owns the controller sees either the old or the new one.
        self._contacts: tuple[ContactModel, ...] = ()
        self._wrench: tuple[float, ...] = (0.0,) * 6
        self._torques: tuple[float, ...] = (0.0,) * 6
        self._load: tuple[float, tuple[float, ...]] | None = None

    # -- for tests -------------------------------------------------------------------------------------

    def add(self, contact: ContactModel) -> ContactModel:
        """Place a plane, a spring, or your own object with a method `force`; returns it.

        Raises:
            BadValue: it has no such method.
        """
        if not callable(getattr(contact, "force", None)):
            raise BadValue(f"a contact has a method force(position, velocity), as Plane and Spring do; not {contact!r}")
        self._contacts = (*self._contacts, contact)
        return contact

    def remove(self, contact: ContactModel) -> None:
        """Remove a contact.

        Raises:
            BadValue: it is not there.
        """
        left = tuple(each for each in self._contacts if each is not contact)
        if len(left) == len(self._contacts):
            raise BadValue(f"there is no such contact: {contact!r}")
        self._contacts = left

    def clear(self) -> None:
        """Remove everything: scene, contacts, pushes and the load."""
        self.scene = None
        self._contacts = ()
        self._wrench = self._torques = (0.0,) * 6
        self._load = None

    @property
    def contacts(self) -> tuple[ContactModel, ...]:
        """The planes and springs, in the order in which they were placed."""
        return self._contacts

    def push(self, wrench: Sequence[float]) -> None:
        """Push at the TCP from now on, as a hand does; six zeros end it.

        Args:
            wrench: (6,) N in the directions of the base frame, and Nm about the TCP.

        Raises:
            BadValue: not six finite numbers.
        """
        self._wrench = _numbers(wrench, 6, "a wrench")

    def push_joints(self, torques: Sequence[float]) -> None:
        """Push the joints from now on, (6,) Nm; six zeros end it. Only an arm in freedrive or under direct torque
        yields to it; it is not in the force at the TCP.

        Raises:
            BadValue: not six finite numbers.
        """
        self._torques = _numbers(torques, 6, "torques")

    def carry(self, mass: float | None, cog: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Set the real load at the flange. If it differs from the payload that the controller knows, the force at the
        TCP is off by the difference of the weights.

        Args:
            mass: kg; None for the payload that the controller knows, which is the initial value.
            cog: (3,) its centre of mass in the frame of the flange, m.

        Raises:
            BadValue: a negative mass, or a centre that is not three finite numbers.
        """
        if mass is None:
            self._load = None
            return
        _check_figures(mass=mass)
        self._load = float(mass), _numbers(cog, 3, "a centre of mass")

    # -- for the arm -----------------------------------------------------------------------------------

    @property
    def is_empty(self) -> bool:
        """Whether nothing can act on the arm."""
        return not (self.scene or self._contacts or any(self._wrench) or any(self._torques) or self._load)

    @property
    def load(self) -> tuple[float, tuple[float, ...]] | None:
        """Mass, kg, and centre of mass, m, of the real load at the flange; None for the known payload."""
        return self._load

    @property
    def joint_torques(self) -> tuple[float, ...]:
        """(6,) Nm, of `push_joints`."""
        return self._torques

    def wrench(self, position: Sequence[float], velocity: Sequence[float]) -> list[float]:
        """The wrench on a TCP at a position in m that moves at a velocity in m/s: (6,) N and Nm."""
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
            raise BadValue(f"{name} is zero or more, not {value!r}")


# N at which a contact is detected, and below which it has not begun. The sensitivity of controllers is not published.
_NOTICED, _BEGUN = 5.0, 1.0
# Cycles that are kept.
_REMEMBERED = 500
_NONE = [0.0] * 6


class ForceSensor:
    """The sensor of one arm.

    Args:
        kinematics: of the arm.
        surroundings: what acts on it.

    Attributes:
        external: (6,) what acts on the TCP in this cycle, with the weight that the controller does not know.
        wrench: (6,) that, minus the offset.
        torques: (6,) Nm on the joints, by what touches the links.
        overload: what stops the arm protectively: a force at the TCP, or a torque of a joint, that is above its limit
            and larger than a cycle ago; None for none.
    """

    def __init__(self, kinematics: Arm, surroundings: Surroundings) -> None:
        self._kinematics = kinematics
        self._surroundings = surroundings
        self._offset: FloatArray | None = None  # in the frame of the TCP
        self._turn: list[float] = [0.0] * 3  # of the TCP in the base frame: a rotation vector
        self._felt: deque[Sequence[float]] = deque(maxlen=_REMEMBERED)
        self.external: Sequence[float] = _NONE
        self.wrench: Sequence[float] = _NONE
        self.torques: Sequence[float] = _NONE
        self.overload: str | None = None
        self._torque_limits = (_TORQUE_SHARE * kinematics.model.max_torque).tolist()

    def advance(
        self, setpoint: Setpoint, tcp: Sequence[float], payload: float, cog: Sequence[float], seconds: float
    ) -> None:
        """Advance by one cycle, at these targets, with this tool and the load, kg and m, that the controller knows."""
        self.overload = None
        if self._surroundings.is_empty and self._offset is None:
            self.external = self.wrench = self.torques = _NONE
            self._felt.clear()
            return
        before, turned = math.hypot(*self.wrench[:3]), self.torques
        self._feel(setpoint, tcp, payload, cog, seconds)
        force, limit = self.wrench[:3], self._surroundings.force_limit
        self._felt.append(force)
        if math.hypot(*force) > max(limit, before + 1e-6):
            self.overload = f"a force of more than {limit:g} N at the TCP"
        for i, (torque, last, most) in enumerate(zip(self.torques, turned, self._torque_limits, strict=True)):
            if abs(torque) > max(most, abs(last) + 1e-6):
                self.overload = f"a contact of the arm that turns joint {i + 1} by more than {most:g} Nm"

    def _feel(
        self, setpoint: Setpoint, tcp: Sequence[float], payload: float, cog: Sequence[float], seconds: float
    ) -> None:
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
        load = self._surroundings.load
        if load is not None and load != (payload, tuple(cog)):
            # From the frame of the flange to that of the TCP, of which the pose is known.
            turn, way = rotvec_to_matrix(tcp[3:]), np.array(tcp[:3])
            external += self._weight(load[0], turn.T @ (np.array(load[1]) - way))
            external -= self._weight(payload, turn.T @ (np.array(cog) - way))
        self.external = external.tolist()
        if self._offset is None:
            self.wrench = self.external
        else:
            rotation = rotvec_to_matrix(self._turn)
            self.wrench = (
                external - np.concatenate((rotation @ self._offset[:3], rotation @ self._offset[3:]))
            ).tolist()

    def _weight(self, mass: float, place: FloatArray) -> FloatArray:
        """The weight of a mass at a place in the frame of the TCP: force, and moment about the TCP."""
        force = np.array((0.0, 0.0, -GRAVITY * mass))
        return np.concatenate((force, np.cross(rotvec_to_matrix(self._turn) @ place, force)))

    def zero(self) -> None:
        """Make the present value the new zero; if nothing acts on the tool, the offset is zero."""
        self._offset = None
        self.wrench = _NONE
        if any(self.external):
            back, external = rotvec_to_matrix(self._turn).T, np.array(self.external)
            self._offset = np.concatenate((back @ external[:3], back @ external[3:]))

    def contact_steps(self, direction: Sequence[float]) -> int:
        """Cycles since a contact began that opposes a movement of the tool; 0 without one.

        Args:
            direction: (3,) of the movement in the base frame, of any length; zero for contacts of every direction.
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
