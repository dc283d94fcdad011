"""Sessions of Zenoh, for programs that live longer than a router."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import Literal

import zenoh

from linkcore import clock
from urlink import BadValue, ConnectFailed

__all__ = ["Mode", "open_session"]

Mode = Literal["peer", "client", "router"]

#: Seconds between two attempts to find a router.
_PAUSE = 0.5


def open_session(
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    *,
    mode: Mode | None = None,
    config: str | os.PathLike[str] | None = None,
    scouting: bool | None = None,
    timeout: float = 10.0,
) -> zenoh.Session:
    """Open a session. It connects again by itself to a router that goes away and comes back.

    Args:
        connect: endpoints of routers or peers, such as ``tcp/fleet.local:7447``.
        listen: endpoints to listen at.
        mode: "peer", "client" or "router"; None for a client where there is something to connect to, else a peer.
        config: a file as Zenoh reads it; what else is given here overrides it.
        scouting: look for others by multicast; None does so where no endpoint is given.
        timeout: seconds to wait for a router that is not there yet.

    Raises:
        BadValue: an endpoint, or a file, that Zenoh cannot read.
        ConnectFailed: the session cannot be opened, since an endpoint is taken, say.
    """
    try:
        settings = zenoh.Config() if config is None else zenoh.Config.from_file(str(config))
        if mode is None and config is None:
            mode = "client" if connect and not listen else "peer"
        if mode is not None:
            settings.insert_json5("mode", json.dumps(mode))
        if connect:
            settings.insert_json5("connect/endpoints", json.dumps(list(connect)))
        if listen:
            settings.insert_json5("listen/endpoints", json.dumps(list(listen)))
        if scouting is None and (connect or listen):
            scouting = False
        if scouting is not None:
            settings.insert_json5("scouting/multicast/enabled", json.dumps(scouting))
        # Zenoh's newest value for those who come late goes by time, so every sample needs one.
        settings.insert_json5("timestamping/enabled", "true")
        # One attempt, since Zenoh would repeat it within `open`, where no signal of Python's is heard.
        settings.insert_json5("connect/timeout_ms", "0")
        # Of its own it waits up to 4 s between two attempts to find a router that went away.
        settings.insert_json5(
            "connect/retry", '{"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2.0}'
        )
    except zenoh.ZError as error:
        raise BadValue(f"Zenoh cannot be set up so: {error}") from error
    until = clock.now() + timeout
    while True:
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            if clock.now() + _PAUSE > until:
                raise ConnectFailed(f"no session of Zenoh within {timeout:g} s: {error}") from error
        clock.sleep(_PAUSE)
