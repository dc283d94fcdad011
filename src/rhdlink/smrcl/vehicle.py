"""Robot of a mission.

The variables of the robot are converted to a pose and distances, and speeds are converted to variables.

A cycle of MRC's main loop (mrc.c) has two halves, and the script runs between them::

    sense   read variables -> infrared, line -> odometry -> inputs of motion control
    act     motion control -> written variables

This module opens no connection and reads no clock. The variables of a cycle are passed in as a mapping, and the
variables to write are returned as a mapping.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence

from linkcore.errors import BadValue

from ..host.config import BadConfiguration
from .control_functions import ControlFunctions
from .motion.basic import FunctionGenerator, Stop
from .motion.control import DriveKind, MotionControl
from .odometry import Covariance, Odometry
from .planar_pose import PlanarPose
from .profile import Profile
from .robot_conf import RobotConf
from .sensors import InfraredSensors, LineKind, LineSensor
from .symbols import Symbols, split_index
from .system_variables import SYSTEM_NAMES, SystemVariables

#: Assumed distances in m to an obstacle ahead and behind, if no sensor measures them.
_FREE_AHEAD, _FREE_BEHIND = 50.0, 1.0
#: Maximum number of ticks that can have been missed. A larger jump means that the host was restarted.
_MOST_MISSED = 1000
_INT_MIN, _INT_MAX = -(2**31), 2**31 - 1


class Vehicle:
    """State of a robot in a mission.

    Args:
        conf: Description of the robot.
        read: Length of each of the robot's read variables, by name.
        write: Values of the robot's write variables, by name.
        profile: Profile of the mission, like MRC or sound.

    Attributes:
        symbols: Variables of the mission.
        odometry, covariance, infrared, line_sensor: Odometry, its uncertainty, and the sensors.
        control: Motion control.
        functions: Control functions, with parameters and inputs.
        variables: Built-in system variables.
        outputs: Write variables of the robot.
        line_kind: Kind of line that `followline` follows.
        heading_offset, heading_gain: Offset and gain of `functions.heading`; the gain is in rad per count.
        uses_kalman: Whether motions use the pose of an external filter.
        cycles: Number of periods since the last cycle; more than 1 if answers of the robot were missed.
        generator_output: Output of `funcgen`, set by `routeoutput`: variable and index.

    Raises:
        BadConfiguration: If an input is routed from a variable index that does not exist.
    """

    def __init__(
        self, conf: RobotConf, read: Mapping[str, int], write: Mapping[str, Sequence[int]], profile: Profile
    ) -> None:
        self.conf = conf
        self.profile = profile
        self.symbols = Symbols(SYSTEM_NAMES, read, {name: len(words) for name, words in write.items()})
        self.outputs = VehicleOutputs(conf, self.symbols, write, profile)
        self.odometry = Odometry(conf)
        self.covariance = Covariance(conf)
        self.infrared = InfraredSensors(conf.ir_k1, conf.ir_k2)
        white, black = conf.line_white, conf.line_black
        if white is None and profile.reads_uncalibrated:
            white, black = (255.0,) * conf.line_size, (0.0,) * conf.line_size
        self.line_sensor = LineSensor(conf.line_size, conf.line_smoothing, white, black)
        self.control = MotionControl(
            copy.copy(conf.motion), conf.drive, profile, speed=conf.speed, acceleration=conf.acceleration
        )
        self.functions = ControlFunctions(self.control)
        self.variables = SystemVariables(self.symbols, read, profile)
        if not profile.stands_at_first:
            self.control.start(Stop())
            self.control.update()
        self.line_kind = self._followed = LineKind.BLACK_RIGHT
        self.control.line_position = self.line_position
        self.uses_kalman = False
        self.heading_offset = 0.0
        is_velomega = conf.drive is DriveKind.VELOMEGA
        self.heading_gain = conf.heading_gain if is_velomega else 0.0
        self.control.obstacle_front, self.control.obstacle_back = _FREE_AHEAD, _FREE_BEHIND
        self._counters = "transpos" if is_velomega else "encl", "encr"
        self._read = read
        self._has_raw_ir = self._has_ir = read.get("irsensor", 0) >= 5
        self._has_raw_line = read.get("linesensor", 0) >= conf.line_size
        self._has_tick = "tick" in read
        self._tick, self.cycles = 0, 1
        self.generator_output: tuple[str, int] | None = None
        self._generated = 0.0
        if is_velomega and (heading := self.symbols.system.get("rotpos")) is not None:
            self.symbols.find_system("rotpos")
            self.functions.route_input("mrc", "odoconnect", "dth", heading.place)
        for scale in conf.scales:
            self.symbols.set_scale(*split_index(scale.variable), offset=scale.offset, gain=scale.gain)
        for setting in conf.settings:
            self.functions.set_parameter(setting.module, setting.function, setting.parameter, setting.value)
        for route in conf.routes:
            name, index = split_index(route.variable)
            symbol = self.symbols.find_system(name)
            if symbol is not None:
                # An index beyond the variable reads the following values, as in MRC; but here it cannot leave the pool.
                if not 0 <= symbol.place + index < len(self.symbols.pool):
                    raise BadConfiguration(f"routeinput uses {route.variable}, which is not a value of the robot")
                self.functions.route_input(route.module, route.function, route.parameter, symbol.place + index)

    def _counter(self, raw: Mapping[str, Sequence[int]], name: str) -> int:
        """Return the first word of a read variable; 0 if the robot has no such variable, as in MRC."""
        return raw[name][0] if name in self._read else 0

    # -- a cycle ---------------------------------------------------------------------------------

    def begin(self, raw: Mapping[str, Sequence[int]]) -> None:
        """Use the first values as the counters before the first step."""
        self.symbols.refresh(raw)
        if self.conf.drive is DriveKind.VELOMEGA:
            # Do not apply the offset and the gain of the variable, which are used from the first step on.
            self.odometry.heading = self._counter(raw, "rotpos") * self.heading_gain
        self.odometry.begin(*(self._counter(raw, name) for name in self._counters))

    def sense(self, raw: Mapping[str, Sequence[int]]) -> None:
        """Process the values of a cycle that the script needs."""
        symbols, odometry, control = self.symbols, self.odometry, self.control
        symbols.refresh(raw)
        if external := self.variables.external:
            # Unless another input is routed there, the laser server reports the pose of the world.
            control.world.set(external.get("l0", 0.0), external.get("l1", 0.0), external.get("l2", 0.0))
        self.functions.sense(symbols.pool)
        odometry.heading = (self.functions.heading + self.heading_offset) * self.heading_gain
        if odometry.heading_source == 2:
            odometry.curvature = self._counter(raw, "curvature")
        if self._has_raw_ir:
            self.infrared.update(raw["irsensor"])
        if self._has_raw_line:
            self.line_sensor.update(raw["linesensor"])
        if self.profile.counts_ticks and self._has_tick:
            tick = raw["tick"][0]
            missed = (tick - self._tick) % 2**32
            self.cycles = missed if 0 < missed <= _MOST_MISSED and self._tick else 1
            self._tick = tick
        left, right = (self._counter(raw, name) for name in self._counters)
        odometry.update(left, right, self.cycles)
        if odometry.left_step or odometry.right_step:
            self.covariance.update(odometry.left_step, odometry.right_step)
        control.pose = odometry.pose.copy()
        if self.uses_kalman and "xkalman" in external:
            control.pose = self.kalman_pose()
        # Use the kind that the previous cycle requested, because this cycle's script comes later.
        self._followed = self.line_kind
        is_white = self.line_kind.value[:1] == "w"
        control.line_is_missing = self.line_sensor.is_missing and not is_white and self.line_kind is not LineKind.CAMERA

    def line_position(self) -> float:
        """Position of the followed line, in cm to the left."""
        kind = self._followed
        if kind is LineKind.CAMERA:
            return self.variables.external.get("linepos", 0.0)
        if kind in (LineKind.WHITE_LEFT, LineKind.WHITE_RIGHT) and not self.profile.white_edges:
            return 0.0
        return self.line_sensor.position(kind)

    def act(self) -> dict[str, list[int]]:
        """Perform motion control for this cycle. Return the variables to write, by name."""
        odometry, control, distances = self.odometry, self.control, self.infrared.distances
        control.velocity = odometry.velocity
        control.left_velocity, control.right_velocity = odometry.left_velocity, odometry.right_velocity
        if self._sees_obstacles:
            control.obstacle_front = self.infrared.front
        control.ir_left, control.ir_right = distances[0], distances[4]
        self.functions.act(self.symbols.pool)
        control.update()
        if isinstance(control.motion, FunctionGenerator):
            self._generated = control.motion.output
        if self.generator_output is not None:
            self.outputs.set(*self.generator_output, self._generated)
        self.outputs.set_speeds(control.left, control.right, control.omega)
        return self.outputs.take_changed()

    def stand(self) -> dict[str, list[int]]:
        """Stop the robot. Return the variables to write, by name."""
        self.outputs.set_speeds(0.0, 0.0, 0.0)
        return self.outputs.take_changed()

    @property
    def _sees_obstacles(self) -> bool:
        if self.conf.drive is not DriveKind.DIFFERENTIAL or self.conf.name != "smr":
            return False
        return self._has_ir or not self.profile.sees_without_ir

    # -- values from a user's program, or from outside -----------------------------------------------

    def see_line(self, values: Sequence[float]) -> None:
        """Use line values from a user's program instead of the robot's.

        The value of each sensor is 0 for black and 1 for white.

        Raises:
            BadValue: If the number of values is not the number of sensors.
        """
        if len(values) != self.line_sensor.size:
            raise BadValue(f"got {len(values)} values for {self.line_sensor.size} line sensors")
        self._has_raw_line = False
        self.line_sensor.see([float(value) for value in values])

    def see_distances(self, distances: Sequence[float]) -> None:
        """Use infrared distances from a user's program, in m.

        The order is left, front left, front middle, front right, right.

        Raises:
            BadValue: If there are not five distances.
        """
        if len(distances) != 5:
            raise BadValue(f"got {len(distances)} distances; expected 5, from left to right")
        self._has_raw_ir, self._has_ir = False, True
        self.infrared.distances[:5] = [float(distance) for distance in distances]

    def kalman_pose(self) -> PlanarPose:
        """Pose of an external filter; zeros if there is none."""
        return PlanarPose(*(self.variables.external.get(name, 0.0) for name in ("xkalman", "ykalman", "thkalman")))

    def estimated_pose(self) -> PlanarPose:
        """Pose that motions use, from the odometry or from an external filter."""
        return self.kalman_pose() if self.uses_kalman else self.odometry.pose.copy()


class VehicleOutputs:
    """Write variables of a robot: speeds and outputs, as words.

    Args:
        conf: Description of the robot.
        symbols: Variables of the mission.
        write: Values of the write variables, by name.
        profile: Profile of the mission, like MRC or sound.
    """

    def __init__(self, conf: RobotConf, symbols: Symbols, write: Mapping[str, Sequence[int]], profile: Profile) -> None:
        self._symbols = symbols
        self._is_velomega = conf.drive is DriveKind.VELOMEGA
        self._scales = conf.left_speed_scale, conf.right_speed_scale
        self._speeds = conf.writes
        self._words = {name: list(map(int, words)) for name, words in write.items()}
        self._changed: dict[str, list[int]] = {}
        self._count: Callable[[float], int] = _nearest
        self._count_speed: Callable[[float], int] = _nearest
        if not profile.outputs_round_alike:
            self._count = _half_up_to_zero
            self._count_speed = _truncated if self._is_velomega else _half_up

    @property
    def has_speed(self) -> bool:
        """Whether any of the written speeds is not 0."""
        return any(self._words[name][0] for name in self._speeds)

    def set_speeds(self, left: float, right: float, omega: float) -> None:
        """Write the wheel speeds in m/s.

        For a velocity-omega robot, write `left` and the turn rate in rad/s.
        """
        speeds = left, omega if self._is_velomega else right
        for name, scale, speed in zip(self._speeds, self._scales, speeds, strict=True):
            self._put(name, self._count_speed(speed * scale))

    def set(self, name: str, index: int, value: float) -> bool:
        """Write ``(value + offset) * gain`` to a variable, rounded.

        Return False if the robot has no such variable.
        """
        symbol = self._symbols.outputs.get(name)
        if symbol is None or not 0 <= index < symbol.size:
            return False
        pool, place = self._symbols.pool, symbol.place + index
        pool[place] = value
        scaled = (value + pool[place + symbol.size]) * pool[place + 2 * symbol.size]
        self._put(name, self._count(scaled), index)
        return True

    def set_word(self, name: str, value: float) -> bool:
        """Write the first word of a variable, without offset and gain.

        Return False if there is no such variable.
        """
        if name not in self._words:
            return False
        self._put(name, _truncated(value))
        return True

    def reset_motors(self) -> None:
        """Write the variables that reset the motors, if the robot has them."""
        for name in ("resetmotorr", "resetmotorl"):
            if name in self._words:
                self._changed[name] = self._words[name]

    def _put(self, name: str, word: int, index: int = 0) -> None:
        words = self._words[name]
        words[index] = word
        self._changed[name] = words

    def take_changed(self) -> dict[str, list[int]]:
        """Remove and return the variables that were set since the last call, by name.

        Each variable has all its words.
        """
        changed, self._changed = self._changed, {}
        return {name: list(words) for name, words in changed.items()}


# Conversion of numbers to words. A nan becomes 0, and a number that is too large becomes the nearest word. MRC would
# send -2147483648 for both.


def _truncated(value: float) -> int:
    return 0 if value != value else int(max(_INT_MIN, min(_INT_MAX, value)))


def _nearest(value: float) -> int:
    whole = _truncated(abs(value) + 0.5)
    return -whole if value < 0 else whole


def _half_up_to_zero(value: float) -> int:
    """Convert ``value + 0.5`` as C does, for MRC's `setoutput`: -3 becomes -2."""
    return _truncated(value + 0.5)


def _half_up(value: float) -> int:
    """Compute ``floor(value + 0.5)``, as MRC rounds wheel speeds."""
    return 0 if value != value else int(max(_INT_MIN, min(_INT_MAX, value + 0.5)) // 1)
