"""Built-in system variables of a mission (``$odox``, ``$time``).

This module defines their names, and computes their values in each cycle.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Protocol

from linkcore.errors import BadValue

from .motion.control import MotionControl
from .odometry import Covariance, Odometry
from .profile import Profile
from .sensors import InfraredSensors, LineSensor
from .symbols import Symbols

_RESULTS = tuple(f"res{number}" for number in range(10))
_LINES = tuple(f"line{number}" for number in range(8))
_RAW_LINES = tuple(f"lineraw{number}" for number in range(8))
_VISION = tuple(f"vis{number}" for number in range(10))
_LASER = tuple(f"l{number}" for number in range(10))
_GUIDE_MARK = ("guidemarkok", "gmkcrc", "gmkx", "gmky", "gmkz", "gmkomega", "gmkphi", "gmkkappa")

#: The built-in system variables after the results, in MRC's order. MRC computes some of them from hardware that no
#: current robot has (hako, imu, gps, kalman filter, camera). These have the value in `SystemVariables.external`, or 0.
BUILT_IN = (
    *("drivendist", "cmdtime", "irdistleft", "irdistfrontleft", "irdistfrontmiddle", "irdistfrontright", "irdistright"),
    *("irl", "irfl", "irfm", "irfr", "irr", "odox", "odoy", "odoth", "ododist", "ododistleft", "ododistright"),
    *("odovelocity", "ododencr", "ododencl", "odosteeringangle", "blacklinefound", "crossingblackline"),
    *("crossingblackliner", "crossingwhiteline", "rowdetectedright", "rowdetectedleft", "batteryvoltage"),
    *("supplyvoltage", "statereturn", *_LINES, *_RAW_LINES, "linepos", "nolineb", "nolinecamr", "nolinecaml"),
    *("edgedetect", "edgex", "edgey", "edgeth", *_GUIDE_MARK, "wallnow", "wallholes", "log0", "log1", "log2", "log3"),
    *("wheretogo", "motorpwml", "motorpwmr", "motorcmdl", "motorcmdr", "blocked", "motionstatus"),
    *("targetx", "targety", "targetth", "targetdist", "time", "gyro1", "gyro2", "gyrotemp1", "gyrotemp2", "readflags"),
    *("hakosteeringangleref", "hakospeedref", "hakocvtpulses", "hakoenginespeed", "hakoenginespeedref"),
    *("hakonavigationmoderef", "hakodirectionbyte", "hakoliftinggearpos", "hakopowertakeoffspeed"),
    *("imuroll", "imupitch", "imuyaw", "imuaccx", "imuaccy", "imuaccz", "imutemp", "imutime"),
    *("xkalman", "ykalman", "thkalman", "kalmanstatus"),
    *("gpseasting", "gpsnorthing", "gpsquality", "gpssatellites", "gpsdop", *_VISION, *_LASER, "clock", "tick"),
    *("motcon_lvel", "motcon_rvel", "motcon_omega", "motcon_steeringangle", "kalmanmode"),
    *("odocovth", "odocovthx", "odocovthy", "odocovx", "odocovxy", "odocovy"),
)
#: Every system variable except ``$condition`` and the robot's variables, in MRC's order.
SYSTEM_NAMES = (*_RESULTS, *BUILT_IN, "xyzout1")
_PLACES = {name: number for number, name in enumerate(BUILT_IN)}


def _span(first: str, last: str) -> slice:
    """Return the slice of the positions from the first to the last variable."""
    return slice(_PLACES[first], _PLACES[last] + 1)


_LINE_AND_DISTANCES, _RAW_DISTANCES = _span("drivendist", "irdistright"), _span("irl", "irr")
_ODOMETRY, _COVARIANCE = _span("odox", "ododencl"), _span("odocovth", "odocovy")
_FOUND, _BLACK, _WHITE = (_PLACES[name] for name in ("blacklinefound", "crossingblackline", "crossingwhiteline"))
_FIRST_LINE, _FIRST_RAW_LINE, _LINE_POSITION = _PLACES["line0"], _PLACES["lineraw0"], _span("linepos", "nolineb")
_LOGGED, _MOTION = _span("log0", "log3"), _span("motorcmdl", "time")
_SPEED_REFERENCE, _MOTCON, _TICK = _PLACES["hakospeedref"], _span("motcon_lvel", "motcon_omega"), _PLACES["tick"]

#: Initial values in MRC's structures before any measurement.
_INITIAL = {"batteryvoltage": 14.0, "nolinecamr": 1.0, "nolinecaml": 1.0}

#: System variable -> read variable of the robot that MRC shows under this name, and whether its second value counts
#: millionths.
_GPS = {
    "gpseasting": ("GPSeasting", True),
    "gpsnorthing": ("GPSnorthing", True),
    "gpsquality": ("GPSquality", False),
    "gpssatellites": ("GPSsatused", False),
    "gpsdop": ("GPSdop", True),
}


class SensedState(Protocol):
    """State of a `Vehicle` from which the system variables are computed."""

    odometry: Odometry
    covariance: Covariance
    control: MotionControl
    infrared: InfraredSensors
    line_sensor: LineSensor


class SystemVariables:
    """Values of the built-in system variables.

    Args:
        symbols: Variables of the mission, which contain these values.
        read: Names of the robot's read variables.
        profile: Profile of the mission, like MRC or sound.

    Attributes:
        external: Values that a user's program provides, by name.
    """

    def __init__(self, symbols: Symbols, read: Collection[str], profile: Profile) -> None:
        self._symbols = symbols
        self.external: dict[str, float] = {}
        self._gps = tuple((_PLACES[name], *source) for name, source in _GPS.items() if source[0] in read)
        self._has_tick = profile.knows_tick and "tick" in read
        self._values = [_INITIAL.get(name, 0.0) for name in BUILT_IN]
        first = symbols.system[BUILT_IN[0]].place
        self._block = slice(first, first + 3 * len(BUILT_IN), 3)

    def provide(self, values: Mapping[str, float]) -> None:
        """Set values that a user's program provides, because this module does not compute them.

        Raises:
            BadValue: If a name is not a built-in system variable.
        """
        for name, value in values.items():
            name = name.removeprefix("$")
            if name not in _PLACES:
                raise BadValue(f"${name} is not a built-in system variable")
            self.external[name] = float(value)

    def update(self, vehicle: SensedState, driven: float, cycles: int, time: float) -> None:
        """Update the values, as MRC does before each line and each test of conditions.

        Args:
            vehicle: State from which the values are computed.
            driven: Distance in m since the line began.
            cycles: Number of cycles since the line began.
            time: Value of ``$time``.
        """
        values, odometry, control, infrared = self._values, vehicle.odometry, vehicle.control, vehicle.infrared
        pose, target, sensor, covariance = odometry.pose, control.target, vehicle.line_sensor, vehicle.covariance
        distances, seconds = infrared.distances, cycles * control.parameters.period
        left, right, driven_all = control.left, control.right, odometry.distance
        values[_LINE_AND_DISTANCES] = driven, seconds, *distances[:5]
        values[_ODOMETRY] = (
            *(pose.x, pose.y, pose.th, driven_all, odometry.left_distance, odometry.right_distance),
            *(odometry.velocity, odometry.right_step, odometry.left_step),
        )
        values[_FOUND] = sensor.is_found
        values[_BLACK] = sensor.crosses_black(driven_all)
        values[_WHITE] = sensor.crosses_white(driven_all)
        if infrared.raw:
            values[_RAW_DISTANCES] = infrared.raw[:5]
        size = min(sensor.size, len(_LINES))
        if sensor.raw:
            values[_FIRST_RAW_LINE : _FIRST_RAW_LINE + size] = sensor.raw[:size]
        values[_FIRST_LINE : _FIRST_LINE + size] = sensor.values[:size]
        values[_LINE_POSITION] = control.line_position(), sensor.is_missing
        values[_LOGGED] = distances[0], distances[4], control.wall_angle_left, control.wall_angle_right
        values[_MOTION] = (
            *(left, right, 0.0, control.is_blocked, target.x, target.y, target.th),
            *(control.remaining, time),
        )
        values[_SPEED_REFERENCE] = left
        values[_MOTCON] = left, right, control.omega
        values[_COVARIANCE] = (
            *(covariance.th_th, covariance.th_x, covariance.th_y),
            *(covariance.x_x, covariance.x_y, covariance.y_y),
        )
        raw = self._symbols.raw
        for place, name, has_millionths in self._gps:
            words = raw[name]
            values[place] = words[0] + (1e-6 * words[1] if has_millionths and len(words) > 1 else 0.0)
        if self._has_tick:
            values[_TICK] = raw["tick"][0]
        for name, value in self.external.items():
            values[_PLACES[name]] = value
        self._symbols.pool[self._block] = values
