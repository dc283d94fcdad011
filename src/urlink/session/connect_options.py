"""The options of `connect` and `connect_async`: checked, and collected once."""

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

#: How settings may be sent: RTDE inputs where they are free, else URScript; or URScript alone.
CommandsVia = Literal["auto", "script"]

#: Whether a person has to call `enable()`: never; once; at first and after every stop.
Policy = Literal["never", "on_startup", "always"]

#: Seconds after which the last state is too old to permit a motion, by default: ten states of the primary interface.
STALE_AFTER = 1.0

#: Seconds; a timeout below that is a mistake.
_SHORTEST = 1e-3
P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class ConnectOptions:
    """The arguments of `urlink.connect`, where each is described, as they should be.

    Attributes:
        name: the address as text.
        place: what it means.

    Raises:
        BadAddress, BadValue: as `urlink.connect`.
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
                raise BadValue(f"{name} is {host!r}; expected a host name or address, or None")
        check_choice(self.commands_via, "commands_via", get_args(CommandsVia))
        if self.require_enable not in get_args(Policy):
            raise BadValue(f"require_enable={self.require_enable!r}; expected one of {', '.join(get_args(Policy))}")
        if self.backoff is not None and not isinstance(self.backoff, Backoff):
            raise BadValue(f"backoff is {self.backoff!r}; expected an urlink.Backoff")
        checked["place"] = place = parse_address(self.address)
        checked["name"] = name = os.fspath(self.address)
        if self.isolate and isinstance(place, RecordingAddress):
            raise BadValue(f"isolate={self.isolate!r}: {name} is a recording, which no other process can read sooner")
        vars(self).update(checked)  # it is frozen for others


def _each_once(flags: Collection[int]) -> tuple[int, ...]:
    if not isinstance(flags, Collection):
        raise BadValue(f"start_flags is {flags!r}; expected numbers of flags, such as (30, 31), or () for none")
    numbers = tuple(check_whole(flag, "start_flags", 0, 31) for flag in flags)
    if len(set(numbers)) < len(numbers):
        raise BadValue(f"start_flags is {flags!r}; expected each flag once")
    return numbers


def _taking(options: Callable[P, ConnectOptions]) -> Callable[[Callable[[ConnectOptions], T]], Callable[P, T]]:
    """Makes a function of these options one of their arguments, which type checkers and `inspect.signature` see."""

    def taking(function: Callable[[ConnectOptions], T]) -> Callable[P, T]:
        signature = inspect.signature(options)
        returned = inspect.signature(function).return_annotation

        @functools.wraps(function)
        def taken(*arguments: P.args, **named: P.kwargs) -> T:
            signature.bind(*arguments, **named)  # whose TypeError does not name the class
            try:
                return function(options(*arguments, **named))
            except RemoteError as error:
                # Without the frames and the error of the operating system below: the message has what they have.
                raise error.with_traceback(None) from None

        taken.__signature__ = signature.replace(return_annotation=returned)  # type: ignore[attr-defined]
        return taken

    return taking


#: Decorates `connect` and `connect_async`, which have the arguments of `ConnectOptions`, and no others.
takes_connect_options = _taking(ConnectOptions)
