"""Third-party packages that a part of the library needs and the rest does not."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from .errors import LocalError

__all__ = ["needs"]


@contextlib.contextmanager
def needs(extra: str, purpose: str) -> Iterator[None]:
    """Around the imports of what an extra of the distribution brings.

    Raises:
        LocalError: it is not installed; says what installs it.
    """
    try:
        yield
    except ImportError as error:
        package = error.name or extra
        raise LocalError(f"{purpose} needs {package}, which is not installed: pip install 'urlink[{extra}]'") from error
