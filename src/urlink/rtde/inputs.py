"""RTDE inputs: claimed variables that a client writes, with their masks."""

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
from ..session.session_limits import SessionLimits


class _Masked(NamedTuple):
    """Mask of a variable, and the bits in the mask that make the controller apply the variable."""

    mask: str
    bits: int
    is_bits: bool  # whether the variable is a bit field, whose bits can be left unchanged one by one


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
    """Return the names, each preceded by its mask and, for an analogue output, its type variable.

    Raises:
        BadValue: If a name is invalid, a mask has no value, or the names exceed 2048 bytes.
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
            raise BadValue(f"{name} is a mask; request the variable that it belongs to as well")
    return check_names(tuple(wanted))


def checked(name: str, type: str, value: Any) -> Any:
    """Return a value converted to its RTDE type.

    Raises:
        BadValue: If the value does not have the type, is out of range, or is not finite.
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
    """Set of variables that are claimed until this object is closed. A context manager; made by `Rtde.inputs`.

    After a reconnect, the variables are claimed again, but earlier values are not sent again. The controller keeps the
    last values, even after this object is closed.

    Attributes:
        names: Names of the variables that can be sent, without the masks, which are set automatically.
    """

    def __init__(
        self,
        connection: Connection,
        transport: RtdeTransport,
        names: Sequence[str],
        timeout: float,
        limits: SessionLimits | None = None,
    ) -> None:
        self._limits = limits
        self.names = tuple(name for name in names if name not in _MASKS)
        self._connection = connection
        self._transport = transport
        self._timeout = timeout
        self._last: dict[str, Any] = {}
        self._sending = threading.RLock()

    def _claim(self) -> None:
        """Connect and claim the variables. If this fails, the object is closed.

        Raises:
            InputInUse, NoSuchVariable, RemoteError, Closed: If the variables cannot be claimed.
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
        """State of the connection."""
        return self._connection.state

    @property
    def is_over(self) -> bool:
        """Whether this object was closed, or its connection has failed permanently."""
        return self._connection.is_over

    def send(self, /, **values: Any) -> None:
        """Write variables in one package, so that they take effect in the same control cycle.

        Digital outputs are a mapping of the bits to change, ``standard_digital_output={0: True, 3: False}``, or a
        number that sets all bits. A variable that has a mask and is not given stays unchanged. A variable without a
        mask, such as a register, is part of every package: the first call must contain all of these variables, and
        later calls repeat the last value.

        Raises:
            BadValue: If a variable is unknown or missing, or its value is invalid. Nothing is sent.
            LimitExceeded: If the speed slider would exceed a limit of the session. Nothing is sent.
            ConnectionLost: If there is no connection now. Nothing is sent, now or later.
            LinkTimeout: If the controller does not accept the package in time.
        """
        unknown = values.keys() - set(self.names)
        if unknown or not values:
            raise BadValue(
                f"cannot send {', '.join(sorted(unknown)) or 'nothing'}; expected one of {', '.join(self.names)}"
            )
        # One at a time, because concurrent packages would overwrite each other's changes. `alone`, because a signal
        # handler can run this while the interrupted main thread is sending.
        otherwise = f"{self._connection.name}: another package was not sent within {self._timeout:g} s"
        with alone(self._sending, self._timeout, otherwise):
            recipe = self._recipe()
            package = self._package(recipe, values)
            self._connection.send(recipe.encode(package), self._timeout)
            self._last |= {name: value for name, value in package.items() if name not in _MASKS}

    def _write(self, values: Mapping[str, Any]) -> None:
        """Write every variable of the recipe, masks included, without waiting and without checks. For set-points.

        Raises:
            BadValue: If the type of a variable cannot hold its value. Nothing is sent.
            ConnectionLost, Closed: See `put_whole`.
        """
        put_whole(self._connection, self._recipe().encode(values))

    def _recipe(self) -> Recipe:
        """Return the recipe claimed on the current connection, or on the previous one if there is none."""
        return dialogue_of(self._connection, self._transport).claims[0]

    def _package(self, recipe: Recipe, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the value of each variable of the recipe, masks included."""
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
                if name == "speed_slider_fraction" and self._limits is not None:
                    self._limits.check_slider(package[name])
                if masked is not None:
                    package[masked.mask] |= masked.bits
        if missing:
            raise BadValue(f"missing {', '.join(missing)}; the first send must contain every variable without a mask")
        return package

    def close(self, timeout: float = 2.0) -> None:
        """Disconnect, which releases the variables. The controller might need some time for that. Idempotent."""
        self._connection.close(timeout)

    def __repr__(self) -> str:
        return f"<Inputs {join_names(self.names)} of {self._connection.name}: {self.connection.value}>"


def dialogue_of(connection: Connection, transport: RtdeTransport) -> RtdeProtocol:
    """Return the dialogue of the current connection, or of the previous one if there is none.

    Raises:
        ConnectionLost: If there has been no connection yet.
    """
    if transport.dialogue is None:
        raise ConnectionLost(f"{connection.name} is not connected")
    return transport.dialogue


def put_whole(connection: Connection, package: bytes) -> None:
    """Pass a whole package to the kernel without waiting.

    Raises:
        ConnectionLost: If there is no connection, or the controller does not read. In the second case the connection is
            aborted, because the controller would read later data as the rest of this package.
        Closed: If it was closed.
    """
    if connection.send_some(package) < len(package):
        connection.abort()
        raise ConnectionLost(f"{connection.name}: the controller does not read the data that is sent to it")


def _bits(name: str, value: Any, all: int) -> tuple[int, int]:
    """Return the mask and the bits of digital outputs.

    Raises:
        BadValue: If a bit does not exist, or the value is invalid.
    """
    if not isinstance(value, Mapping):
        bits = checked(name, "UINT8", value)
        if bits & ~all:
            raise BadValue(f"{name}={value!r}; expected a number that sets only bits of {all:#x}")
        return all, bits
    mask = bits = 0
    for number, state in value.items():
        check_whole(number, f"output of {name}", 0, all.bit_length() - 1)
        mask |= 1 << number
        bits |= checked(f"{name}[{number}]", "BOOL", state) << number
    return mask, bits
