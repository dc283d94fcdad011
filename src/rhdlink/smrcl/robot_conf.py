"""Configuration of a robot for MRC, as in `robot.conf`: kind of drive, scales and gains.

The defaults are those of MRC without a file, if MRC has defaults. Elements are found anywhere in the file. Elements for
hardware that this library does not support (``<filter>``, ``<gpsmouse>``, ...) are ignored.
"""

from __future__ import annotations

import logging
import math
import os
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..host.config import LARGEST, BadConfiguration, Element, parse_xml
from ..mqtt.variables import RobobotVariables
from ..variables.value_types import Scaled
from .motion.control import DriveKind, MotionParameters

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Scale:
    """Offset and gain of a variable of the robot (``<varscale>``).

    The value of the variable is ``(raw + offset) * gain``.

    Attributes:
        variable: Name of the variable, with an index if it is not the first value: ``"adc[2]"``.
    """

    variable: str
    offset: float = 0.0
    gain: float = 1.0


@dataclass(frozen=True)
class InputRoute:
    """Route from a system variable to an input of a control function (``<routeinput>``)."""

    module: str
    function: str
    parameter: str
    variable: str


@dataclass(frozen=True)
class Setting:
    """Value of a parameter of a control function (``<setpar>``)."""

    module: str
    function: str
    parameter: str
    value: float


@dataclass(frozen=True)
class RobotConf:
    """Configuration of a robot for MRC.

    Attributes:
        drive: Kind of drive.
        name: Name of the robot. Only "smr" has an effect: its infrared sensors slow it down before obstacles.
        left_scale, right_scale: Scales of the counters, in m per count. A velocity-omega robot has only the left
            counter; its scale must be twice the real m per count.
        width: Distance between the wheels for the odometry, in m.
        period: Duration of a cycle, in s. The robot's tick must have the same duration.
        max_tick: Number of counts in a cycle from which a step counts as a fault.
        heading_source: 0 for the wheels, 1 for the heading counter, 2 for a curvature.
        is_rate: Whether the heading is a rate.
        is_relative: Whether the counters are relative.
        heading_gain: rad per count of the heading counter.
        motion: Gains and limits of motion control.
        speed, acceleration: Initial values in m/s and m/s2, until ``@v`` and ``@a``.
        left_speed_scale, right_speed_scale: Counts per m/s of the written speeds. For a velocity-omega robot, the right
            scale is per rad/s.
        line_size: Number of line sensors.
        line_smoothing: Part of the previous value of a line sensor that is kept in each cycle.
        line_white, line_black: Raw values of the line sensors on white and on black; None for uncalibrated sensors,
            which read 0.
        ir_k1, ir_k2: Calibration of the infrared sensors.
        scales, routes, settings: Entries of the file.
    """

    drive: DriveKind = DriveKind.DIFFERENTIAL
    name: str = "smr"
    left_scale: float = 0.00010257
    right_scale: float = 0.00010257
    width: float = 0.26
    period: float = 0.01
    max_tick: float = 130.0
    heading_source: int = 0
    is_rate: bool = False
    is_relative: bool = False
    heading_gain: float = 1 / 40000.0
    motion: MotionParameters = field(default_factory=MotionParameters)
    speed: float = 0.3
    acceleration: float = 0.6
    left_speed_scale: float = 100.0
    right_speed_scale: float = 100.0
    line_size: int = 8
    line_smoothing: float = 0.8
    line_white: tuple[float, ...] | None = None
    line_black: tuple[float, ...] | None = None
    ir_k1: tuple[float, ...] = (16.0,) * 6
    ir_k2: tuple[float, ...] = (76.0,) * 6
    scales: tuple[Scale, ...] = ()
    routes: tuple[InputRoute, ...] = ()
    settings: tuple[Setting, ...] = ()

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the read variables that the odometry of such a robot needs."""
        return ("transpos", "rotpos") if self.drive is DriveKind.VELOMEGA else ("encl", "encr")

    @property
    def writes(self) -> tuple[str, ...]:
        """Names of the write variables that set the speeds of such a robot."""
        return ("cmdtransvel", "cmdrotvel") if self.drive is DriveKind.VELOMEGA else ("speedl", "speedr")


def _usual_motion() -> MotionParameters:
    """Return the gains that DTU's robots have when they are delivered."""
    return MotionParameters(drive_kdist=4.8, drive_kangle=2.25, line_tau=10.0, wall_tau=0.7)


