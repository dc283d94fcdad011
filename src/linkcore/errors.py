"""The exceptions of the library, as one tree.

Two kinds of mistake, two kinds of error::

    LinkError
    ├── LocalError                  you called it wrongly; nothing was sent
    │   ├── BadValue                a value that cannot be put on the wire        (ValueError)
    │   ├── BadAddress              an address nobody can read                    (ValueError)
    │   ├── BadVersion              a version that is not one                     (ValueError)
    │   ├── BadRecording            a file that is not a recording                (ValueError)
    │   ├── Cancelled               a motion or program that was given up
    │   └── Closed                  used after close()
    └── RemoteError                 the peer sent nonsense, or went away
        ├── ConnectFailed           no answer, refused, no route                  (ConnectionError)
        ├── ConnectionLost          was there, is gone                            (ConnectionError)
        ├── LinkTimeout             nothing came before the deadline              (TimeoutError)
        ├── WrongPeer               somebody else is listening there
        └── PacketError             a packet that its declared layout cannot hold (ValueError)
"""

from __future__ import annotations

import copy
from typing import Any, TypeVar

E = TypeVar("E", bound=Exception)


class LinkError(Exception):
    """Anything this library raises on purpose."""

    def __reduce__(self) -> tuple[object, ...]:
        # Copied and pickled without its `__init__`, which may take other arguments than `args`.
        return type(self).__new__, (type(self), *self.args), self.__dict__


class LocalError(LinkError):
    """You called it wrongly; nothing was sent."""


class BadValue(LocalError, ValueError):
    """A value that cannot be put on the wire, or an argument out of range."""


class BadAddress(LocalError, ValueError):
    """An address that names no robot."""


class Cancelled(LocalError):
    """A motion or program was cancelled, or preempted by another one of the same robot object."""


class BadVersion(LocalError, ValueError):
    """Text that is not a version, or a version nothing is known about."""


class BadRecording(LocalError, ValueError):
    """A file that is not a recording, or does not hold what was asked of it."""


class Closed(LocalError):
    """The object was closed before it was used."""


class RemoteError(LinkError):
    """The peer sent nonsense or went away."""


class ConnectFailed(RemoteError, ConnectionError):
    """No connection could be made."""


class ConnectionLost(RemoteError, ConnectionError):
    """The connection ended and was not, or not yet, made again."""


class LinkTimeout(RemoteError, TimeoutError):
    """Nothing came before the deadline."""


class WrongPeer(RemoteError):
    """Something else than expected is listening at the address."""


class PacketError(RemoteError, ValueError):
    """A packet that its declared layout cannot hold.

    Attributes:
        packet: name of the packet class.
        version: the version whose layout was asked for, or None.
        expected: bytes that the layout needs, or None where that is not the trouble.
        actual: bytes that were there.
        offset: where in the packet the trouble is, in bytes from its start.
    """

    def __init__(
        self,
        reason: str,
        *,
        packet: str,
        version: str | None = None,
        expected: int | None = None,
        actual: int | None = None,
        offset: int = 0,
    ) -> None:
        of = f" of firmware {version}" if version else ""
        sizes = f": expected {expected} bytes, got {actual}" if expected is not None else ""
        super().__init__(f"{packet}{of}: {reason}{sizes} (at offset {offset})")
        self.reason = reason
        self.packet = packet
        self.version = version
        self.expected = expected
        self.actual = actual
        self.offset = offset


def altered(error: PacketError, **arguments: Any) -> PacketError:
    """The same error but for these arguments."""
    names = ("reason", "packet", "version", "expected", "actual", "offset")
    return PacketError(**{name: getattr(error, name) for name in names} | arguments)


def unraised(error: E) -> E:
    """A copy of an error that can be kept: neither it nor what caused it has a traceback.

    A traceback refers to the frames through which an error was raised, and their variables may refer to what keeps the
    error: a reference cycle, which only the garbage collector would find.
    """
    copied = copy.copy(error)
    copied.__cause__, copied.__suppress_context__ = error.__cause__, error.__suppress_context__
    cause = error.__cause__ or error.__context__
    while cause is not None and cause.__traceback__ is not None:
        cause.__traceback__ = None
        cause = cause.__cause__ or cause.__context__
    return copied
