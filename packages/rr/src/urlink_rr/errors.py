"""Conversion of urlink's errors to the errors that Robot Raconteur sends to a client."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import RobotRaconteur as RR

from urlink import BadValue, Cancelled, LinkError, LinkTimeout, LocalError

__all__ = ["raised", "translated"]

F = TypeVar("F", bound=Callable[..., Any])


def raised(error: Exception) -> Exception:
    """Return the error for the client; the message is kept."""
    if isinstance(error, BadValue):
        kind = RR.InvalidArgumentException
    elif isinstance(error, Cancelled):
        kind = RR.OperationAbortedException
    elif isinstance(error, LocalError):
        kind = RR.InvalidOperationException
    elif isinstance(error, LinkTimeout):
        kind = RR.OperationTimeoutException
    else:
        kind = RR.OperationFailedException
    found: Exception = kind(f"{type(error).__name__}: {error}")
    return found


def translated(function: F) -> F:
    """Wrap a member of a service so that its errors reach the client."""

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except LinkError as error:
            raise raised(error) from error

    return call  # type: ignore[return-value]
