"""A published key that remembers its newest value."""

from __future__ import annotations

import zenoh
import zenoh.ext

__all__ = ["Publication"]


class Publication:
    """Publisher of a key whose newest value also reaches late subscribers and queries.

    Zenoh drops samples that cannot be sent in time, and reports to their subscribers how many they missed.

    Args:
        session: Session that publishes the values.
        key: Key of the values.
        encoding: Default encoding of the values.
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
        """Answer a query with the newest value, if there is one and the query matches its key."""
        newest = self._newest
        if newest is not None and query.key_expr.intersects(self.key):
            payload, encoding, attachment = newest
            query.reply(self.key, payload, encoding=encoding, attachment=attachment)

    def close(self) -> None:
        """End the publication."""
        self._publisher.undeclare()
