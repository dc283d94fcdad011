"""Zenoh sessions for programs that run longer than a router."""

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

#: Interval, in s, between two attempts to find a router.
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
    """Open a session. It reconnects automatically to a router that disappears and comes back.

    Args:
        connect: Endpoints of routers or peers, such as ``tcp/fleet.local:7447``.
        listen: Endpoints to listen at.
        mode: Mode of the session: "peer", "client" or "router". None selects "client" if only `connect` is given, and
            "peer" otherwise.
        config: Configuration file of Zenoh. The other arguments override it.
        scouting: Whether to look for other sessions by multicast. None does so only if no endpoint is given.
        timeout: Maximum time, in s, to wait for a router that is not there yet.

    Raises:
        BadValue: If Zenoh cannot read an endpoint or the file.
        ConnectFailed: If the session cannot be opened, for example because an endpoint is in use.
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
        # Zenoh selects the newest value for late subscribers by time, so every sample needs a time stamp.
        settings.insert_json5("timestamping/enabled", "true")
        # Only one attempt: Zenoh would repeat it inside `open`, during which Python handles no signals.
        settings.insert_json5("connect/timeout_ms", "0")
        # By default, Zenoh waits up to 4 s between two attempts to find a router that disappeared.
        settings.insert_json5(
            "connect/retry", '{"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2.0}'
        )
    except zenoh.ZError as error:
        raise BadValue(f"Zenoh rejects the configuration: {error}") from error
    until = clock.now() + timeout
    while True:
        try:
            return zenoh.open(settings)
        except zenoh.ZError as error:
            if clock.now() + _PAUSE > until:
                raise ConnectFailed(f"could not open a Zenoh session within {timeout:g} s: {error}") from error
        clock.sleep(_PAUSE)
