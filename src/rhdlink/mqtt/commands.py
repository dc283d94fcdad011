"""The commands to a robot, in the two dialects that robots understand.

A command has a target, a keyword and arguments. The target "ti" is the program on the Raspberry Pi, and "T0" is the
Teensy. A robot of 2025 has the keyword in the topic, and a robot of 2026 has it in the payload.

==========  =============================  ==========================  ==================================
dialect     topic                          payload                     evidence
==========  =============================  ==========================  ==================================
2025        ``robobot/cmd/ti/rc``          ``0.1 0.5``                 log of a robot, 2025-01-31
2026        ``robobot/cmd/ti``             ``rc 0.1 0.5``              source of both ends, as used in 2026
==========  =============================  ==========================  ==================================

==========  ==============================================  =========================  ==========
command     arguments                                       call                       evidence
==========  ==============================================  =========================  ==========
ti rc       m/s, rad/s to the left; the time is optional    `velocity`                 log, 2026
ti alive    ID of the master                                `alive`                    log, 2026
ti log      1 or 0                                          `interface_log`            log, 2026
T0 confw    radii in m, gear, pulses, wheel base in m       `configure`                log, 2026
T0 confi    none; requests the topic ``conf``               ``teensy("confi")``        log, 2026
T0 enc0     none; the pose becomes 0                        ``teensy("enc0")``         log, 2026
T0 encrev   1 or 0                                          ``teensy("encrev 1")``     log
T0 lip      1 or 0; the line sensor; more in 2025           ``teensy("lip 1")``        log, 2026
T0 liwi     none; requests the topic ``liw``                ``teensy("liwi")``         log, 2026
T0 licw     number of samples; calibrates white             ``teensy("licw 100")``     2026
T0 eew      none; saves the calibration                     ``teensy("eew")``          2026
T0 sub      topic and interval in ms                        ``teensy("sub livn 10")``  2026
T0 leds     number, red, green, blue                        `leds`                     log, 2026
T0 stop     none                                            `stop`                     log, 2026
==========  ==============================================  =========================  ==========
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from typing import NamedTuple

from linkcore.arguments import check_number, check_whole
from linkcore.errors import BadValue

#: First part of every topic that a robot reads.
CMD = "robobot/cmd/"
#: Payload of a command without arguments; the course's client sends no empty payload.
_EMPTY = " "
_KEYWORD = re.compile(r"[a-z][a-z0-9]{0,15}")
#: Largest accepted m/s and rad/s.
FASTEST = 10.0


class Command(NamedTuple):
    """A command to a robot.

    Attributes:
        target: "ti" for the program on the Raspberry Pi, "T0" for the Teensy.
        keyword: Name of the command.
        arguments: Its arguments, separated by blanks; "" for none.
    """

    target: str
    keyword: str
    arguments: str = ""


class Dialect(NamedTuple):
    """A way to write commands as messages.

    Attributes:
        name: Name of the dialect, which is the year.
        has_keyword_in_topic: Whether the keyword is in the topic rather than in the payload.
        evidence: Source of the format.
        requests: Commands to the Teensy with which a master requests measurements that the robot does not publish
            otherwise.
    """

    name: str
    has_keyword_in_topic: bool
    evidence: str
    requests: tuple[Command, ...] = ()

    def encode(self, command: Command) -> tuple[str, str]:
        """Return the topic and the payload of a command.

        >>> DIALECTS["2026"].encode(velocity(0.1, 0.5))
        ('robobot/cmd/ti', 'rc 0.1 0.5')
        """
        if self.has_keyword_in_topic:
            return f"{CMD}{command.target}/{command.keyword}", command.arguments or _EMPTY
        return f"{CMD}{command.target}", f"{command.keyword} {command.arguments}".rstrip()

    def decode(self, topic: str, payload: bytes) -> Command | None:
        """Return the command of a message, or None if a robot of this dialect ignores it."""
        if not topic.startswith(CMD):
            return None
        target, _, last = topic[len(CMD) :].partition("/")
        text = payload.decode("ascii", "replace").strip()
        if self.has_keyword_in_topic:
            return Command(target, last, text) if last else None
        # A robot of 2026 does not use the last part of the topic.
        keyword, _, arguments = text.partition(" ")
        return Command(target, keyword, arguments.strip()) if keyword else None


#: The dialects, by name.
DIALECTS: Mapping[str, Dialect] = {
    "2025": Dialect("2025", True, "the MQTT log of a robot of 2025-01-31"),
    "2026": Dialect(
        "2026",
        False,
        "the source of both ends as used in 2026",
        # As the course's client does at its start. The robot of the log publishes livn without a request.
        (Command("T0", "lip", "1"), Command("T0", "sub", "livn 10")),
    ),
}


def find_dialect(name: str) -> Dialect:
    """Return a dialect.

    Raises:
        BadValue: If there is no dialect with this name.
    """
    if name not in DIALECTS:
        raise BadValue(f"dialect is {name!r}; expected one of {', '.join(DIALECTS)}")
    return DIALECTS[name]


def new_identity() -> str:
    """Return the ID of a master that starts now: its date and time, as in ``2025-01-31 14:59:47.699507``."""
    return datetime.now().isoformat(sep=" ", timespec="microseconds")


def velocity(linear: float, angular: float, *, time: float | None = None) -> Command:
    """Drive with `linear` m/s and `angular` rad/s.

    Args:
        linear: Forward speed, -10 to 10 m/s.
        angular: Turn rate, -10 to 10 rad/s, positive to the left.
        time: Wall time that is appended, in s. The speeds then have three decimals, as in the course's line follower.

    Raises:
        BadValue: If a number is not valid.
    """
    check_number(linear, "linear", -FASTEST, FASTEST, "m/s")
    check_number(angular, "angular", -FASTEST, FASTEST, "rad/s")
    if time is None:
        return Command("ti", "rc", f"{linear} {angular}")
    return Command("ti", "rc", f"{linear:.3f} {angular:.3f} {time}")


#: Command for the speed zero, exactly as the course's client sends it at the end.
STANDSTILL = velocity(0, 0)


def alive(identity: str) -> Command:
    """Report that the master with this ID is alive."""
    return Command("ti", "alive", identity)


def interface_log(on: bool) -> Command:
    """Start or end the logs of the robot's own program."""
    return Command("ti", "log", str(int(on)))


