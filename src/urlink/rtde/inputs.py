"""Inputs: variables that are claimed and written, with the masks that belong to them."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from linkcore.arguments import check_whole
from linkcore.errors import BadValue, Closed, ConnectionLost
from linkcore.names import StrictAttributes
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionState
from linkcore.threads import Closing, alone

from ..protocol.rtde.packets import join_names
from ..protocol.rtde.protocol import RtdeProtocol, check_names
from ..protocol.rtde.recipes import Recipe
from ..protocol.rtde.transport import RtdeTransport


class _Masked(NamedTuple):
    """A mask, and the bits of it that say that a variable is to be taken."""

    mask: str
    bits: int
    is_bits: bool  # the variable is bits too, of which each may be left as it is


_MASKED = {
    "speed_slider_fraction": _Masked("speed_slider_mask", 1, is_bits=False),
    "standard_digital_output": _Masked("standard_digital_output_mask", 0xFF, is_bits=True),
    "configurable_digital_output": _Masked("configurable_digital_output_mask", 0xFF, is_bits=True),
    "tool_digital_output": _Masked("tool_digital_output_mask", 0b11, is_bits=True),
    "standard_analog_output_0": _Masked("standard_analog_output_mask", 1, is_bits=False),
    "standard_analog_output_1": _Masked("standard_analog_output_mask", 2, is_bits=False),
}
_MASKS = frozenset(masked.mask for masked in _MASKED.values())
_ANALOG_TYPE = "standard_analog_output_type"
_FRACTIONS = frozenset({"speed_slider_fraction", "standard_analog_output_0", "standard_analog_output_1"})

#: The ranges of the integer types.
_RANGES = {"UINT8": (0, 2**8 - 1), "UINT32": (0, 2**32 - 1), "INT32": (-(2**31), 2**31 - 1)}


def with_masks(names: Sequence[str]) -> tuple[str, ...]:
    """The names, and before each what makes the controller take it: its mask, and the type of an analogue output.

    Raises:
        BadValue: a name that cannot be asked for, a mask without a value, or more than 2048 bytes of names.
    """
    names = check_names(names)
    wanted: dict[str, None] = {}
    for name in names:
        if name in _MASKED:
            wanted[_MASKED[name].mask] = None
            if name.startswith("standard_analog"):
                wanted[_ANALOG_TYPE] = None
        wanted[name] = None
    for name in names:
        values = [value for value, masked in _MASKED.items() if masked.mask == name and value in names]
        if name in _MASKS and not values:
            raise BadValue(f"{name} was asked for without what it is the mask of")
    return check_names(tuple(wanted))


def checked(name: str, type: str, value: Any) -> Any:
    """A value as it can be sent.

    Raises:
        BadValue: not of the type, out of its range, or not finite.
    """
    if type == "BOOL":
        if not isinstance(value, (bool, np.bool_)) and value not in (0, 1):
            raise BadValue(f"{name}={value!r}; expected True or False")
        return bool(value)
    if type in _RANGES:
        least, most = _RANGES[type]
        if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
            raise BadValue(f"{name}={value!r}; expected a whole number")
        if not least <= value <= most:
            raise BadValue(f"{name}={value!r}; expected {least} to {most}")
        return int(value)
    count = {"VECTOR3D": 3, "VECTOR6D": 6}.get(type)
    try:
        numbers = [float(each) for each in ([value] if count is None else value)]
    except (TypeError, ValueError):
        raise BadValue(f"{name}={value!r}; expected {'a number' if count is None else f'{count} numbers'}") from None
    if len(numbers) != (count or 1) or not all(map(math.isfinite, numbers)):
        raise BadValue(
            f"{name}={value!r}; expected {'a finite number' if count is None else f'{count} finite numbers'}"
        )
    if name in _FRACTIONS and not 0 <= numbers[0] <= 1:
        raise BadValue(f"{name}={value!r}; expected 0 to 1")
    return numbers[0] if count is None else numbers


class Inputs(StrictAttributes, Closing):
    """Variables that are claimed for as long as this is open. A context manager; made by `Rtde.inputs`.

    They are claimed again when the connection was lost and made again; what was sent before is not sent again. A
    controller keeps the last values, also after this was closed.

    Attributes:
        names: of the variables that can be sent, without the masks, which are set by themselves.
    """

    def __init__(self, connection: Connection, transport: RtdeTransport, names: Sequence[str], timeout: float) -> None:
        self.names = tuple(name for name in names if name not in _MASKS)
        self._connection = connection
        self._transport = transport
        self._timeout = timeout
        self._last: dict[str, Any] = {}
        self._sending = threading.RLock()

    def _claim(self) -> None:
        """Connect and claim them; closed if that fails.

        Raises:
            InputInUse, NoSuchVariable, RemoteError, Closed: they cannot be had.
        """
        try:
            self._connection.start()
        except BaseException:
            self._connection.abandon()
            raise
        if self._connection.is_over:  # closed while it connected
            raise Closed(f"{self._connection.name} was closed")

    @property
    def connection(self) -> ConnectionState:
        """The state of the connection."""
        return self._connection.state

    @property
    def is_over(self) -> bool:
        """It was closed, or its connection has been given up for good."""
        return self._connection.is_over

    def send(self, /, **values: Any) -> None:
        """Write variables, all of them in one package, so in the same control cycle.

        Bits of digital outputs are given as a mapping of those to be set, ``standard_digital_output={0: True, 3:
        False}``, or as a number, which sets all of them. What has a mask and is not given stays as it is. What has no
        mask, such as a register, is sent each time: the first time all of it has to be given, later it is as it was.

        Raises:
            BadValue: no such variable here, one that is missing, or a value that it cannot have; nothing was sent.
            ConnectionLost: there is no connection at present; nothing was sent, and nothing is kept for later.
            LinkTimeout: the controller does not take it.
        """
        unknown = values.keys() - set(self.names)
        if unknown or not values:
            raise BadValue(f"cannot send {', '.join(sorted(unknown)) or 'nothing'}; there is {', '.join(self.names)}")
        # In turn: a package made beside another one would put back what that one changes. Alone: a
        # signal handler may come here while the main thread, which it keeps, sends.
        otherwise = f"{self._connection.name}: another package was not sent within {self._timeout:g} s"
        with alone(self._sending, self._timeout, otherwise):
            recipe = self._recipe()
            package = self._package(recipe, values)
            self._connection.send(recipe.encode(package), self._timeout)
            self._last |= {name: value for name, value in package.items() if name not in _MASKS}

    def _write(self, values: Mapping[str, Any]) -> None:
        """Write every variable of the recipe, masks included, without waiting and unchecked: for set-points.

        Raises:
            BadValue: a value that its type cannot hold; nothing was sent.
            ConnectionLost, Closed: as `put_whole`.
        """
        put_whole(self._connection, self._recipe().encode(values))

    def _recipe(self) -> Recipe:
        """What was claimed on the present connection, or on the one before if there is none."""
        return dialogue_of(self._connection, self._transport).claims[0]

    def _package(self, recipe: Recipe, values: Mapping[str, Any]) -> dict[str, Any]:
        """The value of each variable of the recipe, masks included."""
        package: dict[str, Any] = {name: 0 for name in recipe.names if name in _MASKS}
        has_analog = any(name in _FRACTIONS and name != "speed_slider_fraction" for name in values)
        missing = []
        for name, type in zip(recipe.names, recipe.types, strict=True):
            masked = _MASKED.get(name)
            if name in _MASKS:
                continue
            if name not in values:
                if name in self._last:
                    package[name] = self._last[name]
                elif masked is None and (name != _ANALOG_TYPE or has_analog):
                    missing.append(name)
            elif masked is not None and masked.is_bits:
                package[masked.mask], package[name] = _bits(name, values[name], masked.bits)
            else:
                package[name] = checked(name, type, values[name])
                if masked is not None:
                    package[masked.mask] |= masked.bits
        if missing:
            raise BadValue(f"the first time {', '.join(missing)} has to be given too, since it is sent each time")
        return package

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect, which releases the variables; a controller may take a while for that. Idempotent."""
        self._connection.close(timeout)

    def __repr__(self) -> str:
        return f"<Inputs {join_names(self.names)} of {self._connection.name}: {self.connection.value}>"


