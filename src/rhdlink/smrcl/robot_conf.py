"""What MRC knows of a robot: its kind, its scales and its gains, as `robot.conf` has them.

Defaults are MRC's own without a file, except where it has none.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from .motion.control import Drive, MotionParameters

__all__ = ["SMR", "VELOMEGA", "RobotConf", "Route", "Scale", "Setting"]


@dataclass(frozen=True)
class Scale:
    """Offset and gain of a variable of the robot (``<varscale>``): its value is ``(raw + offset) * gain``.

    Attributes:
        variable: its name, with an index where it is not the first value: ``"adc[2]"``.
    """

    variable: str
    offset: float = 0.0
    gain: float = 1.0


@dataclass(frozen=True)
class Route:
    """An input of a control function that comes from a system variable (``<routeinput>``)."""

    module: str
    function: str
    parameter: str
    variable: str


@dataclass(frozen=True)
class Setting:
    """A parameter of a control function (``<setpar>``)."""

    module: str
    function: str
    parameter: str
    value: float


@dataclass(frozen=True)
class RobotConf:
    """What MRC knows of a robot.

    Attributes:
        drive: how it is driven.
        name: only "smr" is special: its infrared sensors slow it down before obstacles.
        left_scale, right_scale: m per count of the counters. A velocity-omega robot has one counter, the left one, and
            twice its metres.
        width: between the wheels, m, for the odometry.
        period: of a cycle, s; the robot's tick has to be the same.
        max_tick: counts in a cycle from which on a step is taken for a fault.
        heading_source: 0 for the wheels, 1 for the heading counter, 2 for a curvature.
        is_rate: the heading is a rate.
        is_relative: the counters are relative.
        heading_gain: rad per count of the heading counter.
        motion: gains and limits of motion control.
        speed, acceleration: m/s and m/s2, until ``@v`` and ``@a``.
        left_speed_scale, right_speed_scale: counts per m/s of the written speeds; the right one of a velocity-omega
            robot is per rad/s.
        line_size: line sensors.
        line_smoothing: part of their value before that is kept in each cycle.
        line_white, line_black: their raw values on white and on black; None for uncalibrated ones, which read 0.
        ir_k1, ir_k2: of the infrared sensors.
        scales, routes, settings: as the file has them.
    """

    drive: Drive = Drive.DIFFERENTIAL
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
    routes: tuple[Route, ...] = ()
    settings: tuple[Setting, ...] = ()


def _usual_motion() -> MotionParameters:
    """The gains that DTU's robots are shipped with."""
    return MotionParameters(drive_kdist=4.8, drive_kangle=2.25, line_tau=10.0, wall_tau=0.7)


#: An SMR with encoders of 32 bits.
SMR = RobotConf(
    left_scale=0.00010245, right_scale=0.00010245, max_tick=1000.0, acceleration=0.3, motion=_usual_motion()
)
#: A velocity-omega robot whose counters tell 10 um and rad / 40000, as the turtle.
VELOMEGA = RobotConf(
    drive=Drive.VELOMEGA,
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
