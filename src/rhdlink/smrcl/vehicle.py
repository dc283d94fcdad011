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
from operator import attrgetter

from linkcore.errors import BadValue

from .motion.basic import FunctionGenerator, Stop
from .motion.control import DriveKind, MotionControl
from .odometry import Covariance, Odometry, Pose
from .profile import Profile
from .robot_conf import RobotConf
from .sensors import InfraredSensors, LineKind, LineSensor
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


def _span(first: str, last: str) -> slice:
    """The places from one of them to another one."""
    return slice(_PLACES[first], _PLACES[last] + 1)


_LINE_AND_DISTANCES, _RAW_DISTANCES = _span("drivendist", "irdistright"), _span("irl", "irr")
_ODOMETRY, _COVARIANCE = _span("odox", "ododencl"), _span("odocovth", "odocovy")
_FOUND, _BLACK, _WHITE = (_PLACES[name] for name in ("blacklinefound", "crossingblackline", "crossingwhiteline"))
_FIRST_LINE, _FIRST_RAW_LINE, _LINE_POSITION = _PLACES["line0"], _PLACES["lineraw0"], _span("linepos", "nolineb")
_LOGGED, _MOTION = _span("log0", "log3"), _span("motorcmdl", "time")
_SPEED_REFERENCE, _MOTCON, _TICK = _PLACES["hakospeedref"], _span("motcon_lvel", "motcon_omega"), _PLACES["tick"]

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
#: Ticks that can have been missed; more are a host that was started again.
_MOST_MISSED = 1000


