"""The robot as a mission sees it: from its variables to a pose and system variables, and from speeds to its variables.

One cycle of MRC's main loop (mrc.c) in two halves, with the script between them::

    sense   read variables -> infrared, line -> odometry -> inputs of motion control
    act     motion control -> written variables

Nothing here opens a connection or reads a clock: the variables of a cycle come in as a mapping, and what is to be
written goes out as one.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

from linkcore.errors import BadValue

from .motion.control import Drive, Line, LineKind, MotionControl
from .motion.standing import FunctionGenerator, Stop
from .odometry import Covariance, Odometry, Pose
from .profile import Profile
from .robot_conf import RobotConf
from .sensors import InfraredSensors, LineSensor
from .symbols import Symbols, split_index

__all__ = ["BUILT_IN", "Vehicle", "counted"]

_RESULTS = tuple(f"res{number}" for number in range(10))
_LINES = tuple(f"line{number}" for number in range(8))
_RAW_LINES = tuple(f"lineraw{number}" for number in range(8))
_VISION = tuple(f"vis{number}" for number in range(10))
_LASER = tuple(f"l{number}" for number in range(10))
_GUIDE_MARK = ("guidemarkok", "gmkcrc", "gmkx", "gmky", "gmkz", "gmkomega", "gmkphi", "gmkkappa")

#: The built-in system variables behind the results, in MRC's order. Those that MRC computes from hardware that no robot
#: of today has (hako, imu, gps, kalman filter, camera) keep the value that `Vehicle.external` has for them, or 0.
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
_PLACES = {name: number for number, name in enumerate(BUILT_IN)}
#: Values that stand in MRC's structures before anything has measured them.
_INITIAL = {"batteryvoltage": 14.0, "nolinecamr": 1.0, "nolinecaml": 1.0}

#: Read variables of the robot that MRC shows under a name of its own: variable, and whether the second value counts
#: its millionths.
_GPS = {
    "gpseasting": ("GPSeasting", True),
    "gpsnorthing": ("GPSnorthing", True),
    "gpsquality": ("GPSquality", False),
    "gpssatellites": ("GPSsatused", False),
    "gpsdop": ("GPSdop", True),
}

_INT_MIN, _INT_MAX = -(2**31), 2**31 - 1

#: m to an obstacle where nothing measures it: ahead, and behind.
_FREE_AHEAD, _FREE_BEHIND = 50.0, 1.0


def counted(value: float, *, rounds_alike: bool) -> int:
    """A number as it is written: rounded to the nearest, or C's conversion of ``value + 0.5``. nan is 0.

    MRC would send -2147483648 for what is no number or does not fit.
    """
    if value != value:
        return 0
    if not rounds_alike:
        return int(max(_INT_MIN, min(_INT_MAX, value + 0.5)))
    whole = int(max(_INT_MIN, min(_INT_MAX, abs(value) + 0.5)))
    return -whole if value < 0 else whole


class Vehicle:
    """The state of a robot under a mission.

    Args:
        conf: what it is.
        read: length of each of its read variables, by name.
        write: the values of its write variables, by name.
        profile: as MRC does it, or sound.

    Attributes:
        symbols: the variables of the mission.
        odometry, covariance, infrared, line_sensor: of the robot.
        control: its motion control.
        line_kind: which line `followline` follows.
        external: system variables that a user's program provides, by name.
        obstacle_front: m; by default what the front infrared sensors of an SMR see.
    """

    def __init__(
        self, conf: RobotConf, read: Mapping[str, int], write: Mapping[str, Sequence[int]], profile: Profile
    ) -> None:
        self.conf = conf
        self.profile = profile
        self.symbols = Symbols(
            (*_RESULTS, *BUILT_IN, "xyzout1"), read, {name: len(words) for name, words in write.items()}
        )
        self.odometry = Odometry(
            left_scale=conf.left_scale,
            right_scale=conf.right_scale,
            width=conf.width,
            period=conf.period,
            max_tick=conf.max_tick,
            heading_source=conf.heading_source,
            is_rate=conf.is_rate,
            is_relative=conf.is_relative,
        )
        self.covariance = Covariance(conf.left_scale, conf.right_scale, conf.width)
        self.infrared = InfraredSensors(conf.ir_k1, conf.ir_k2)
        self.line_sensor = LineSensor(conf.line_size, conf.line_smoothing, conf.line_white, conf.line_black)
        self.control = MotionControl(
            copy.copy(conf.motion),
            conf.drive,
            profile,
            speed=conf.speed,
            acceleration=conf.acceleration,
        )
        if not profile.stands_at_first:
            self.control.start(Stop())
            self.control.update()
        self.line_kind = LineKind.BLACK_RIGHT
        self.external: dict[str, float] = {}
        #: Whether motions go by the pose of a filter outside.
        self.uses_kalman = False
        self.heading_offset = 0.0
        is_velomega = conf.drive is Drive.VELOMEGA
        self.heading_gain = conf.heading_gain if is_velomega else 0.0
        self.obstacle_front = _FREE_AHEAD
        self._left_counter = "transpos" if is_velomega else "encl"
        self._right_counter = "encr"
        self._written = ("cmdtransvel", "cmdrotvel") if is_velomega else ("speedl", "speedr")
        self._words = {name: list(map(int, words)) for name, words in write.items()}
        self._changed: dict[str, list[int]] = {}
        self._has_ir = read.get("irsensor", 0) >= 5
        self._has_line = read.get("linesensor", 0) >= conf.line_size
        self._has_tick = "tick" in read
        self._gps = tuple((_PLACES[name], *source) for name, source in _GPS.items() if source[0] in read)
        self._values = [_INITIAL.get(name, 0.0) for name in BUILT_IN]
        first = self.symbols.system[BUILT_IN[0]].place
        self._block = slice(first, first + 3 * len(BUILT_IN), 3)
        self._results = self.symbols.system["res0"].place
        self._is_begun = False
        #: Inputs of control functions that come from a system variable: its place in the pool.
        self.routes: dict[tuple[str, str, str], int] = {}
        #: The output that `routeoutput` sends `funcgen` to: variable and index.
        self.generator_output: tuple[str, int] | None = None
        self._generator: FunctionGenerator | None = None
        if is_velomega and (heading := self.symbols.system.get("rotpos")) is not None:
            self.symbols.find_system("rotpos")
            self.routes["mrc", "odoconnect", "dth"] = heading.place
        for scale in conf.scales:
            name, index = split_index(scale.variable)
            self.set_scale(name, index, offset=scale.offset, gain=scale.gain)
        for setting in conf.settings:
            self.set_parameter(setting.module, setting.function, setting.parameter, setting.value)
        for route in conf.routes:
            name, index = split_index(route.variable)
            symbol = self.symbols.find_system(name)
            if symbol is not None:
                self.route_input(route.module, route.function, route.parameter, symbol.place + index)

    # -- a cycle ---------------------------------------------------------------------------------

    def begin(self, raw: Mapping[str, Sequence[int]]) -> None:
        """Take the first values: the counters before the first step."""
        self.symbols.refresh(raw)
        if self.conf.drive is Drive.VELOMEGA:
            # Without offset and gain of the variable, which count from the first step on.
            self.odometry.heading = _first(raw, "rotpos") * self.heading_gain
        self.odometry.begin(_first(raw, self._left_counter), _first(raw, self._right_counter))

    def sense(self, raw: Mapping[str, Sequence[int]]) -> None:
        """Take the values of a cycle, as far as the script needs them."""
        self.symbols.refresh(raw)
        odometry, control = self.odometry, self.control
        odometry.heading = (self._routed("mrc", "odoconnect", "dth") + self.heading_offset) * self.heading_gain
        if self.external or self.routes:
            # Unless something else is named, the laser server tells where the world lies.
            world, told = control.world, self.external
            world.x = self._routed("mrc", "motionconnect", "w2odox", told.get("l0", 0.0))
            world.y = self._routed("mrc", "motionconnect", "w2odoy", told.get("l1", 0.0))
            world.th = self._routed("mrc", "motionconnect", "w2odoth", told.get("l2", 0.0))
        if odometry.heading_source == 2:
            odometry.curvature = _first(raw, "curvature")
        if self._has_ir:
            self.infrared.update(raw["irsensor"])
        if self._has_line:
            self.line_sensor.update(raw["linesensor"])
        control.line = self._line()
        odometry.update(_first(raw, self._left_counter), _first(raw, self._right_counter))
        self.covariance.update(odometry.left_step, odometry.right_step)
        control.pose = odometry.pose.copy()
        if self.uses_kalman and "xkalman" in self.external:
            control.pose = self.kalman_pose()

    def update_variables(self, driven: float, seconds: float, time: float) -> None:
        """Bring the built-in system variables up to date, as MRC does before each line and each test of conditions.

        Args:
            driven: m since the line began.
            seconds: since then.
            time: ``$time``.
        """
        values, odometry, control = self._values, self.odometry, self.control
        pose, target, sensor, raw = odometry.pose, control.target, self.line_sensor, self.symbols.raw
        values[0:2] = driven, seconds
        values[2:7] = self.infrared.distances[:5]
        if self._has_ir:
            values[7:12] = raw["irsensor"][:5]
        values[12:21] = (
            *(pose.x, pose.y, pose.th, odometry.distance, odometry.left_distance, odometry.right_distance),
            *(odometry.velocity, odometry.right_step, odometry.left_step),
        )
        values[22] = sensor.is_found
        values[23] = sensor.crosses_black(odometry.distance)
        values[25] = sensor.crosses_white(odometry.distance)
        size = min(sensor.size, 8)
        values[31 : 31 + size] = sensor.values[:size]
        if self._has_line:
            words = raw["linesensor"][:8]
            values[39 : 39 + len(words)] = words
        values[47:49] = control.line.position, sensor.is_missing
        values[_LOG0 : _LOG0 + 4] = (
            self._routed("motioncontrol", "followwall", "distl", self.infrared.distances[0]),
            self._routed("motioncontrol", "followwall", "distr", self.infrared.distances[4]),
            self._routed("motioncontrol", "followwall", "anglel"),
            self._routed("motioncontrol", "followwall", "angler"),
        )
        values[_MOTORS : _MOTORS + 9] = (
            *(control.left, control.right, 0.0, control.is_blocked),
            *(target.x, target.y, target.th, control.remaining, time),
        )
        values[_SPEED_REFERENCE] = control.left
        values[_MOTCON : _MOTCON + 3] = control.left, control.right, control.omega
        covariance = self.covariance
        values[_COVARIANCE : _COVARIANCE + 6] = (
            *(covariance.th_th, covariance.th_x, covariance.th_y),
            *(covariance.x_x, covariance.x_y, covariance.y_y),
        )
        for place, name, has_millionths in self._gps:
            words = raw[name]
            values[place] = words[0] + (1e-6 * words[1] if has_millionths and len(words) > 1 else 0.0)
        if self.profile.knows_tick and self._has_tick:
            values[_TICK] = raw["tick"][0]
        for name, value in self.external.items():
            values[_PLACES[name]] = value
        self.symbols.pool[self._block] = values

    def act(self) -> dict[str, list[int]]:
        """Motion control for this cycle; what is to be written, by name."""
        odometry, control = self.odometry, self.control
        control.velocity = odometry.velocity
        control.left_velocity, control.right_velocity = odometry.left_velocity, odometry.right_velocity
        if self._sees_obstacles:
            self.obstacle_front = self.infrared.front
        control.obstacle_front = self._routed("mrc", "motionconnect", "obstaclefront", self.obstacle_front)
        control.obstacle_back = self._routed("mrc", "motionconnect", "obstacleback", _FREE_BEHIND)
        distances = self.infrared.distances
        control.ir_left = self._routed("motioncontrol", "followwall", "distl", distances[0])
        control.ir_right = self._routed("motioncontrol", "followwall", "distr", distances[4])
        control.wall_angle_left = self._routed("motioncontrol", "followwall", "anglel")
        control.wall_angle_right = self._routed("motioncontrol", "followwall", "angler")
        if self.routes:
            reference = control.reference
            reference.x = self._routed("motioncontrol", "drive", "refx", reference.x)
            reference.y = self._routed("motioncontrol", "drive", "refy", reference.y)
            reference.th = self._routed("motioncontrol", "drive", "refth", reference.th)
        control.update()
        if isinstance(control.motion, FunctionGenerator):
            self._generator = control.motion
        if self.generator_output is not None:
            name, index = self.generator_output
            self.set_output(name, index, 0.0 if self._generator is None else self._generator.output)
        self._write_speeds(control.left, control.right, control.omega)
        return self.take_changed()

    def stand(self) -> dict[str, list[int]]:
        """What is to be written for the robot to stand, by name."""
        self._write_speeds(0.0, 0.0, 0.0)
        return self.take_changed()

    def _write_speeds(self, left: float, right: float, omega: float) -> None:
        conf, alike = self.conf, self.profile.outputs_round_alike
        first, second = left * conf.left_speed_scale, right * conf.right_speed_scale
        if conf.drive is Drive.VELOMEGA:
            second = omega * conf.right_speed_scale
            if not alike:
                self._put(self._written[0], _truncated(first))
                self._put(self._written[1], _truncated(second))
                return
        elif not alike:
            self._put(self._written[0], _floored(first))
            self._put(self._written[1], _floored(second))
            return
        self._put(self._written[0], counted(first, rounds_alike=True))
        self._put(self._written[1], counted(second, rounds_alike=True))

    def _put(self, name: str, word: int) -> None:
        words = self._words[name]
        words[0] = word
        self._changed[name] = words

    def take_changed(self) -> dict[str, list[int]]:
        """What was set since the last call, by name; whole variables."""
        changed, self._changed = self._changed, {}
        return {name: list(words) for name, words in changed.items()}

    @property
    def _sees_obstacles(self) -> bool:
        if self.conf.drive is not Drive.DIFFERENTIAL or self.conf.name != "smr":
            return False
        return self._has_ir or not self.profile.sees_without_ir or any(self.infrared.distances)

    def _line(self) -> Line:
        sensor, kind = self.line_sensor, self.line_kind
        has_edges = self.profile.white_edges
        if kind is LineKind.BLACK_MIDDLE:
            return Line(sensor.black, sensor.is_missing)
        if kind is LineKind.BLACK_LEFT:
            return Line(sensor.black_left, sensor.is_missing)
        if kind is LineKind.BLACK_RIGHT:
            return Line(sensor.black_right, sensor.is_missing)
        if kind is LineKind.WHITE_MIDDLE:
            return Line(sensor.white)
        if kind is LineKind.WHITE_LEFT:
            return Line(sensor.white_left if has_edges else 0.0)
        if kind is LineKind.WHITE_RIGHT:
            return Line(sensor.white_right if has_edges else 0.0)
        return Line(self.external.get("linepos", 0.0))

    # -- what the script changes ------------------------------------------------------------------

    def set_results(self, *values: float) -> None:
        """Set ``$res0`` and those behind it."""
        for number, value in enumerate(values):
            self.symbols.pool[self._results + 3 * number] = value

    def set_output(self, name: str, index: int, value: float) -> bool:
        """Write a variable of the robot: ``(value + offset) * gain``, as a whole number. False if it has no such one."""
        symbol = self.symbols.outputs.get(name)
        if symbol is None or not 0 <= index < symbol.size:
            return False
        pool, place = self.symbols.pool, symbol.place + index
        pool[place] = value
        scaled = (value + pool[place + symbol.size]) * pool[place + 2 * symbol.size]
        words = self._words[name]
        words[index] = counted(scaled, rounds_alike=self.profile.outputs_round_alike)
        self._changed[name] = words
        return True

    def set_word(self, name: str, value: float) -> bool:
        """Write the first word of a variable, without offset and gain. False if the robot has no such one."""
        if name not in self._words:
            return False
        self._put(name, _truncated(value))
        return True

    def set_scale(self, name: str, index: int, *, offset: float | None = None, gain: float | None = None) -> bool:
        """Set offset or gain of a variable of the robot. False if it has no such one."""
        symbol = self.symbols.find_system(name)
        if symbol is None or not 0 <= index < symbol.size:
            return False
        if offset is not None:
            self.symbols.pool[symbol.place + symbol.size + index] = offset
        if gain is not None:
            self.symbols.pool[symbol.place + 2 * symbol.size + index] = gain
        return True

    def set_parameter(self, module: str, function: str, name: str, value: float) -> bool:
        """Set a parameter of a control function. False if there is none of that name."""
        attribute = _PARAMETERS.get((module, function, name))
        if attribute is None:
            return False
        setattr(self.control.parameters, attribute, value)
        return True

    def route_input(self, module: str, function: str, name: str, place: int) -> bool:
        """Have an input of a control function come from a place in the pool. False if there is none of that name."""
        if not self.has_input(module, function, name):
            return False
        self.routes[module, function, name] = place
        return True

    def has_input(self, module: str, function: str, name: str) -> bool:
        """Whether a control function has an input of that name."""
        return (module, function, name) in _INPUTS

    @property
    def functions(self) -> Mapping[str, frozenset[str]]:
        """The control functions of each module."""
        return _FUNCTIONS

    def provide(self, values: Mapping[str, float]) -> None:
        """Set built-in system variables that nothing here computes, from a user's program.

        Raises:
            BadValue: a name that is none of them.
        """
        for name, value in values.items():
            name = name.removeprefix("$")
            if name not in _PLACES:
                raise BadValue(f"${name} is no built-in system variable")
            self.external[name] = float(value)

    def kalman_pose(self) -> Pose:
        """The pose of a filter outside, where there is one."""
        return Pose(*(self.external.get(name, 0.0) for name in ("xkalman", "ykalman", "thkalman")))

    def estimated_pose(self) -> Pose:
        """The pose that motions go by: of the odometry, or of a filter."""
        return self.kalman_pose() if self.uses_kalman else self.odometry.pose.copy()

    def _routed(self, module: str, function: str, name: str, default: float = 0.0) -> float:
        place = self.routes.get((module, function, name))
        return default if place is None else self.symbols.pool[place]

    @property
    def is_told_to_stop(self) -> bool:
        """Whether the input `stop` of `mrccontrol` is not 0."""
        return self._routed("mrc", "mrccontrol", "stop") != 0.0

    def reset_motors(self) -> None:
        """Write the variables that reset the motors, where the robot has them."""
        for name in ("resetmotorr", "resetmotorl"):
            if name in self._words:
                self._changed[name] = self._words[name]


_LOG0 = _PLACES["log0"]
_MOTORS = _PLACES["motorcmdl"]
_SPEED_REFERENCE = _PLACES["hakospeedref"]
_MOTCON = _PLACES["motcon_lvel"]
_COVARIANCE = _PLACES["odocovth"]
_TICK = _PLACES["tick"]

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

_INPUTS = frozenset(
    (
        *(("motioncontrol", "followwall", name) for name in ("distl", "distr", "angler", "anglel")),
        *(("motioncontrol", "drive", name) for name in ("refx", "refy", "refth")),
        *(("mrc", "odoconnect", name) for name in ("dth", "steeringangle")),
        *(("mrc", "motionconnect", name) for name in ("w2odox", "w2odoy", "w2odoth", "obstaclefront", "obstacleback")),
        ("mrc", "mrccontrol", "stop"),
    )
)
_FUNCTIONS: Mapping[str, frozenset[str]] = {
    "motioncontrol": frozenset(("followwall", "drivetopoint", "drive", "movetoxyz")),
    "mrc": frozenset(("odoconnect", "motionconnect", "mrccontrol")),
}


def _first(raw: Mapping[str, Sequence[int]], name: str) -> int:
    words = raw.get(name)
    return 0 if words is None else words[0]


def _truncated(value: float) -> int:
    return 0 if value != value else int(max(_INT_MIN, min(_INT_MAX, value)))


def _floored(value: float) -> int:
    # MRC rounds by floor(value + 0.5): halves upward.
    return 0 if value != value else int(max(_INT_MIN, min(_INT_MAX, value + 0.5)) // 1)
