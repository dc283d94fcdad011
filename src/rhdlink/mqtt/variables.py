"""The variables of a robot over MQTT: each number of each topic, with its unit.

The names and units come from the headers of the robot's own logs, unless the description says otherwise. Numbers count
steps of 1e-6, so that a mission can use them and the decimals of a payload are kept.
"""

from __future__ import annotations

from ..variables.declarations import Declarations, Read, Write
from ..variables.value_types import Bool, Int32, Millionths, Scaled, Text

#: Value of one step of a fixed-point variable.
STEP = 1e-6
#: Counts of `transpos` per m and of `rotpos` per rad; `cmdtransvel` and `cmdrotvel` have the same scales.
LINEAR_SCALE, ANGULAR_SCALE = 1e5, 4e4
#: Maximum lengths of texts, in bytes of UTF-8. Longer texts are cut.
INFO_SIZE, NAME_SIZE, COMMAND_SIZE = 128, 32, 128

_METRES, _SPEED = Scaled(STEP, unit="m"), Scaled(STEP, unit="m/s")
_ANGLE, _TURN_RATE = Scaled(STEP, unit="rad"), Scaled(STEP, unit="rad/s")
_VOLTS, _AMPERES = Scaled(STEP, unit="V"), Scaled(STEP, unit="A")
_PLAIN = Scaled(STEP)


class RobobotVariables(Declarations):
    """The variables of a robot over MQTT. Variables of topics that the robot does not publish stay 0.

    The time stamp of a read variable is the time of the Raspberry Pi in the message.
    """

    cmdtransvel = Write(Scaled(1 / LINEAR_SCALE, unit="m/s"), doc="forward speed (command rc)")
    cmdrotvel = Write(Scaled(1 / ANGULAR_SCALE, unit="rad/s"), doc="turn rate, positive to the left (command rc)")
    teensy = Write(
        Text(COMMAND_SIZE), doc="a command to the Teensy, such as 'leds 16 0 0 30'; sent each time it is set"
    )
    interfacelog = Write(Bool, doc="whether the robot's program writes its own logs (command log)")

    transpos = Read(Int32, unit="1e-5 m", doc="travelled distance, computed from the pose or the wheel speeds")
    rotpos = Read(Scaled(1 / ANGULAR_SCALE, unit="rad"), doc="heading, not wrapped, computed like transpos")
    linesensor = Read(Int32, 8, doc="livn in the order of MRC, the leftmost sensor last")

    posetime = Read(Millionths, unit="s", doc="time of the Teensy in the newest pose")
    posex = Read(_METRES, doc="x of the robot's own odometry")
    posey = Read(_METRES, doc="y of the robot's own odometry")
    heading = Read(_ANGLE, doc="heading of the robot's own odometry, wrapped")
    tilt = Read(_ANGLE, doc="tilt, if the robot computes it")
    veltime = Read(Millionths, unit="s", doc="time of the Teensy in the newest velocity")
    velleft = Read(_SPEED, doc="speed of the left wheel")
    velright = Read(_SPEED, doc="speed of the right wheel")
    turnrate = Read(_TURN_RATE, doc="turn rate (2025)")
    velocity = Read(_SPEED, doc="speed of the robot; in the log it equals the left wheel (2025)")
    velcount = Read(Int32, doc="last number of vel, 2 or 3; meaning unknown (2025)")
    mvel = Read(_TURN_RATE, 2, doc="speeds of the motors, left and right")
    livn = Read(Int32, 8, doc="line sensors, sensor 0 at the left: 0 no reflection, 1000 calibrated white")
    livnextra = Read(Int32, doc="ninth number of livn; meaning unknown (2025)")
    liv = Read(Int32, 8, doc="raw values of the line sensors, on request")
    liw = Read(Int32, 8, doc="white levels of the line sensors, on request")
    dist = Read(_METRES, 2, doc="infrared distances (topics dist, ir and ird)")
    gyro = Read(Scaled(STEP, unit="deg/s"), 3, doc="turn rates (unit assumed)")
    acc = Read(Scaled(STEP, unit="g"), 3, doc="accelerations (unit assumed)")
    mot = Read(_PLAIN, 5, doc="state of the motors; the first two are voltages in V (assumed), the others are unknown")
    current = Read(_AMPERES, 2, doc="currents of the motors, left and right")
    hbtindex = Read(Int32, doc="number of the robot")
    hbtversion = Read(Int32, doc="version of the Teensy's program")
    hbtstate = Read(Int32, doc="state; 0 if the control is external to the Teensy")
    hbtvoltage = Read(_VOLTS, doc="voltage of the battery")
    hbtload = Read(Scaled(STEP, unit="%"), doc="load of the Teensy")
    hbtsupply = Read(_AMPERES, doc="supply current of the board")
    hbtused = Read(Scaled(STEP, unit="Wh"), doc="used capacity of the battery")
    hbtshutdown = Read(Int32, doc="shutdown request")
    hbtcpu = Read(Scaled(STEP, unit="degC"), doc="temperature of the CPU")
    confradius = Read(_METRES, 2, doc="radii of the wheels, left and right, on request")
    confgear = Read(_PLAIN, doc="gear ratio, on request")
    confpulses = Read(Int32, doc="pulses of an encoder for a turn of the motor, on request")
    confbase = Read(_METRES, doc="distance between the wheels, on request")
    confsample = Read(Scaled(STEP, unit="s"), doc="sample time, on request")
    confreversed = Read(Int32, doc="1 if the encoders are reversed, on request")
    dname = Read(Text(NAME_SIZE), doc="name of the robot")
    info = Read(Text(INFO_SIZE), doc="newest text of the Teensy")
    master = Read(Text(NAME_SIZE), doc="ID of the master that the robot obeys")
