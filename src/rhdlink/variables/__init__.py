"""Variable database of a robot: tables of words, types of values, and declarations in classes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import lazy_names

if TYPE_CHECKING:
    from linkcore.recording.table import Table as Table
    from linkcore.clock import Stamp as Stamp
    from linkcore.streaming.connection_life import ConnectionEvent as ConnectionEvent
    from linkcore.streaming.packet_queue import Policy as Policy
    from linkcore.streaming.subscription import Subscription as Subscription
    from .database import Database as Database, TimeStamp as TimeStamp
    from .snapshot import Change as Change, Update as Update, Variable as Variable
    from .value_types import ValueType as ValueType
    from ..wire.decoder import Limits as Limits

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "linkcore.recording.table": "Table",
            "linkcore.clock": "Stamp",
            "linkcore.streaming.connection_life": "ConnectionEvent",
            "linkcore.streaming.packet_queue": "Policy",
            "linkcore.streaming.subscription": "Subscription",
            ".database": "Database TimeStamp",
            ".snapshot": "Change Update Variable",
            ".value_types": "ValueType",
            "..wire.decoder": "Limits",
        },
    )
