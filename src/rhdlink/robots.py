"""Ready-made classes for the robots of docs/protocols/rhd.md, Names of variables.

Scales and units are taken from the drivers of the original. A variable is optional if some robots of a kind do not have
it. If such a variable is missing, its use raises `NotThere`. To declare more variables, or to change declarations,
derive a class.
"""

from __future__ import annotations

from .client import Variables
from .mqtt.variables import RobobotVariables
from .variables.declarations import Read, Write
from .variables.value_types import Int32, Millionths, Scaled

__all__ = ["Ackerman", "Gps", "Robobot", "Smr", "VelocityOmega"]


class Smr(Variables):
    """Small mobile robot (SMR) with two driven wheels."""

    tick = Read(Int32, doc="number of ticks of the server")
    encl = Read(
        Int32, unit="ticks", doc="left wheel, forward counts up; wraps at 16 bits: take differences modulo 65536"
    )
    encr = Read(Int32, unit="ticks", doc="right wheel; see encl")
    speedl = Write(Int32, unit="cm/s", doc="left wheel, -127 to 127")
    speedr = Write(Int32, unit="cm/s", doc="right wheel, -127 to 127")
    resetmotorl = Write(Int32, doc="any value resets the left motor module", optional=True)
    resetmotorr = Write(Int32, doc="any value resets the right motor module", optional=True)
    linesensor = Read(Int32, 8, doc="reflectance, raw, 0 to 255", optional=True)
    irsensor = Read(Int32, 6, doc="distance, raw: left, front left, front middle, front right, right", optional=True)
    gyro = Read(Int32, 3, doc="raw", optional=True)
    gyrotemp = Read(Int32, 3, doc="raw", optional=True)
    motorstatusl = Read(Int32, doc="status of the left motor module", optional=True)
    motorstatusr = Read(Int32, doc="status of the right motor module", optional=True)
    digital = Read(Int32, 6, doc="inputs of the power module", optional=True)
    analog = Read(Int32, 5, doc="inputs of the power module; the first is the battery", optional=True)
    simtime = Read(Millionths, unit="s", doc="time of a simulator", optional=True)
    steeringangleref = Write(Int32, doc="steering angle, on the ackerman variant", optional=True)


class VelocityOmega(Variables):
    """Robot that is commanded with a speed and a turn rate, such as the iRobot ATRV-Jr."""

    tick = Read(Int32, doc="number of ticks of the server", optional=True)
    cmdtransvel = Write(Scaled(1e-5, unit="m/s"), doc="forward speed")
    cmdrotvel = Write(Scaled(1 / 40000, unit="rad/s"), doc="turn rate, counter-clockwise")
    transpos = Read(Int32, unit="counts", doc="travelled distance; the length of a count depends on the robot")
    rotpos = Read(Scaled(1 / 40000, unit="rad"), doc="heading, counter-clockwise")
    cmdtransaccl = Write(Int32, doc="rflex units", optional=True)
    cmdtranstorque = Write(Int32, doc="rflex units", optional=True)
    cmdrotaccl = Write(Int32, doc="rflex units", optional=True)
    cmdrottorque = Write(Int32, doc="rflex units", optional=True)
    cmdbrake = Write(Int32, optional=True)
    bumperbrake = Write(Int32, optional=True)
    usesonar = Write(Int32, optional=True)
    transvel = Read(Int32, doc="rflex units", optional=True)
    rotvel = Read(Int32, doc="rflex units", optional=True)
    transaccl = Read(Int32, doc="rflex units", optional=True)
    rotaccl = Read(Int32, doc="rflex units", optional=True)
    transtorque = Read(Int32, doc="rflex units", optional=True)
    rottorque = Read(Int32, doc="rflex units", optional=True)
    sonar = Read(Int32, 17, optional=True)
    bumper = Read(Int32, 2, optional=True)
    brake = Read(Int32, optional=True)
    battvoltage = Read(Int32, optional=True)
    errcnt = Read(Int32, optional=True)


class Robobot(RobobotVariables, Variables):
    """A robot of DTU with MQTT, such as the robobot; see `RobobotVariables` for its variables."""


class Ackerman(Variables):
    """Robot that steers like a car, such as the Hako tractor."""

    tick = Read(Int32, doc="number of ticks of the server", optional=True)
    steeringangleref = Write(Scaled(3.141592653589793 / 1800, unit="rad"), doc="steering angle")
    speedref = Write(Int32, doc="speed; the unit depends on the robot", optional=True)
    curvatureref = Write(Int32, optional=True)
    enginespeedref = Write(Int32, optional=True)
    hakomanual = Write(Int32, optional=True)
    liftinggearstateref = Write(Int32, optional=True)
    hakosteeringangle = Read(Scaled(3.141592653589793 / 1800, unit="rad"), doc="steering angle", optional=True)
    hakoodopulses = Read(Int32, optional=True)
    hakoodopulses1 = Read(Int32, optional=True)
    curvature = Read(Int32, optional=True)
    liftinggearpos = Read(Int32, optional=True)


class Gps(Variables):
    """Robot with the GPS plugin.

    Names are spelled as in the plugin. The plugin states no units; the units here are the units of NMEA.
    """

    GPSeasting = Read(Millionths, unit="m", doc="UTM")
    GPSnorthing = Read(Millionths, unit="m", doc="UTM")
    GPSdop = Read(Millionths, doc="dilution of precision", optional=True)
    GPSheading = Read(Millionths, optional=True)
    GPSspeed = Read(Millionths, optional=True)
    GPSlattitude = Read(Millionths, optional=True)
    GPSlongitude = Read(Millionths, optional=True)
    GPSaltitude = Read(Millionths, optional=True)
    GPSheigth = Read(Millionths, optional=True)
    GPStimeofday = Read(Millionths, optional=True)
    GPSquality = Read(Int32, optional=True)
    GPSsatused = Read(Int32, doc="satellites in use", optional=True)
    GPSutmzone = Read(Int32, optional=True)
    GPSfixvalid = Read(Int32, optional=True)
    GPSdate = Read(Int32, 3, optional=True)
    GPStime = Read(Int32, 4, optional=True)
    GPSsetutmzone = Write(Int32, optional=True)
