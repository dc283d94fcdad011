"""A robot in Python: plugins, the tick that runs them, and the server for RHD clients."""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import lazy_names

if TYPE_CHECKING:
    from .config import Configuration as Configuration, Element as Element, read_config as read_config
    from .host import HostStatistics as HostStatistics

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__, {".config": "Configuration Element read_config", ".host": "HostStatistics"}
    )
