"""Table of firmware releases: the packets of each release and their sizes.

The layouts define each field and the first version that sends it. This table defines the resulting sizes, release by
release, and the evidence for each row. A test compares the layouts with the table. For a release that appends fields,
add one row here, and add the fields with their `since` to the layouts.

Sources: docs/protocols/realtime.md, section Length by firmware; docs/protocols/primary.md, section Robot state.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from linkcore.errors import BadValue, BadVersion
from linkcore.wire.fields import parse_version

# Types of sub-packages. Only the first state of a connection contains kinematics and configuration.
_MASTERBOARD = 3
_FIRST_STATE_ONLY = frozenset({5, 6})


#: Lowest frequency of a simulated controller, in Hz. A robot state is sent 10 times a second, and the interval between
#: two states may vary by less than half of it.
LOWEST_FREQUENCY = 25


class Firmware(NamedTuple):
    """Software version of a controller. Versions are compared number by number.

    >>> Firmware.parse("5.11") < Firmware.parse("5.12.2")
    True
    >>> str(Firmware(3, 10)), Firmware(3, 10).is_e_series
    ('3.10', False)
    """

    major: int
    minor: int
    bugfix: int = 0
    build: int = 0

    @classmethod
    def parse(cls, text: str | tuple[int, ...]) -> Firmware:
        """Parse ``"5.11"`` or ``"5.11.1.108318"``, or a tuple of two to four numbers.

        Raises:
            BadVersion: If `text` is neither.
        """
        numbers = parse_version(text)
        if not isinstance(numbers, tuple) or not 2 <= len(numbers) <= 4:
            raise BadVersion(f"{text!r} is not a firmware version; expected a string such as '5.11' or '3.4.3'")
        return cls(*numbers)

    @property
    def is_cb2(self) -> bool:
        """Whether the firmware belongs to a CB2 controller (1.x)."""
        return self.major < 3

    @property
    def is_e_series(self) -> bool:
        """Whether the firmware belongs to an e-Series controller (5.x), or to a later generation."""
        return self.major >= 5

    @property
    def is_polyscope_x(self) -> bool:
        """Whether the firmware is PolyScope X (10.x), which has a Robot API instead of the dashboard server."""
        return self.major >= 10

    @property
    def rate(self) -> int:
        """Cycles of the controller per second, with one real-time packet each: 125 on CB2 and CB3, 500 on e-Series."""
        return 500 if self.major >= 5 else 125

    @property
    def frequencies(self) -> tuple[int, ...]:
        """Cycles per second that a simulated controller with this firmware can execute, in Hz, lowest first.

        The frequency of a real controller is a multiple of each, so that every cycle of a slower controller coincides
        with one of a real controller.
        """
        real = Firmware(*self).rate
        return tuple(each for each in range(LOWEST_FREQUENCY, real + 1) if real % each == 0)

    def at(self, frequency: int) -> Firmware:
        """Return the firmware of a simulated controller that executes `frequency` cycles per second.

        Raises:
            BadValue: If `frequency` is not one of `frequencies`.
        """
        if isinstance(frequency, bool) or frequency not in self.frequencies:
            one_of = ", ".join(map(str, self.frequencies))
            raise BadValue(f"frequency={frequency!r}; expected one of {one_of} Hz for firmware {self}")
        real = Firmware(*self)
        return real if frequency == real.rate else SlowFirmware.of(real, frequency)

    def __str__(self) -> str:
        parts = list(self)
        while len(parts) > 2 and parts[-1] == 0:
            parts.pop()
        return ".".join(map(str, parts))


class SlowFirmware(Firmware):
    """Firmware of a simulated controller that executes fewer cycles per second than a real one; see `Firmware.at`.

    It equals the firmware with the same numbers, because everything except the rate is the same.
    """

    _rate: int

    @classmethod
    def of(cls, firmware: Firmware, rate: int) -> SlowFirmware:
        """Return the firmware with another rate, in Hz."""
        slow = cls(*firmware)
        slow._rate = rate
        return slow

    @property
    def rate(self) -> int:
        """Cycles of the simulated controller per second."""
        return self._rate


@dataclass(frozen=True)
class Release:
    """First firmware with these sizes, which are valid until the next row of the same generation.

    Attributes:
        since: First version with these sizes.
        realtime: Size of the real-time packet, in bytes.
        state: Type of sub-package -> its size in bytes without Euromap, in the order of sending.
        evidence: Evidence for the row, shown in the compatibility table.
    """

    since: Firmware
    realtime: int
    state: Mapping[int, int]
    evidence: str

    @property
    def first_state_size(self) -> int:
        """Size of the first robot state of a connection, with kinematics and configuration, in bytes."""
        return 5 + sum(self.state.values())

    @property
    def state_size(self) -> int:
        """Size of the later states, which do not contain kinematics and configuration, in bytes."""
        return 5 + sum(size for kind, size in self.state.items() if kind not in self.first_state_only)

    @property
    def first_state_only(self) -> frozenset[int]:
        """Types of the sub-packages that only the first state of a connection contains."""
        # In the oldest firmware, the laser pointer has the number of the kinematics, which have 225 bytes.
        return _FIRST_STATE_ONLY if self.state.get(5) == 225 else frozenset()


def _cb2(masterboard: int, **more: int) -> dict[int, int]:
    order: dict[int, int | None] = {0: 29, 1: 251, 4: 53, 5: more.get("kinematics", more.get("laser_pointer"))}
    order |= {9: more.get("calibration"), 3: masterboard, 2: 37, 6: more.get("configuration")}
    order |= {7: more.get("force"), 8: more.get("additional")}
    return {kind: size for kind, size in order.items() if size is not None}


def _cb3(mode: int, masterboard: int, cartesian: int, additional: int, **more: int) -> dict[int, int]:
    order = {0: mode, 1: 251, 4: cartesian, 5: 225, 9: 53, 3: masterboard, 2: 37, 6: 445, 7: 61, 8: additional}
    return order | ({10: more["safety"]} if "safety" in more else {})


def _e_series(masterboard: int, additional: int, **more: int) -> dict[int, int]:
    order = {0: 47, 1: 251, 4: 101, 5: 225, 9: 53, 3: masterboard, 2: 37, 6: more.get("configuration", 445)}
    order |= {7: 61, 8: additional, 10: 43, 11: 26}
    return order | ({12: more["tool_mode"]} if "tool_mode" in more else {})


#: Releases, oldest first. A row is valid from its version to the next row of the same major version.
RELEASES: tuple[Release, ...] = (
    # -- CB2
    Release(
        Firmware(1, 5),
        756,
        _cb2(61, laser_pointer=29),
        "state: real bytes (465 B, pre-1.7); real-time: one public decoder",
    ),
    Release(Firmware(1, 6), 764, _cb2(64), "real-time: 3 public decoders; state: sizes inferred"),
    Release(
        Firmware(1, 7),
        764,
        _cb2(64, force=61, additional=10),
        "real-time: 3 public decoders; state: reported real bytes (510 B)",
    ),
    Release(
        Firmware(1, 8),
        812,
        _cb2(64, kinematics=225, calibration=53, configuration=469, force=61, additional=7),
        "real bytes: real-time 812 B, state 1254 B",
    ),
    # -- CB3
    Release(Firmware(3, 0), 1044, _cb3(38, 72, 53, 7), "public decoders (4 real-time, 2+ state)"),
    Release(Firmware(3, 2), 1060, _cb3(46, 74, 101, 7), "public decoders and user reports"),
    Release(Firmware(3, 3), 1060, _cb3(46, 74, 101, 8), "real bytes: head of a 1306 B state, version message"),
    Release(Firmware(3, 5), 1108, _cb3(47, 74, 101, 8, safety=43), "public decoders; state size by a user report"),
    Release(
        Firmware(3, 10),
        1116,
        _cb3(47, 75, 101, 9, safety=43),
        "real bytes: connection head of 3.10 (state 1352 B by a user report); real-time: user reports",
    ),
    Release(Firmware(3, 14), 1140, _cb3(47, 75, 101, 9, safety=43), "public decoders; vendor page of its 5.x twin"),
    # -- e-Series
    Release(Firmware(5, 0), 1108, _e_series(74, 8), "public decoders; state size by a user report (5.0.5)"),
    Release(Firmware(5, 2), 1108, _e_series(74, 8, tool_mode=8), "public decoders"),
    Release(
        Firmware(5, 4),
        1116,
        _e_series(75, 9, tool_mode=8),
        "real bytes: states 716 B and 1386 B (URSim 5.4 to 5.8); real-time: user reports",
    ),
    Release(Firmware(5, 9), 1140, _e_series(75, 9, tool_mode=8), "vendor page RealTime 5.9, 2 public decoders"),
    Release(
        Firmware(5, 10),
        1220,
        _e_series(75, 9, tool_mode=8),
        "vendor page RealTime 5.10, 3 public decoders; real connection heads of 5.11 to 5.13 "
        "(5.11.11 declares a 1471 B first state: 85 bytes more than this row, of unknown content)",
    ),
    Release(
        Firmware(5, 25),
        1220,
        _e_series(75, 9, tool_mode=8, configuration=449),
        "vendor page; configuration by one report (5.25.1)",
    ),
    # -- PolyScope X
    Release(
        Firmware(10, 7),
        1220,
        _e_series(75, 9, tool_mode=8),
        "inferred: as 5.10; the vendor's client library is tested with 10.7 and 10.11",
    ),
    Release(
        Firmware(10, 12),
        1220,
        _e_series(75, 9, tool_mode=8, configuration=449),
        "inferred: as 5.25, which has the same functions; the vendor's client library is tested with 10.12",
    ),
    Release(
        Firmware(10, 13),
        1220,
        _e_series(75, 9, tool_mode=8, configuration=449),
        "inferred: as 10.12; the vendor's client library is tested with 10.13",
    ),
    # -- a later generation
)

#: Newest firmware of the e-Series in the table, and the default of a simulated arm.
NEWEST = [row.since for row in RELEASES if row.since.major == 5][-1]
#: Last releases of CB2 and CB3, which receive no further updates.
LAST_CB2, LAST_CB3 = Firmware(1, 8), Firmware(3, 15)
#: Frequencies that a simulated controller with some firmware can have, in Hz, lowest first.
FREQUENCIES = tuple(sorted({*NEWEST.frequencies, *LAST_CB3.frequencies}))

_MAJORS = sorted({row.since.major for row in RELEASES})


def release_of(firmware: Firmware) -> Release:
    """Return the row that is valid for `firmware`.

    If `firmware` is later than all rows of its generation, return the newest row of that generation. If its generation
    is newer than the whole table, return the newest row of the table, because a controller might be newer than this
    library. A number between two generations of the table, such as 6.1, was never released.

    Raises:
        BadVersion: If `firmware` is older than every row of the table, or of a generation that does not exist.
    """
    rows = [row for row in RELEASES if row.since <= firmware]
    same = [row for row in rows if row.since.major == firmware.major]
    if not rows or (not same and firmware.major < _MAJORS[-1]):
        series = [f"{major}.x" for major in _MAJORS]
        known = " or ".join((", ".join(series[:-1]), series[-1]))
        raise BadVersion(f"unknown firmware {firmware}; expected a release of {known}, not before {RELEASES[0].since}")
    return (same or rows)[-1]


def known_firmware(text: str | Firmware) -> Firmware:
    """Return the firmware if the table has a row for it.

    Raises:
        BadVersion: If `text` is not a version, is older than every row, or is of a generation that does not exist.
    """
    firmware = Firmware.parse(text)
    release_of(firmware)
    return firmware


def existing_firmware(text: str | Firmware) -> Firmware:
    """Return the firmware if a controller can have it, so that a simulated controller can use it.

    Later releases of a generation that is still updated are accepted.

    Raises:
        BadVersion: If `known_firmware` raises it, the generation is newer than the table, or it is later than the last
            release of CB2 or CB3.
    """
    firmware = known_firmware(text)
    last = {each.major: each for each in (LAST_CB2, LAST_CB3)}.get(firmware.major)
    if firmware.major > _MAJORS[-1] or (last is not None and firmware[:2] > last[:2]):
        raise BadVersion(
            f"no controller has firmware {firmware}; expected 1.x up to {LAST_CB2}, 3.x up to {LAST_CB3}, "
            f"{' or '.join(f'{major}.x' for major in _MAJORS if major >= 5)}"
        )
    return firmware


def infer(sizes: Mapping[int, int]) -> Firmware | None:
    """Return the oldest firmware that sends such a robot state, for a controller without a version message.

    Args:
        sizes: Type of sub-package -> its size in bytes, as in `RobotState.sizes`. The masterboard may be with or
            without Euromap. Kinematics and configuration may be missing, because only the first state contains them.

    Returns:
        Oldest firmware with these sizes; None if no row of the table has them.
    """

    def telling(state: Mapping[int, int]) -> dict[int, int]:
        return {kind: size for kind, size in state.items() if kind not in (_MASTERBOARD, *_FIRST_STATE_ONLY)}

    for row in RELEASES:
        masterboard = row.state[_MASTERBOARD]
        euromap = 12 if row.since.is_cb2 else 16
        if telling(sizes) == telling(row.state) and sizes.get(_MASTERBOARD) in (masterboard, masterboard + euromap):
            return row.since
    return None
