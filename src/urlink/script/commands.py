"""URScript commands for each firmware: programs that move the arm, and statements that do not move it.

For the statements that move nothing, these facts are certain: the names of the output functions of each generation and
the numbering of digital outputs (three public drivers), `set_payload` with only a mass, `set_tool_voltage`, `set_flag`,
`set_tcp`, `popup`, `set_target_payload` since 5.10, and the line ``set speed`` (reports of users). Assumptions:

- The tool outputs of CB2 are 8 and 9 of `set_digital_out`. Its masterboard has 16 bits, of which 0 to 7 belong to the
  control box.
- Analogue outputs take a fraction of their range, 0 to 1, for a current as well as a voltage. The vendor's manual is
  commonly quoted this way, and the public drivers pass a number on unchecked.
- `set_payload` takes a centre of gravity since 3.0, and `popup` takes a title and two flags in every generation.
- Flag numbers end at 31.
- `set_gravity` exists in every generation. Other public clients send it to CB3 and e-Series.
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

#: Baud rates of the tool's serial line, in Bd.
BAUD_RATES = (9600, 19200, 38400, 57600, 115200, 1_000_000, 2_000_000, 5_000_000)

_TARGET_PAYLOAD = Since("5.10")

#: Longest plausible transition, in s. Smallest and largest plausible gravity, in m/s²; any other value is in another
#: unit. Chosen, because the acceleration of a moving base is too small to leave this range.
_LONGEST_TRANSITION, _GRAVITIES = 60.0, (5.0, 15.0)
#: Mass in kg that no arm can lift. It distinguishes kilograms from grams.
_HEAVIEST = 100.0

#: Prefix of the message that announces a movement of a path; the number of the movement follows.
_SEGMENT = "urlink: segment "


# -- commands that move the arm -----------------------------------------------------------------------


def move_joints(
    q: Sequence[float], speed: float, acceleration: float, time: float | None = None, blend: float = 0.0
) -> list[str]:
    """Move the joints to `q` (6, rad), limited by speed and acceleration (rad/s, rad/s²), or in `time` seconds."""
    return [f"movej({vector(q, what='q')}, {_how(speed, acceleration, time, blend)})"]


def move_linear(
    target: Sequence[float], speed: float, acceleration: float, time: float | None = None, blend: float = 0.0
) -> list[str]:
    """Move the tool straight to a pose (m, rad), limited to `speed` (m/s) and `acceleration`, or in `time` seconds."""
    return [f"movel({pose(target)}, {_how(speed, acceleration, time, blend)})"]


def move_circular(
    via: Sequence[float], to: Sequence[float], speed: float, acceleration: float, blend: float = 0.0
) -> list[str]:
    """Move the tool along the circle through one pose to another (m, rad), limited by m/s and m/s²."""
    return [f"movec({pose(via, 'via')}, {pose(to, 'to')}, {_how(speed, acceleration, None, blend)})"]


def _how(speed: float, acceleration: float, time: float | None, blend: float) -> str:
    figures = f"a={number(acceleration, 'acceleration')}, v={number(speed, 'speed')}"
    if time is not None:
        figures += f", t={number(time, 'time')}"
    return f"{figures}, r={number(blend, 'blend')}" if blend else figures


def segment(index: int) -> str:
    """Return the `textmsg` before movement `index` of a path. After a blend, it is executed when the blend begins.

    A `textmsg` takes no time. Assumption: it does not end a blend, like any statement that takes no time. This follows
    from the vendor's own programs, which set outputs between blended waypoints.
    """
    return f"textmsg({quoted(f'{_SEGMENT}{index}')})"


def segment_of(text: str) -> int | None:
    """Return the index of the movement that a text line announces; None for any other text."""
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
    """Whether ``speedj`` and ``speedl`` accept a duration.

    In 3.1 and 3.2 they do not. There they return when the speed is reached, and the arm keeps that speed
    (docs/protocols/urscript.md, Differences).
    """
    return not (3, 1) <= firmware[:2] < (3, 3)


def interpreter_mode() -> list[str]:
    """Accept statements of clients until a client ends interpreter mode."""
    return ["interpreter_mode()"]


def stop(acceleration: float) -> list[str]:
    """Brake all joints with this acceleration, in rad/s²."""
    return [f"stopj({number(acceleration, 'acceleration')})"]


# -- commands that move nothing -----------------------------------------------------------------------


def secondary(*statements: str) -> str:
    """Wrap statements in a program that runs in addition to the main program and takes no time."""
    return "\n".join(["sec urlink_command():", *(f"  {statement}" for statement in statements), "end"]) + "\n"


class DigitalBank(NamedTuple):
    """Digital inputs or outputs of one kind, numbered from 0. Only this class maps their numbers to bits.

    Attributes:
        name: Name used in messages and in URScript function names.
        size: Number of inputs or outputs.
        first: Bit of the first one in the robot state, on CB3 and e-Series.
        first_of_cb2: Bit of the first one on CB2, which is also its number in the function call; None if CB2 has none.
    """

    name: str
    size: int
    first: int
    first_of_cb2: int | None

    def bit(self, firmware: Firmware, number: int, what: str) -> int:
        """Return the bit of input or output `number` in the robot state.

        Raises:
            BadValue: If there is no such input or output.
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
        BadValue: If there is no such output, or `on` is neither True nor False.
    """
    bit = bank.bit(firmware, number, "output")
    value = boolean(on, f"{bank.name} digital output {number}")
    if firmware.is_cb2:
        return f"set_digital_out({bit}, {value})"
    return f"set_{bank.name}_digital_out({int(number)}, {value})"


def analog_out(firmware: Firmware, output: int, fraction: float) -> str:
    """Set analogue output 0 or 1 to a fraction of its range.

    Raises:
        BadValue: If there is no such output, or the fraction is not from 0 to 1.
    """
    name = "set_analog_out" if firmware.is_cb2 else "set_standard_analog_out"
    value = number(fraction, "fraction", 0.0, 1.0)
    return f"{name}({integer(output, 0, 1, 'analogue output')}, {value})"


#: Number of each parity of the tool's serial line.
PARITIES = {"none": 0, "odd": 1, "even": 2}


def tool_communication(
    enabled: bool, baud_rate: int, parity: str, stop_bits: int, rx_idle_chars: float, tx_idle_chars: float
) -> str:
    """Configure the serial line of the tool connector. The ranges are from the vendor's script manual.

    Raises:
        BadValue: If the serial line does not support a value.
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
    """Set the supply voltage of the tool to 0, 12 or 24 V.

    Raises:
        BadValue: If `volts` is another voltage.
    """
    if isinstance(volts, bool) or volts not in (0, 12, 24):
        raise BadValue(f"tool voltage is {volts!r}; expected 0, 12 or 24")
    return f"set_tool_voltage({int(volts)})"