def counted(value: float, *, rounds_alike: bool) -> int:
    """A number as it is written: rounded to the nearest, or C's conversion of ``value + 0.5``. nan is 0.

    MRC would send -2147483648 for what is not a number or does not fit.
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
        heading: of the counter or gyro, before offset and gain.
        heading_offset, heading_gain: of it; rad per count.
        uses_kalman: motions go by the pose of a filter outside.
        stop_input: not 0 ends the mission.
        cycles: periods since the cycle before; more than 1 where answers of the robot were missed.
        generator_output: the output that `routeoutput` sends `funcgen` to: variable and index.
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
        white, black = conf.line_white, conf.line_black
        if white is None and profile.reads_uncalibrated:
            white, black = (255.0,) * conf.line_size, (0.0,) * conf.line_size
        self.line_sensor = LineSensor(conf.line_size, conf.line_smoothing, white, black)
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
        self.line_kind = self._followed = LineKind.BLACK_RIGHT
        self.control.line_position = self.line_position
        self.external: dict[str, float] = {}
        self.uses_kalman = False
        self.heading_offset = 0.0
        is_velomega = conf.drive is DriveKind.VELOMEGA
        self.heading_gain = conf.heading_gain if is_velomega else 0.0
        self.heading = self.steering_angle = self.stop_input = 0.0
        self.control.obstacle_front, self.control.obstacle_back = _FREE_AHEAD, _FREE_BEHIND
        self._left_counter = "transpos" if is_velomega else "encl"
        self._right_counter = "encr"
        self._written = ("cmdtransvel", "cmdrotvel") if is_velomega else ("speedl", "speedr")
        self._words = {name: list(map(int, words)) for name, words in write.items()}
        self._changed: dict[str, list[int]] = {}
        self._read = frozenset(read)
        self._has_raw_ir = self._has_ir = read.get("irsensor", 0) >= 5
        self._has_raw_line = self._has_line = read.get("linesensor", 0) >= conf.line_size
        self._has_tick = "tick" in read
        self._tick = 0
        self.cycles = 1
        self._gps = tuple((_PLACES[name], *source) for name, source in _GPS.items() if source[0] in read)
        self._has_more = bool(self._gps) or (profile.knows_tick and self._has_tick)
        self._values = [_INITIAL.get(name, 0.0) for name in BUILT_IN]
        first = self.symbols.system[BUILT_IN[0]].place
        self._block = slice(first, first + 3 * len(BUILT_IN), 3)
        self._results = self.symbols.system["res0"].place
        # Inputs of control functions that come from a place in the pool.
        self._routes: dict[tuple[bool, str, str], int] = {}
        self._sensed: list[tuple[object, str, int]] = []
        self._acted: list[tuple[object, str, int]] = []
        self.generator_output: tuple[str, int] | None = None
        self._generator: FunctionGenerator | None = None
        if is_velomega and (heading := self.symbols.system.get("rotpos")) is not None:
            self.symbols.find_system("rotpos")
            self.route_input("mrc", "odoconnect", "dth", heading.place)
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

    def _counter(self, raw: Mapping[str, Sequence[int]], name: str) -> int:
        """The first word of a read variable; 0 if the robot has none of that name, as in MRC."""
        return raw[name][0] if name in self._read else 0

    # -- a cycle ---------------------------------------------------------------------------------

    def begin(self, raw: Mapping[str, Sequence[int]]) -> None:
        """Take the first values: the counters before the first step."""
        self.symbols.refresh(raw)
        if self.conf.drive is DriveKind.VELOMEGA:
            # Without offset and gain of the variable, which count from the first step on.
            self.odometry.heading = self._counter(raw, "rotpos") * self.heading_gain
        self.odometry.begin(self._counter(raw, self._left_counter), self._counter(raw, self._right_counter))

    def sense(self, raw: Mapping[str, Sequence[int]]) -> None:
        """Take the values of a cycle, as far as the script needs them."""
        symbols, odometry, control = self.symbols, self.odometry, self.control
        symbols.refresh(raw)
        if self.external:
            # Unless something else is routed there, the laser server tells where the world lies.
            told = self.external
            control.world.set(told.get("l0", 0.0), told.get("l1", 0.0), told.get("l2", 0.0))
        pool = symbols.pool
        for owner, attribute, place in self._sensed:
            setattr(owner, attribute, pool[place])
        odometry.heading = (self.heading + self.heading_offset) * self.heading_gain
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
        left, right = self._counter(raw, self._left_counter), self._counter(raw, self._right_counter)
        odometry.update(left, right, self.cycles)
        if odometry.left_step or odometry.right_step:
            self.covariance.update(odometry.left_step, odometry.right_step)
        control.pose = odometry.pose.copy()
        if self.uses_kalman and "xkalman" in self.external:
            control.pose = self.kalman_pose()
        # The kind that was asked for by the cycle before: the script of this one comes later.
        self._followed = self.line_kind
        is_white = self.line_kind.value[:1] == "w"
        control.line_is_missing = self.line_sensor.is_missing and not is_white and self.line_kind is not LineKind.CAMERA

    def update_variables(self, driven: float, seconds: float, time: float) -> None:
        """Bring the built-in system variables up to date, as MRC does before each line and each test of conditions.

        Args:
            driven: m since the line began.
            seconds: since then.
            time: ``$time``.
        """
        values, odometry, control = self._values, self.odometry, self.control
        pose, target, sensor, covariance = odometry.pose, control.target, self.line_sensor, self.covariance
        distances = self.infrared.distances
        left, right, driven_all = control.left, control.right, odometry.distance
        values[_LINE_AND_DISTANCES] = driven, seconds, *distances[:5]
        values[_ODOMETRY] = (
            *(pose.x, pose.y, pose.th, driven_all, odometry.left_distance, odometry.right_distance),
            *(odometry.velocity, odometry.right_step, odometry.left_step),
        )
        values[_FOUND] = sensor.is_found
        values[_BLACK] = sensor.crosses_black(driven_all)
        values[_WHITE] = sensor.crosses_white(driven_all)
        if self._has_raw_ir:
            values[_RAW_DISTANCES] = self.symbols.raw["irsensor"][:5]
        size = min(sensor.size, len(_LINES))
        if self._has_raw_line:
            values[_FIRST_RAW_LINE : _FIRST_RAW_LINE + size] = self.symbols.raw["linesensor"][:size]
        if self._has_line:
            values[_FIRST_LINE : _FIRST_LINE + size] = sensor.values[:size]
            values[_LINE_POSITION] = self.line_position(), sensor.is_missing
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
        if self._has_more:
            self._update_more()
        self.symbols.pool[self._block] = values

    def _update_more(self) -> None:
        """The system variables that few robots have."""
        values, raw = self._values, self.symbols.raw
        for place, name, has_millionths in self._gps:
            words = raw[name]
            values[place] = words[0] + (1e-6 * words[1] if has_millionths and len(words) > 1 else 0.0)
        if self.profile.knows_tick and self._has_tick:
            values[_TICK] = raw["tick"][0]
        for name, value in self.external.items():
            values[_PLACES[name]] = value

    def line_position(self) -> float:
        """The position of the line that is followed, cm to the left."""
        kind = self._followed
        if kind is LineKind.CAMERA:
            return self.external.get("linepos", 0.0)
        if kind in (LineKind.WHITE_LEFT, LineKind.WHITE_RIGHT) and not self.profile.white_edges:
            return 0.0
        return self.line_sensor.position(kind)

    def act(self) -> dict[str, list[int]]:
        """Motion control for this cycle; what is to be written, by name."""
        odometry, control, distances = self.odometry, self.control, self.infrared.distances
        control.velocity = odometry.velocity
        control.left_velocity, control.right_velocity = odometry.left_velocity, odometry.right_velocity
        if self._sees_obstacles:
            control.obstacle_front = self.infrared.front
        control.ir_left, control.ir_right = distances[0], distances[4]
        pool = self.symbols.pool
        for owner, attribute, place in self._acted:
            setattr(owner, attribute, pool[place])
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

    @property
    def has_speed(self) -> bool:
        """Whether the speeds that are written are not all 0."""
        return any(self._words[name][0] for name in self._written)

    def _write_speeds(self, left: float, right: float, omega: float) -> None:
        conf, alike = self.conf, self.profile.outputs_round_alike
        first, second = left * conf.left_speed_scale, right * conf.right_speed_scale
        if conf.drive is DriveKind.VELOMEGA:
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
        if self.conf.drive is not DriveKind.DIFFERENTIAL or self.conf.name != "smr":
            return False
        return self._has_ir or not self.profile.sees_without_ir

    # -- what the script changes ------------------------------------------------------------------

    def set_results(self, *values: float) -> None:
        """Set ``$res0`` and those behind it."""
        for number, value in enumerate(values):
            self.symbols.pool[self._results + 3 * number] = value

    def set_output(self, name: str, index: int, value: float) -> bool:
        """Write ``(value + offset) * gain`` to a variable of the robot, rounded. False if it has no such one."""
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
        path = _INPUTS.get((module, function, name))
        if path is None:
            return False
        self._routes[path] = place
        inputs: tuple[list[tuple[object, str, int]], ...] = [], []
        for (is_sensed, owner, attribute), where in self._routes.items():
            inputs[not is_sensed].append((attrgetter(owner)(self) if owner else self, attribute, where))
        self._sensed, self._acted = inputs
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
            BadValue: a name that is not one of them.
        """
        for name, value in values.items():
            name = name.removeprefix("$")
            if name not in _PLACES:
                raise BadValue(f"${name} is no built-in system variable")
            self.external[name] = float(value)
            self._has_more = True

    def see_line(self, values: Sequence[float]) -> None:
        """Take the line from a user's program instead of the robot: of each sensor 0 for black, 1 for white.

        Raises:
            BadValue: they are not as many as there are sensors.
        """
        if len(values) != self.line_sensor.size:
            raise BadValue(f"{len(values)} values for {self.line_sensor.size} line sensors")
        self._has_raw_line, self._has_line = False, True
        self.line_sensor.see([float(value) for value in values])

    def see_distances(self, distances: Sequence[float]) -> None:
        """Take infrared distances from a user's program, m: left, front left, front middle, front right, right.

        Raises:
            BadValue: they are not five.
        """
        if len(distances) != 5:
            raise BadValue(f"{len(distances)} distances; expected 5, from the left to the right")
        self._has_raw_ir, self._has_ir = False, True
        self.infrared.distances[:5] = [float(distance) for distance in distances]

    def kalman_pose(self) -> Pose:
        """The pose of a filter outside, where there is one."""
        return Pose(*(self.external.get(name, 0.0) for name in ("xkalman", "ykalman", "thkalman")))

    def estimated_pose(self) -> Pose:
        """The pose that motions go by: of the odometry, or of a filter."""
        return self.kalman_pose() if self.uses_kalman else self.odometry.pose.copy()

    @property
    def is_told_to_stop(self) -> bool:
        """Whether the input `stop` of `mrccontrol` is not 0."""
        return self.stop_input != 0.0

    def reset_motors(self) -> None:
        """Write the variables that reset the motors, where the robot has them."""
        for name in ("resetmotorr", "resetmotorl"):
            if name in self._words:
                self._changed[name] = self._words[name]


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

