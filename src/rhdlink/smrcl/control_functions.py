"""The control functions of MRC: their parameters (`setpar`) and their inputs, taken from variables (`routeinput`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter

from .motion.control import MotionControl

#: Parameters, by module, function and name: the attribute of `MotionParameters`.
_PARAMETERS: Mapping[tuple[str, str, str], str] = {
    ("motioncontrol", "followwall", "gain"): "wall_gain",
    ("motioncontrol", "followwall", "alfa"): "wall_alfa",
    ("motioncontrol", "followwall", "tau"): "wall_tau",
    ("motioncontrol", "followwall", "anglegain"): "wall_angle_gain",
    ("motioncontrol", "followwall", "inputmode"): "wall_input_mode",
    ("motioncontrol", "drive", "kangle"): "drive_kangle",
    ("motioncontrol", "drive", "kdist"): "drive_kdist",
    ("motioncontrol", "drivetopoint", "evalmethod"): "evaluation",
}

#: Inputs, likewise: whether they are taken before the script, and the attribute of `ControlFunctions` that they set.
_INPUTS: Mapping[tuple[str, str, str], tuple[bool, str]] = {
    ("mrc", "odoconnect", "dth"): (True, "heading"),
    ("mrc", "odoconnect", "steeringangle"): (True, "steering_angle"),
    ("mrc", "motionconnect", "w2odox"): (True, "control.world.x"),
    ("mrc", "motionconnect", "w2odoy"): (True, "control.world.y"),
    ("mrc", "motionconnect", "w2odoth"): (True, "control.world.th"),
    ("mrc", "motionconnect", "obstaclefront"): (False, "control.obstacle_front"),
    ("mrc", "motionconnect", "obstacleback"): (False, "control.obstacle_back"),
    ("mrc", "mrccontrol", "stop"): (False, "stop"),
    ("motioncontrol", "followwall", "distl"): (False, "control.ir_left"),
    ("motioncontrol", "followwall", "distr"): (False, "control.ir_right"),
    ("motioncontrol", "followwall", "anglel"): (False, "control.wall_angle_left"),
    ("motioncontrol", "followwall", "angler"): (False, "control.wall_angle_right"),
    ("motioncontrol", "drive", "refx"): (False, "control.reference.x"),
    ("motioncontrol", "drive", "refy"): (False, "control.reference.y"),
    ("motioncontrol", "drive", "refth"): (False, "control.reference.th"),
}
#: The control functions of each module.
CONTROL_FUNCTIONS: Mapping[str, frozenset[str]] = {
    "motioncontrol": frozenset(("followwall", "drivetopoint", "drive", "movetoxyz")),
    "mrc": frozenset(("odoconnect", "motionconnect", "mrccontrol")),
}


class ControlFunctions:
    """The control functions of a robot.

    Args:
        control: its motion control.

    Attributes:
        control: as given.
        heading: of the counter or gyro, before offset and gain.
        steering_angle: is stored only, as in MRC.
        stop: not 0 ends the mission.
    """

    def __init__(self, control: MotionControl) -> None:
        self.control = control
        self.heading = self.steering_angle = self.stop = 0.0
        # Owner and name of the attribute, and the place, by what stands in `_INPUTS`.
        self._sensed: dict[str, tuple[object, str, int]] = {}
        self._acted: dict[str, tuple[object, str, int]] = {}

    def set_parameter(self, module: str, function: str, name: str, value: float) -> bool:
        """Set a parameter. False if there is none of that name."""
        attribute = _PARAMETERS.get((module, function, name))
        if attribute is None:
            return False
        setattr(self.control.parameters, attribute, value)
        return True

    def has_input(self, module: str, function: str, name: str) -> bool:
        """Whether there is an input of that name."""
        return (module, function, name) in _INPUTS

    def route_input(self, module: str, function: str, name: str, place: int) -> bool:
        """Have an input come from a place in the pool. False if there is none of that name."""
        if not self.has_input(module, function, name):
            return False
        is_sensed, path = _INPUTS[module, function, name]
        owner, _, attribute = path.rpartition(".")
        routes = self._sensed if is_sensed else self._acted
        routes[path] = (attrgetter(owner)(self) if owner else self), attribute, place
        return True

    def sense(self, pool: Sequence[float]) -> None:
        """Take the inputs that come before the script."""
        for owner, attribute, place in self._sensed.values():
            setattr(owner, attribute, pool[place])

    def act(self, pool: Sequence[float]) -> None:
        """Take the others."""
        for owner, attribute, place in self._acted.values():
            setattr(owner, attribute, pool[place])