def flag(index: int, on: bool) -> str:
    """Set flag 0 to 31.

    Raises:
        BadValue: If there is no such flag, or `on` is neither True nor False.
    """
    return f"set_flag({integer(index, 0, 31, 'flag')}, {boolean(on, 'flag')})"


def payload(
    firmware: Firmware,
    mass: float,
    cog: Sequence[float] | None = None,
    inertia: Sequence[float] | None = None,
    transition_time: float = 0.0,
) -> str:
    """Set the payload of the arm: mass in kg, centre of gravity, and inertia about it.

    The centre of gravity is in m in the flange frame. The inertia is xx, yy, zz, xy, xz, yz in kg m².

    Args:
        transition_time: Duration of the transition to the new payload, in s.

    Raises:
        BadValue: If a number is out of range, or the firmware does not support a value.
    """
    weight = number(mass, "payload mass", 0.0, _HEAVIEST, "kg")
    seconds = number(transition_time, "transition_time", 0.0, _LONGEST_TRANSITION, "s")
    if transition_time and (cog is None or inertia is None):
        raise BadValue("missing cog or inertia; a payload with a transition_time needs both")
    if cog is None and inertia is None:
        return f"set_payload({weight})"
    if firmware.is_cb2:
        raise BadValue(f"firmware {firmware} accepts only the mass of a payload; omit cog and inertia")
    centre = vector((0.0, 0.0, 0.0) if cog is None else cog, 3, "payload cog")
    if inertia is None:
        return f"set_payload({weight}, {centre})"
    if firmware not in _TARGET_PAYLOAD:
        raise BadValue(f"firmware {firmware} accepts no inertia; 5.10 or later is required")
    moments = vector(inertia, 6, "payload inertia")
    return f"set_target_payload({weight}, {centre}, {moments}{f', {seconds}' if transition_time else ''})"


def gravity(acceleration: Sequence[float]) -> str:
    """Set the acceleration that an arm at rest measures, shape (3,), in m/s², in the base frame.

    Raises:
        BadValue: If `acceleration` is not three numbers, or its length is not plausible for gravity.
    """
    components = floats(acceleration, 3, "gravity")
    length = math.hypot(*components)
    if not _GRAVITIES[0] <= length <= _GRAVITIES[1]:
        raise BadValue(f"gravity is {length:g} m/s²; expected {_GRAVITIES[0]:g} to {_GRAVITIES[1]:g} m/s²")
    return f"set_gravity({vector(components, 3)})"


def tcp(offset: Sequence[float]) -> str:
    """Set the tool centre point to a pose in the flange frame.

    Raises:
        BadValue: If `offset` is not six finite numbers.
    """
    return f"set_tcp({pose(offset, 'tcp')})"


def speed_slider(fraction: float) -> str:
    """Return the line that moves the speed slider. It is not a function, so it is sent on its own.

    Raises:
        BadValue: If the fraction is not from 0 to 1.
    """
    return f"set speed {number(fraction, 'speed slider', 0.0, 1.0)}\n"


def popup(text: str, title: str, warning: bool, error: bool) -> str:
    """Show a text on the pendant.

    Raises:
        BadValue: If a string contains a character that URScript cannot hold.
    """
    flags = f"{boolean(warning, 'warning')}, {boolean(error, 'error')}"
    return f"popup({quoted(text)}, {quoted(title, 'title')}, {flags})"