#: Configuration of an SMR with 32-bit encoders.
SMR = RobotConf(
    left_scale=0.00010245, right_scale=0.00010245, max_tick=1000.0, acceleration=0.3, motion=_usual_motion()
)
#: Configuration of a velocity-omega robot with counters in 10 um and rad / 40000, such as the turtle.
VELOMEGA = RobotConf(
    drive=DriveKind.VELOMEGA,
    name="turtle",
    left_scale=0.00002,
    right_scale=0.0,
    max_tick=10000.0,
    heading_source=1,
    acceleration=0.3,
    left_speed_scale=100000.0,
    right_speed_scale=40000.0,
    motion=_usual_motion(),
)
#: A robot of DTU with MQTT. Line sensors are normalised to 0 without reflection and 1000 on white tape, and all numbers
#: are in the units of `RobobotVariables`, for example ``$dist`` in m.
ROBOBOT = replace(
    VELOMEGA,
    name="robobot",
    line_white=(1000.0,) * 8,
    line_black=(0.0,) * 8,
    scales=tuple(
        Scale(f"{each.name}[{number}]", gain=each.type.scale)
        for each in RobobotVariables.declared().values()
        if isinstance(each.type, Scaled) and each.name not in (*VELOMEGA.reads, *VELOMEGA.writes)
        for number in range(each.count)
    ),
)


def read_robot_conf(path: str | os.PathLike[str], *, calibration: str | None = None, robot: str = "") -> RobotConf:
    """Read the configuration in a `robot.conf`, and the calibrations next to it.

    MRC names calibrations after the computer on which it runs, which is the robot: ``<name>_demo_odo_calib.dat``,
    ``<name>_demo_ls_calib.dat``, ``<name>_demo_ir_calib.dat``. Missing calibrations are logged as a warning, with the
    names of the calibrations that were found.

    Args:
        path: Path of the file, or of its folder, usually `calib/`. In a folder, calibrations and `wdssparam.dat` are
            read too.
        calibration: Name in the file names of the calibrations. If given, at least one of the files must exist, even if
            `path` is the file. The default is the name of `robot`, or otherwise of this computer.
        robot: Host name of the robot, with or without its domain.

    Raises:
        BadConfiguration: If the file cannot be read or contains an invalid value, or there is no calibration with the
            given name.
    """
    place = Path(path)
    if not place.is_dir():
        conf = parse_robot_conf(_read(place), place.name)
        return conf if calibration is None else _calibrated(conf, place.parent, calibration)
    conf = parse_robot_conf(_read(place / "robot.conf"), "robot.conf")
    if (table := place / "wdssparam.dat").is_file():
        found = _numbers(table, None)
        rows = tuple(zip(found[::3], found[1::3], found[2::3], strict=False))
        conf = replace(conf, motion=replace(conf.motion, wall_table=rows))
    if calibration is not None:
        return _calibrated(conf, place, calibration)
    names = (robot, robot.partition(".")[0], platform.node())
    name = next((each for each in names if each and any(_calibrations(place, each))), names[-1])
    return _calibrated(conf, place, name, is_needed=False)


#: Part of the file name of a calibration -> sensors that it calibrates.
_KINDS = {"odo": "odometry", "ls": "line sensors", "ir": "infrared sensors"}


def _calibrations(folder: Path, name: str) -> list[str]:
    """Return the kinds of calibrations that exist for a name."""
    return [kind for kind in _KINDS if (folder / f"{name}_demo_{kind}_calib.dat").is_file()]


def _calibrated(conf: RobotConf, folder: Path, name: str, *, is_needed: bool = True) -> RobotConf:
    there = _calibrations(folder, name)
    lacking = [kind for kind in _KINDS if kind not in there]
    if lacking:
        files = ", ".join(f"{name}_demo_{kind}_calib.dat" for kind in lacking)
        text = f"{folder}: {', '.join(_KINDS[kind] for kind in lacking)} not calibrated: there is no {files}"
        others = {each.name.partition("_demo_")[0] for each in folder.glob("*_demo_*_calib.dat")} - {name}
        if others:
            text += f"; there are calibrations of {', '.join(sorted(others))}, which you can select with `calibration`"
        if is_needed and not there:
            raise BadConfiguration(text)
        _log.warning("%s", text)
    odometry, line, infrared = (folder / f"{name}_demo_{kind}_calib.dat" for kind in _KINDS)
    if "odo" in there:
        width, ratio, mean = _numbers(odometry, 3)
        if not (width > 0.0 and ratio > 0.0 and mean > 0.0):
            raise BadConfiguration(f"{odometry.name}: width, ratio and mean have to be above 0")
        conf = replace(conf, width=width, right_scale=2 * ratio / (1 + ratio) * mean, left_scale=2 / (1 + ratio) * mean)
    if "ls" in there:
        found = _numbers(line, 2 * conf.line_size)
        conf = replace(conf, line_white=found[: conf.line_size], line_black=found[conf.line_size :])
    if "ir" in there:
        found = _numbers(infrared, 12)
        conf = replace(conf, ir_k1=found[::2], ir_k2=found[1::2])
    return conf