#: Inputs of control functions: whether they are taken before the script, and where they go: owner, attribute.
_INPUTS: Mapping[tuple[str, str, str], tuple[bool, str, str]] = {
    ("mrc", "odoconnect", "dth"): (True, "", "heading"),
    ("mrc", "odoconnect", "steeringangle"): (True, "", "steering_angle"),
    ("mrc", "motionconnect", "w2odox"): (True, "control.world", "x"),
    ("mrc", "motionconnect", "w2odoy"): (True, "control.world", "y"),
    ("mrc", "motionconnect", "w2odoth"): (True, "control.world", "th"),
    ("mrc", "motionconnect", "obstaclefront"): (False, "control", "obstacle_front"),
    ("mrc", "motionconnect", "obstacleback"): (False, "control", "obstacle_back"),
    ("mrc", "mrccontrol", "stop"): (False, "", "stop_input"),
    ("motioncontrol", "followwall", "distl"): (False, "control", "ir_left"),
    ("motioncontrol", "followwall", "distr"): (False, "control", "ir_right"),
    ("motioncontrol", "followwall", "anglel"): (False, "control", "wall_angle_left"),
    ("motioncontrol", "followwall", "angler"): (False, "control", "wall_angle_right"),
    ("motioncontrol", "drive", "refx"): (False, "control.reference", "x"),
    ("motioncontrol", "drive", "refy"): (False, "control.reference", "y"),
    ("motioncontrol", "drive", "refth"): (False, "control.reference", "th"),
}
_FUNCTIONS: Mapping[str, frozenset[str]] = {
    "motioncontrol": frozenset(("followwall", "drivetopoint", "drive", "movetoxyz")),
    "mrc": frozenset(("odoconnect", "motionconnect", "mrccontrol")),
}


def _truncated(value: float) -> int:
    return 0 if value != value else int(max(_INT_MIN, min(_INT_MAX, value)))


def _floored(value: float) -> int:
    # MRC rounds by floor(value + 0.5): halves upward.
    return 0 if value != value else int(max(_INT_MIN, min(_INT_MAX, value + 0.5)) // 1)
