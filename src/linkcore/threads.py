"""Starting a thread, where the system may have none left."""

from __future__ import annotations

import threading

from .errors import LocalError

__all__ = ["started"]


def started(thread: threading.Thread) -> threading.Thread:
    """Start a thread, and return it.

    Raises:
        LocalError: the system refuses another one.
    """
    try:
        thread.start()
    except RuntimeError as error:  # "can't start new thread", from pthread_create and its like
        raise LocalError(
            f"no thread could be started for {thread.name} ({error}): this process, or its user, has as many as the "
            f"system allows; there are {threading.active_count()} of Python"
        ) from error
    return thread