def parse_robot_conf(data: bytes | str, source: str = "robot.conf") -> RobotConf:
    """Parse the text of a `robot.conf`.

    Raises:
        BadConfiguration: If the text is not a `robot.conf`, or contains an invalid value.
    """
    conf = RobotConf()
    changes: dict[str, Any] = {}
    motion: dict[str, Any] = {}
    scales, routes, settings = [], [], []
    for element in _all(parse_xml(data, source)):
        if element.tag == "robotinfo":
            changes |= _robot(element)
        elif element.tag == "odometry":
            changes |= _taken(element, _ODOMETRY)
            for name, attribute in (("control", "heading_source"), ("gyrotype", "is_rate"), ("enctype", "is_relative")):
                if name in element.attributes:
                    value = element.integer(name, 0)
                    changes[attribute] = value if attribute == "heading_source" else bool(value)
        elif element.tag == "motioncontrol":
            motion |= _taken(element, _MOTION)
            changes |= _taken(element, _COMMANDS)
        elif element.tag == "motorcontrol":
            changes |= _taken(element, {"velscalel": "left_speed_scale", "velscaler": "right_speed_scale"})
        elif element.tag == "linesensor":
            changes |= _taken(element, {"k_filt": "line_smoothing"})
            changes["line_size"] = element.integer("size", conf.line_size, least=5, most=30)
        elif element.tag == "varscale":
            scales.append(Scale(_text(element, "name"), element.number("offset", 0.0), element.number("gain", 1.0)))
        elif element.tag == "routeinput":
            routes.append(InputRoute(*(_text(element, name) for name in ("module", "parlist", "par", "var"))))
        elif element.tag == "setpar":
            module, function, parameter = (_text(element, name) for name in ("module", "parlist", "par"))
            settings.append(Setting(module, function, parameter, element.number("val", 0.0)))
    return replace(
        conf,
        motion=replace(conf.motion, **motion),
        scales=tuple(scales),
        routes=tuple(routes),
        settings=tuple(settings),
        **changes,
    )


_ODOMETRY = {"cl": "left_scale", "cr": "right_scale", "w": "width", "ts": "period", "maxtick": "max_tick"}
_COMMANDS = {"velcmd": "speed", "acccmd": "acceleration"}
_MOTION = {
    "ts": "period",
    "w": "width",
    "kp": "kp",
    "gain": "gain",
    "lim": "limit",
    "stopdist": "stop_distance",
    "alarmdist": "alarm_distance",
    "drive_kdist": "drive_kdist",
    "drive_kangle": "drive_kangle",
    "line_gain": "line_gain",
    "line_tau": "line_tau",
    "nolinedist": "no_line_distance",
    "wall_gain": "wall_gain",
    "wall_tau": "wall_tau",
    "wall_alfa": "wall_alfa",
}
#: Names of values that must be above zero, because they are divisors.
_POSITIVE = frozenset(("w", "ts"))


def _all(element: Element) -> Iterator[Element]:
    yield element
    for child in element.children:
        yield from _all(child)


def _taken(element: Element, names: Mapping[str, str]) -> dict[str, float]:
    found = {attribute: element.number(name, 0.0) for name, attribute in names.items() if name in element.attributes}
    for name in _POSITIVE & names.keys() & element.attributes.keys():
        if not found[names[name]] > 0.0:
            element.reject(f"{name} has to be above 0")
    return found


def _robot(element: Element) -> dict[str, Any]:
    found: dict[str, Any] = {}
    kind = element.attributes.get("type")
    if kind is not None:
        try:
            found["drive"] = DriveKind(kind)
        except ValueError:
            element.reject(f"type={kind!r} is not supported; missions drive only differential and velomega robots")
    if "name" in element.attributes:
        found["name"] = element.attributes["name"]
    return found


def _text(element: Element, name: str) -> str:
    text = element.attributes.get(name)
    if not text:
        element.reject(f'missing {name}="..."')
    return text


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise BadConfiguration(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error


def _numbers(path: Path, count: int | None) -> tuple[float, ...]:
    """Return the numbers in a file. Text after a semicolon is ignored.

    Raises:
        BadConfiguration: If the file contains fewer than `count` numbers, or other words.
    """
    try:
        text = _read(path).decode("latin-1")
        found = tuple(float(word) for line in text.splitlines() for word in line.partition(";")[0].split())
    except ValueError as error:
        raise BadConfiguration(f"{path.name}: {error}") from error
    if not all(map(math.isfinite, found)):
        raise BadConfiguration(f"{path.name} contains a number that is not finite")
    if count is not None and len(found) < count:
        raise BadConfiguration(f"{path.name} contains {len(found)} numbers; expected {count}")
    return found if count is None else found[:count]
