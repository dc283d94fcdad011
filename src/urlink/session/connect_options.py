"""Options of a connection: the checked arguments of `connect` and `connect_async`, defined once for both."""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Collection
from dataclasses import KW_ONLY, dataclass, field
from typing import Literal, ParamSpec, TypeVar, get_args

from linkcore.arguments import check_choice, check_number, check_whole
from linkcore.errors import BadValue, RemoteError
from linkcore.streaming.connection_life import Backoff

from .address import Address, RecordingAddress, parse_address
from .session_limits import SessionLimits

#: How settings are sent: "auto" uses RTDE inputs if they are free, otherwise URScript; "script" uses only URScript.
CommandsVia = Literal["auto", "script"]

#: When `enable()` must be called: never, once at startup, or at startup and after every stop.
Policy = Literal["never", "on_startup", "always"]

#: Default age in seconds above which the last state is too old to permit a motion: ten states of the primary interface.
STALE_AFTER = 1.0

#: Shortest accepted timeout, in seconds. A shorter one is assumed to be an error.
_SHORTEST = 1e-3
P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class ConnectOptions:
    """Checked arguments of `urlink.connect`, which describes each of them.

    Attributes:
        name: Address as a string.
        place: Parsed address.

    Raises:
        BadAddress, BadValue: See `urlink.connect`.
    """

    address: str | os.PathLike[str]
    _: KW_ONLY
    timeout: float = 5.0
    read_only: bool = False
    backoff: Backoff | None = None
    silence: float = 2.0
    require_enable: Policy = "never"
    stale_after: float = STALE_AFTER
    start_timeout: float = 5.0
    start_register: int | None = 47
    start_flags: Collection[int] = (24, 25, 26, 27, 28, 29, 30, 31)
    reverse_host: str | None = None
    reverse_port: int = 0
    reverse_peer: str | None = None
    commands_via: CommandsVia = "auto"
    isolate: bool = False
    limits: SessionLimits | None = None
    points: str | os.PathLike[str] | None = None
    name: str = field(init=False)
    place: Address = field(init=False)

    def __post_init__(self) -> None:
        checked: dict[str, object] = {"isolate": bool(self.isolate)}
        for name in ("timeout", "silence", "stale_after", "start_timeout"):
            checked[name] = check_number(getattr(self, name), name, _SHORTEST)
        if self.start_register is not None:
            checked["start_register"] = check_whole(self.start_register, "start_register", 0, 47)
        checked["start_flags"] = _each_once(self.start_flags)
        checked["reverse_port"] = check_whole(self.reverse_port, "reverse_port", 0, 65535)
        for name in ("reverse_host", "reverse_peer"):
            host = getattr(self, name)
            if host is not None and (not isinstance(host, str) or not host.strip()):
                raise BadValue(f"{name}={host!r}; expected a host name or address, or None")
        check_choice(self.commands_via, "commands_via", get_args(CommandsVia))
        if self.require_enable not in get_args(Policy):
            raise BadValue(f"require_enable={self.require_enable!r}; expected one of {', '.join(get_args(Policy))}")
        if self.backoff is not None and not isinstance(self.backoff, Backoff):
            raise BadValue(f"backoff={self.backoff!r}; expected a urlink.Backoff")
        if self.limits is not None and not isinstance(self.limits, SessionLimits):
            raise BadValue(f"limits={self.limits!r}; expected a urlink.SessionLimits, or None")
        checked["place"] = place = parse_address(self.address)
        checked["name"] = name = os.fspath(self.address)
        if self.isolate and isinstance(place, RecordingAddress):
            raise BadValue(
                f"isolate={self.isolate!r} is not supported for the recording {name}; expected isolate=False"
            )
        if self.points is not None:
            if not isinstance(self.points, (str, os.PathLike)) or not os.fspath(self.points):
                raise BadValue(f"points={self.points!r}; expected the path of a file, such as 'cell.json', or None")
            checked["points"] = os.fspath(self.points)
        vars(self).update(checked)  # bypasses the frozen dataclass


def _each_once(flags: Collection[int]) -> tuple[int, ...]:
    if not isinstance(flags, Collection):
        raise BadValue(f"start_flags={flags!r}; expected numbers of flags, such as (30, 31), or () for none")
    numbers = tuple(check_whole(flag, "start_flags", 0, 31) for flag in flags)
    if len(set(numbers)) < len(numbers):
        raise BadValue(f"start_flags={flags!r}; expected each flag only once")
    return numbers


def _taking(options: Callable[P, ConnectOptions]) -> Callable[[Callable[[ConnectOptions], T]], Callable[P, T]]:
    """Return a decorator for a function with one argument, the options.

    The decorated function takes the arguments of the options instead, and makes the options from them. Type checkers
    and `inspect.signature` show these arguments.
    """

    def taking(function: Callable[[ConnectOptions], T]) -> Callable[P, T]:
        signature = inspect.signature(options)
        returned = inspect.signature(function).return_annotation

        @functools.wraps(function)
        def taken(*arguments: P.args, **named: P.kwargs) -> T:
            signature.bind(*arguments, **named)  # if this raises TypeError, the message names no internal class
            try:
                return function(options(*arguments, **named))
            except RemoteError as error:
                # The message is complete, so drop the inner frames and the error of the operating system.
                raise error.with_traceback(None) from None

        taken.__signature__ = signature.replace(return_annotation=returned)  # type: ignore[attr-defined]
        return taken

    return taking


#: Decorator of `connect` and `connect_async`, which have exactly the arguments of `ConnectOptions`.
takes_connect_options = _taking(ConnectOptions)