def stop() -> Command:
    """Stop the motors."""
    return Command("T0", "stop")


def leds(number: int, red: int, green: int, blue: int) -> Command:
    """Set the colour of a light, each part 0 to 255.

    Raises:
        BadValue: If a number is not valid.
    """
    check_whole(number, "number", 0, 255)
    for name, part in (("red", red), ("green", green), ("blue", blue)):
        check_whole(part, name, 0, 255)
    return Command("T0", "leds", f"{number} {red} {green} {blue}")


def configure(left: float, right: float, gear: float, pulses: int, base: float) -> Command:
    """Set the radii of the wheels in m, the gear, the pulses for a turn of the motor, and the wheel base in m."""
    return Command("T0", "confw", f"{left} {right} {gear} {pulses} {base}")


def teensy(text: str) -> Command:
    """Return any command to the Teensy.

    Raises:
        BadValue: If the text is not a keyword with arguments in printable ASCII.

    >>> teensy("leds 16 0 0 30")
    Command(target='T0', keyword='leds', arguments='16 0 0 30')
    """
    keyword, _, arguments = text.strip().partition(" ")
    if not _KEYWORD.fullmatch(keyword) or not (arguments.isascii() and (arguments + " ").isprintable()):
        raise BadValue(f"{text!r} is not a command to the Teensy; expected a keyword and arguments, as in 'lip 1'")
    return Command("T0", keyword, arguments.strip())
