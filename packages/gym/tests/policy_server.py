"""Stand-in for openpi's policy server, with the encoding of openpi-client and a policy of the test.

The protocol is that of `openpi/serving/websocket_policy_server.py`: the server first sends its metadata. It then
answers each observation with a dictionary, or with the text of an error before it closes the connection.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from openpi_client import msgpack_numpy
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve


@contextmanager
def policy_server(infer: Callable[[dict[str, Any]], Any], metadata: dict[str, Any] | None = None) -> Iterator[int]:
    """Serve a policy on a free port of this computer, and yield the port."""

    def handle(connection: ServerConnection) -> None:
        connection.send(msgpack_numpy.packb(metadata or {}))
        while True:
            try:
                observation = msgpack_numpy.unpackb(connection.recv())
                connection.send(msgpack_numpy.packb(infer(observation)))
            except ConnectionClosed:
                return
            except Exception:
                connection.send(traceback.format_exc())
                connection.close(1011, "internal server error")
                return

    with serve(handle, "127.0.0.1", 0, compression=None, max_size=None) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield server.socket.getsockname()[1]
        finally:
            server.shutdown()
            thread.join(10.0)
