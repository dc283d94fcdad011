"""`urlink jog`: moves the arm with the keys of a terminal."""

from __future__ import annotations

import argparse
from typing import get_args

from linkcore.cli.console import Reader, keys
from linkcore.cli.options import argument, command, seconds
from linkcore.cli.terminal import Interruption

from ..motion.servo.jog import FULL_SPEED, FrameName, Jog
from ..robot import Robot
from .options import ADDRESS, LIMITS, connected
from .packet_fields import joints_text

#: Keys that move the six axes forward, and keys that move them backward.
_FORWARD, _BACKWARD = b"123456", b"qwerty"
#: Smallest fraction of full speed, and factor by which the keys + and - change the speed.
_SLOWEST, _FACTOR = 0.01, 1.5
#: Bytes that end the command: x, Ctrl-C if the terminal sends it as a byte, Ctrl-D.
_END = b"x\x03\x04"


def _part(text: str) -> float:
    try:
        part = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not _SLOWEST <= part <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is out of range; expected {_SLOWEST:g} to 1")
    return part


def _hold(text: str) -> float:
    if not 0.05 <= seconds(text) <= 10.0:
        raise argparse.ArgumentTypeError(f"{text} s is out of range; expected 0.05 to 10 s")
    return seconds(text)


@command(
    "jog",
    "move the arm with the keys of a terminal",
    *ADDRESS,
    LIMITS,
    argument("--frame", choices=get_args(FrameName), default="joints", help="initial frame (default: joints)"),
    argument("--speed", type=_part, default=0.2, metavar="PART", help="part of full speed, 0.01 to 1 (default: 0.2)"),
    argument("--hold", type=_hold, default=0.6, metavar="S", help="move for S seconds after each key (default: 0.6)"),
)
def run(args: argparse.Namespace) -> int:
    """Move the arm with the keys of a terminal. THE ARM MOVES while a key is held, and brakes when it is released.

      1 2 3 4 5 6   move joints 1 to 6 forward; in a tool frame: along x, y, z and about x, y, z
      q w e r t y   move backward
      f             change from joints to the base frame, to the tool frame, and to joints again
      + -           move faster, slower
      space         brake
      x, Ctrl-C     end

    While you hold a key, the terminal repeats the key, after a pause before the first repetition. --hold sets how long
    the arm moves after each key. If --hold is shorter than the pause, the arm stutters at first.

    examples:
      urlink jog 192.168.56.101
      urlink jog sim:// --frame tool --speed 0.2
      urlink jog 192.168.56.101 --speed 0.05 --hold 1
    """
    with (
        keys() as read,
        Interruption() as interruption,
        connected(args) as robot,
    ):
        hand = _Hand(robot, args.frame, args.speed, args.hold)
        while hand.goes_on and interruption.number is None:
            hand.use(read, interruption)
        print(joints_text(robot.realtime.wait().q_actual), flush=True)
    return interruption.status


class _Hand:
    """Frame and speed that the user has selected with the keys."""

    def __init__(self, robot: Robot, frame: FrameName, part: float, hold: float) -> None:
        self.goes_on = True
        self._robot = robot
        self._frame: FrameName = frame
        self._part = part
        self._hold = hold

    def use(self, read: Reader, interruption: Interruption) -> None:
        """Move in one frame, until a key selects another frame or ends the command."""
        frame = self._frame
        with self._robot.motion.jog(frame, timeout=self._hold, watchdog=self._hold) as jog:
            self._tell()
            while self.goes_on and self._frame == frame and interruption.number is None:
                pressed = read(0.05)
                if pressed is not None:
                    for key in pressed or _END[:1]:
                        self._press(jog, bytes([key]))
                elif jog.done:
                    jog.wait(0.0)

    def _press(self, jog: Jog, key: bytes) -> None:
        if key in _END:
            self.goes_on = False
        elif key in _FORWARD or key in _BACKWARD:
            which = max(_FORWARD.find(key), _BACKWARD.find(key))
            speeds = [0.0] * 6
            speeds[which] = FULL_SPEED[self._frame][which] * self._part * (1.0 if key in _FORWARD else -1.0)
            jog.move(speeds)
        elif key == b" ":
            jog.stop()
        elif key in b"+-":
            factor = _FACTOR if key == b"+" else 1.0 / _FACTOR
            self._part = min(max(self._part * factor, _SLOWEST), 1.0)
            self._tell()
        elif key == b"f":
            names = get_args(FrameName)
            self._frame = names[(names.index(self._frame) + 1) % len(names)]

    def _tell(self) -> None:
        unit = "rad/s" if self._frame == "joints" else "m/s"
        print(f"{self._frame}: {FULL_SPEED[self._frame][0] * self._part:.3f} {unit}", flush=True)
