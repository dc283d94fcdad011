"""The HTTP port at which Prometheus scrapes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.registry import Collector

from urlink import BadValue, LocalError

__all__ = ["HOST", "PORT", "serve_metrics"]

#: This computer alone.
HOST = "127.0.0.1"
#: Chosen freely among those that the system does not give out by itself.
PORT = 9410
#: s that the threads of the server have to end.
_SOON = 5.0


@contextlib.contextmanager
def serve_metrics(collector: Collector, host: str = HOST, port: int = PORT) -> Iterator[int]:
    """Answer scrapes for as long as the context lasts, which gives the port.

    Args:
        collector: asked at each scrape.
        host: address to listen at; anybody who reaches it reads the metrics.
        port: 0 for one that is free.

    Raises:
        BadValue: a port that is none.
        LocalError: the port is taken, or the address is not of this computer.
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
