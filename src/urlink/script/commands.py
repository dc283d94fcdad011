"""The commands as URScript of each firmware: those that move the arm, as the lines of a program, and those that do not.

Of those that move nothing, what is sure: the names of the output functions by generation and the numbering of digital
outputs (three public drivers), `set_payload` with a mass alone, `set_tool_voltage`, `set_flag`, `set_tcp`, `popup`,
`set_target_payload` from 5.10, and the line ``set speed`` (reports of users). What is not:

- that tool outputs of CB2 are 8 and 9 of `set_digital_out`: its masterboard has 16 bits, of which 0 to 7 are the box's;
- that analogue outputs take a fraction of their range, 0 to 1, whether they drive a current or a voltage: so the
  vendor's manual is commonly quoted, and the public drivers hand a number through unchecked;
- that `set_payload` takes a centre of gravity from 3.0 on, and `popup` a title and two flags in every generation;
- that flags go up to 31;
- that `set_gravity` is in every generation: the clients of other people send it to CB3 and e-Series.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from linkcore.errors import BadValue
from linkcore.wire.fields import Since

from ..protocol.firmware import Firmware
from .text import boolean, floats, integer, number, pose, quoted, vector

#: Bd; those of the tool's serial line.
BAUD_RATES = (9600, 19200, 38400, 57600, 115200, 1_000_000, 2_000_000, 5_000_000)

_TARGET_PAYLOAD = Since("5.10")

#: s; longer is a mistake. m/s²; another length has another unit. Chosen: a base that moves is accelerated by less.
_LONGEST_TRANSITION, _GRAVITIES = 60.0, (5.0, 15.0)
#: kg. No arm lifts it; it distinguishes kilograms from grams.
_HEAVIEST = 100.0

#: What announces a movement of a path, before its number.
_SEGMENT = "urlink: segment "


# -- what moves the arm --------------------------------------------------------------------------------


def move_joints(
    q: Sequence[float], speed: float, acceleration: float, time: float | None = None, blend: float = 0.0
) -> list[str]:
    """Move the joints to `q` (6, rad), at most so fast (rad/s, rad/s²), or in `time` seconds."""
    return [f"movej({vector(q, what='q')}, {_how(speed, acceleration, time, blend)})"]


def move_linear(
    target: Sequence[float], speed: float, acceleration: float, time: float | None = None, blend: float = 0.0
) -> list[str]:
    """Move the tool in a straight line to a pose (m, rad), at most so fast (m/s, m/s²), or in `time` seconds."""
    return [f"movel({pose(target)}, {_how(speed, acceleration, time, blend)})"]


def move_circular(
    via: Sequence[float], to: Sequence[float], speed: float, acceleration: float, blend: float = 0.0
) -> list[str]:
    """Move the tool along the circle through one pose to another (m, rad), at most so fast (m/s, m/s²)."""
    return [f"movec({pose(via, 'via')}, {pose(to, 'to')}, {_how(speed, acceleration, None, blend)})"]


def _how(speed: float, acceleration: float, time: float | None, blend: float) -> str:
    figures = f"a={number(acceleration, 'acceleration')}, v={number(speed, 'speed')}"
    if time is not None:
        figures += f", t={number(time, 'time')}"
    return f"{figures}, r={number(blend, 'blend')}" if blend else figures


def segment(index: int) -> str:
    """The `textmsg` before movement `index` of a path; after a blend it is executed as the blend begins.

    A `textmsg` takes no time. That it does not end a blend, as no statement does that takes none, is how the vendor's
    own programs look, which set outputs between blended waypoints.
    """
    return f"textmsg({quoted(f'{_SEGMENT}{index}')})"


def segment_of(text: str) -> int | None:
    """Which movement a line of text announces; None if it is another text."""
    found = re.fullmatch(rf"{_SEGMENT}(\d{{1,4}})", text)
    return int(found[1]) if found else None


def speed_joints(firmware: Firmware, qd: Sequence[float], acceleration: float, duration: float) -> list[str]:
    """Turn the joints at `qd` (6, rad/s) for `duration` seconds, then brake."""
    return _speed(firmware, "speedj", vector(qd, what="qd"), acceleration, duration, "stopj")


def speed_linear(firmware: Firmware, xd: Sequence[float], acceleration: float, duration: float) -> list[str]:
    """Move the tool at `xd` (6, m/s and rad/s) for `duration` seconds, then brake."""
    return _speed(firmware, "speedl", vector(xd, what="xd"), acceleration, duration, "stopl")


def _speed(
    firmware: Firmware, function: str, speeds: str, acceleration: float, duration: float, brake: str
) -> list[str]:
    a, t = number(acceleration, "acceleration"), number(duration, "duration")
    timed = [f"{function}({speeds}, {a}, {t})"]
    untimed = [f"{function}({speeds}, {a})", f"sleep({t})"]
    return [*(timed if takes_duration(firmware) else untimed), f"{brake}({a})"]


def takes_duration(firmware: Firmware) -> bool:
    """Whether ``speedj`` and ``speedl`` take a time.

    In 3.1 and 3.2 they do not: they return once the speed is reached, and keep it (docs/protocols/urscript.md,
    Differences).
    """
    return not (3, 1) <= firmware[:2] < (3, 3)


def interpreter_mode() -> list[str]:
    """Take statements of clients until one of them ends it."""
    return ["interpreter_mode()"]


def stop(acceleration: float) -> list[str]:
    """Brake all joints with so many rad/s²."""
    return [f"stopj({number(acceleration, 'acceleration')})"]


# -- what moves nothing --------------------------------------------------------------------------------


def secondary(*statements: str) -> str:
    """Statements as a program that runs beside the one that moves the arm, and takes no time."""
    return "\n".join(["sec urlink_command():", *(f"  {statement}" for statement in statements), "end"]) + "\n"


class DigitalBank(NamedTuple):
    """Digital inputs or outputs that are counted from 0; the one place that knows which is which bit.

    Attributes:
        name: in messages, and in the names of functions.
        size: how many there are.
        first: bit of the first in the robot state, on CB3 and e-Series.
        first_of_cb2: the same on CB2, where it is the number of the function too; None if there are none.
    """

    name: str
    size: int
    first: int
    first_of_cb2: int | None

    def bit(self, firmware: Firmware, number: int, what: str) -> int:
        """Which bit of the robot state is input or output `number`.

        Raises:
            BadValue: there is no such one.
        """
        index = int(integer(number, 0, self.size - 1, f"{self.name} digital {what}"))
        if not firmware.is_cb2:
            return self.first + index
        if self.first_of_cb2 is None:
            raise BadValue(f"firmware {firmware} has no {self.name} digital {what}s")
        return self.first_of_cb2 + index


STANDARD = DigitalBank("standard", 8, 0, 0)
CONFIGURABLE = DigitalBank("configurable", 8, 8, None)
TOOL = DigitalBank("tool", 2, 16, 8)


def digital_out(firmware: Firmware, bank: DigitalBank, number: int, on: bool) -> str:
    """Switch a digital output.

    Raises:
        BadValue: there is no such output, or `on` is neither True nor False.
    """
    bit = bank.bit(firmware, number, "output")
    value = boolean(on, f"{bank.name} digital output {number}")
    if firmware.is_cb2:
        return f"set_digital_out({bit}, {value})"
    return f"set_{bank.name}_digital_out({int(number)}, {value})"


def analog_out(firmware: Firmware, output: int, fraction: float) -> str:
    """Set analogue output 0 or 1 to a fraction of its range.

    Raises:
        BadValue: there is no such output, or the fraction is not from 0 to 1.
    """
    name = "set_analog_out" if firmware.is_cb2 else "set_standard_analog_out"
    value = number(fraction, "fraction", 0.0, 1.0)
    return f"{name}({integer(output, 0, 1, 'analogue output')}, {value})"


#: Names of the parities of the tool's serial line -> their numbers.
PARITIES = {"none": 0, "odd": 1, "even": 2}


def tool_communication(
    enabled: bool, baud_rate: int, parity: str, stop_bits: int, rx_idle_chars: float, tx_idle_chars: float
) -> str:
    """Set the serial line of the tool connector. The ranges are those of the vendor's script manual.

    Raises:
        BadValue: a value that the line cannot have.
    """
    if baud_rate not in BAUD_RATES:
        raise BadValue(f"baud_rate is {baud_rate!r}; expected one of {', '.join(map(str, BAUD_RATES))}")
    if parity not in PARITIES:
        raise BadValue(f"parity is {parity!r}; expected one of {', '.join(PARITIES)}")
    values = [
        boolean(enabled, "enabled"),
        str(baud_rate),
        str(PARITIES[parity]),
        integer(stop_bits, 1, 2, "stop_bits"),
        number(rx_idle_chars, "rx_idle_chars", 1.0, 40.0),
        number(tx_idle_chars, "tx_idle_chars", 0.0, 40.0),
    ]
    return f"set_tool_communication({', '.join(map(str, values))})"


def tool_voltage(volts: int) -> str:
    """Supply the tool with 0, 12 or 24 V.

    Raises:
        BadValue: another voltage.
    """
    if isinstance(volts, bool) or volts not in (0, 12, 24):
        raise BadValue(f"tool voltage is {volts!r}; expected 0, 12 or 24")
    return f"set_tool_voltage({int(volts)})"


def flag(index: int, on: bool) -> str:
    """Set flag 0 to 31.

    Raises:
        BadValue: there is no such flag, or `on` is neither True nor False.
    """
    return f"set_flag({integer(index, 0, 31, 'flag')}, {boolean(on, 'flag')})"


def payload(
    firmware: Firmware,
    mass: float,
    cog: Sequence[float] | None = None,
    inertia: Sequence[float] | None = None,
    transition_time: float = 0.0,
) -> str:
    """Tell what the arm carries: kg; m in the flange's frame; inertia about that: xx, yy, zz, xy, xz, yz in kg m².

    Args:
        transition_time: s over which the controller goes over to it.

    Raises:
        BadValue: a number out of range, or what this firmware cannot be set to.
    """
    weight = number(mass, "payload mass", 0.0, _HEAVIEST, "kg")
    seconds = number(transition_time, "transition_time", 0.0, _LONGEST_TRANSITION, "s")
    if transition_time and (cog is None or inertia is None):
        raise BadValue("a payload with a transition_time needs cog and inertia: the controller takes all three then")
    if cog is None and inertia is None:
        return f"set_payload({weight})"
    if firmware.is_cb2:
        raise BadValue(f"firmware {firmware} takes the mass of a payload only")
    centre = vector((0.0, 0.0, 0.0) if cog is None else cog, 3, "payload cog")
    if inertia is None:
        return f"set_payload({weight}, {centre})"
    if firmware not in _TARGET_PAYLOAD:
        raise BadValue(f"firmware {firmware} takes no inertia; that needs 5.10")
    moments = vector(inertia, 6, "payload inertia")
    return f"set_target_payload({weight}, {centre}, {moments}{f', {seconds}' if transition_time else ''})"


def gravity(acceleration: Sequence[float]) -> str:
    """Tell the acceleration of an arm at rest, (3,) m/s² in the base frame.

    Raises:
        BadValue: not three numbers, or of a length that is none of gravity.
    """
    components = floats(acceleration, 3, "gravity")
    length = math.hypot(*components)
    if not _GRAVITIES[0] <= length <= _GRAVITIES[1]:
        raise BadValue(f"gravity is {length:g} m/s² long; expected {_GRAVITIES[0]:g} to {_GRAVITIES[1]:g}")
    return f"set_gravity({vector(components, 3)})"


def tcp(offset: Sequence[float]) -> str:
    """Put the tool centre point at a pose in the flange's frame.

    Raises:
        BadValue: not six finite numbers.
    """
    return f"set_tcp({pose(offset, 'tcp')})"


def speed_slider(fraction: float) -> str:
    """The line that moves the speed slider; no function, so it stands alone.

    Raises:
        BadValue: not from 0 to 1.
    """
    return f"set speed {number(fraction, 'speed slider', 0.0, 1.0)}\n"


def popup(text: str, title: str, warning: bool, error: bool) -> str:
    """Show a text on the pendant.

    Raises:
        BadValue: a string that cannot be carried.
    """
    flags = f"{boolean(warning, 'warning')}, {boolean(error, 'error')}"
    return f"popup({quoted(text)}, {quoted(title, 'title')}, {flags})"