def dialogue_of(connection: Connection, transport: RtdeTransport) -> RtdeProtocol:
    """The dialogue of the present connection, or of the one before if there is none.

    Raises:
        ConnectionLost: there has not been one.
    """
    if transport.dialogue is None:
        raise ConnectionLost(f"{connection.name} is not connected")
    return transport.dialogue


def put_whole(connection: Connection, package: bytes) -> None:
    """Hand a package to the kernel at once, whole.

    Raises:
        ConnectionLost: there is no connection, or the controller does not read; it is given up then, since what follows
            would be read as the rest of the package.
        Closed: it was closed.
    """
    if connection.send_some(package) < len(package):
        connection.abort()
        raise ConnectionLost(f"{connection.name}: the controller does not read what is written")


def _bits(name: str, value: Any, all: int) -> tuple[int, int]:
    """Mask and bits of digital outputs.

    Raises:
        BadValue: a bit that is not there, or not a value of the input.
    """
    if not isinstance(value, Mapping):
        bits = checked(name, "UINT8", value)
        if bits & ~all:
            raise BadValue(f"{name}={value!r}; expected bits of {all:#x}")
        return all, bits
    mask = bits = 0
    for number, state in value.items():
        check_whole(number, f"output of {name}", 0, all.bit_length() - 1)
        mask |= 1 << number
        bits |= checked(f"{name}[{number}]", "BOOL", state) << number
    return mask, bits
