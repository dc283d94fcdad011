"""HTTP server for the scrapes of Prometheus."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.registry import Collector

from urlink import BadValue, LocalError

__all__ = ["HOST", "PORT", "serve_metrics"]

#: Default address: only this computer.
HOST = "127.0.0.1"
#: Default port, chosen freely outside the range that the system assigns automatically.
PORT = 9410
#: Maximum time, in s, to wait for the end of the server's thread.
_SOON = 5.0


@contextlib.contextmanager
def serve_metrics(collector: Collector, host: str = HOST, port: int = PORT) -> Iterator[int]:
    """Answer scrapes until the context ends; yield the port.

    Args:
        collector: Collector that is read at each scrape.
        host: Address to listen at. Anyone who can reach it can read the metrics.
        port: TCP port; 0 for a free port.

    Raises:
        BadValue: If the port is not a valid number.
        LocalError: If the port is in use, or the address does not belong to this computer.
    """
    if not 0 <= port <= 65535:
        raise BadValue(f"port={port!r}; expected 0 to 65535")
    registry = CollectorRegistry()
    registry.register(collector)
    try:
        server, thread = start_http_server(port, addr=host, registry=registry)
    except OSError as error:
        raise LocalError(f"cannot listen at {host}:{port}: {error.strerror or error}") from error
    try:
        yield int(server.server_port)
    finally:
        server.shutdown()
        server.server_close()
        thread.join(_SOON)
