"""All error classes of the library.

A `LocalError` reports a wrong call. A `RemoteError` reports a failure of the peer or of the connection. The classes
form a tree::

    LinkError
    ├── LocalError                  you called it wrongly; nothing was sent
    │   ├── BadValue                a value that cannot be put on the wire        (ValueError)
    │   ├── BadAddress              an address that cannot be used                (ValueError)
    │   ├── BadVersion              an invalid or unknown version                 (ValueError)
    │   ├── BadRecording            a file that is not a recording                (ValueError)
    │   ├── Cancelled               a motion or program that was cancelled
    │   └── Closed                  an object that is used after close()
    └── RemoteError                 the peer sent invalid data, or disconnected
        ├── ConnectFailed           no answer, refused, no route                  (ConnectionError)
        ├── ConnectionLost          the connection has ended                      (ConnectionError)
        ├── LinkTimeout             nothing arrived before the deadline           (TimeoutError)
        ├── WrongPeer               another kind of peer listens there
        └── PacketError             a packet that its declared layout cannot hold (ValueError)
"""

from __future__ import annotations

import copy
from typing import Any, TypeVar

E = TypeVar("E", bound=Exception)


class LinkError(Exception):
    """Base class of all errors that this library raises on purpose."""

    def __reduce__(self) -> tuple[object, ...]:
        # Copies and pickles are made without `__init__`, because its arguments might differ from `args`.
        return type(self).__new__, (type(self), *self.args), self.__dict__


class LocalError(LinkError):
    """Base class of errors in the calling program; nothing was sent."""


class BadValue(LocalError, ValueError):
    """A value that cannot be put on the wire, or an argument out of range."""


class BadAddress(LocalError, ValueError):
    """An address that is malformed, or that does not name a robot."""


class Cancelled(LocalError):
    """A motion or program was cancelled, or preempted by another one of the same robot object."""


class BadVersion(LocalError, ValueError):
    """A text that is not a version, or a version that the library does not support."""


class BadRecording(LocalError, ValueError):
    """A file that is not a recording, or that does not contain the requested data."""


class Closed(LocalError):
    """The object was closed before it was used."""


class RemoteError(LinkError):
    """Base class of failures of the peer: it sent invalid data, or disconnected."""


class ConnectFailed(RemoteError, ConnectionError):
    """A connection that could not be made."""


class ConnectionLost(RemoteError, ConnectionError):
    """The connection has ended, and has not been made again yet."""


class LinkTimeout(RemoteError, TimeoutError):
    """A timeout: nothing arrived before the deadline."""


class WrongPeer(RemoteError):
    """Another kind of peer than expected listens at the address."""


class PacketError(RemoteError, ValueError):
    """A packet that its declared layout cannot hold.

    Attributes:
        packet: Name of the packet class.
        version: Version whose layout was requested, or None.
        expected: Number of bytes that the layout needs; None if the size is not the problem.
        actual: Number of bytes that were received.
        offset: Position of the problem, in bytes from the start of the packet.
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
    """Return a copy of the error with these arguments changed."""
    names = ("reason", "packet", "version", "expected", "actual", "offset")
    return PacketError(**{name: getattr(error, name) for name in names} | arguments)


def unraised(error: E) -> E:
    """Return a copy of an error that can be kept: neither the copy nor its causes have a traceback.

    A traceback refers to the frames through which an error was raised. Their variables might refer to the object that
    keeps the error. This would be a reference cycle, which only the garbage collector would find.
    """
    copied = copy.copy(error)
    copied.__cause__, copied.__suppress_context__ = error.__cause__, error.__suppress_context__
    cause = error.__cause__ or error.__context__
    while cause is not None and cause.__traceback__ is not None:
        cause.__traceback__ = None
        cause = cause.__cause__ or cause.__context__
    return copied
