"""Control functions of MRC: parameters (`setpar`) and routed inputs (`routeinput`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter

from .motion.control import MotionControl

#: (module, function, name) of a parameter -> attribute of `MotionParameters`.
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

#: (module, function, name) of an input -> whether it is read before the script, and the attribute of `ControlFunctions`
#: that it sets.
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
#: Module -> its control functions.
CONTROL_FUNCTIONS: Mapping[str, frozenset[str]] = {
    "motioncontrol": frozenset(("followwall", "drivetopoint", "drive", "movetoxyz")),
    "mrc": frozenset(("odoconnect", "motionconnect", "mrccontrol")),
}


class ControlFunctions:
    """Control functions of a robot.

    Args:
        control: Motion control of the robot.

    Attributes:
        control: The argument.
        heading: Heading of the counter or gyro, before offset and gain.
        steering_angle: Steering angle, which is only stored, as in MRC.
        stop: Stop input; a value other than 0 ends the mission.
    """

    def __init__(self, control: MotionControl) -> None:
        self.control = control
        self.heading = self.steering_angle = self.stop = 0.0
        # Path in `_INPUTS` -> owner and name of the attribute, and the index in the pool.
        self._sensed: dict[str, tuple[object, str, int]] = {}
        self._acted: dict[str, tuple[object, str, int]] = {}

    def set_parameter(self, module: str, function: str, name: str, value: float) -> bool:
        """Set a parameter. Return False if there is no such parameter."""
        attribute = _PARAMETERS.get((module, function, name))
        if attribute is None:
            return False
        setattr(self.control.parameters, attribute, value)
        return True

    def has_input(self, module: str, function: str, name: str) -> bool:
        """Whether there is such an input."""
        return (module, function, name) in _INPUTS

    def route_input(self, module: str, function: str, name: str, place: int) -> bool:
        """Route an input from an index in the pool. Return False if there is no such input."""
        if not self.has_input(module, function, name):
            return False
        is_sensed, path = _INPUTS[module, function, name]
        owner, _, attribute = path.rpartition(".")
        routes = self._sensed if is_sensed else self._acted
        routes[path] = (attrgetter(owner)(self) if owner else self), attribute, place
        return True

    def sense(self, pool: Sequence[float]) -> None:
        """Read the inputs that are needed before the script."""
        for owner, attribute, place in self._sensed.values():
            setattr(owner, attribute, pool[place])

    def act(self, pool: Sequence[float]) -> None:
        """Read the other inputs."""
        for owner, attribute, place in self._acted.values():
            setattr(owner, attribute, pool[place])
