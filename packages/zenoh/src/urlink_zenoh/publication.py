"""One key that is published and remembers its newest value."""

from __future__ import annotations

import zenoh
import zenoh.ext

__all__ = ["Publication"]


class Publication:
    """A publisher whose newest value also reaches who comes late, and who asks.

    Samples that cannot be sent in time are dropped by Zenoh, and their subscribers are told how many they missed.

    Args:
        session: by which it is published.
        key: of the values.
        encoding: of the values, where none is given with one.
    """

    def __init__(self, session: zenoh.Session, key: str, encoding: zenoh.Encoding) -> None:
        self.key = zenoh.KeyExpr(key)
        self._encoding = encoding
        self._publisher = zenoh.ext.declare_advanced_publisher(
            session,
            key,
            encoding=encoding,
            cache=zenoh.ext.CacheConfig(max_samples=1),
            sample_miss_detection=zenoh.ext.MissDetectionConfig(),
            publisher_detection=True,
        )
        #: payload, encoding, attachment of the newest value
        self._newest: tuple[bytes, zenoh.Encoding, bytes | None] | None = None

    def put(self, payload: bytes, encoding: zenoh.Encoding | None = None, attachment: bytes | None = None) -> None:
        """Publish a value."""
        encoding = encoding or self._encoding
        self._newest = (payload, encoding, attachment)
        self._publisher.put(payload, encoding=encoding, attachment=attachment)

    def answer(self, query: zenoh.Query) -> None:
        """Answer a query with the newest value, if there is one and it was asked for."""
        newest = self._newest
        if newest is not None and query.key_expr.intersects(self.key):
            payload, encoding, attachment = newest
            query.reply(self.key, payload, encoding=encoding, attachment=attachment)

    def close(self) -> None:
        """End it."""
        self._publisher.undeclare()
