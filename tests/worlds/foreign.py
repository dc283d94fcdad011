"""Client without the library: raw sockets that send valid and invalid data to the ports of a controller.

Its programs are named `FOREIGN`, so that their owner is known.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import time
from collections.abc import Callable, Iterator

from .world import Ask

__all__ = ["FOREIGN", "RAW"]

FOREIGN = "foreign"
_TIMEOUT = 1.0
_PRIMARY, _SECONDARY, _REALTIME, _RTDE, _DASHBOARD, _INTERPRETER = 30001, 30002, 30003, 30004, 29999, 30020
_PORTS = (_PRIMARY, _SECONDARY, _REALTIME, _RTDE, _DASHBOARD, _INTERPRETER)
_LINES = (
    "play",
    "stop",
    "pause",
    "load /programs/pick.urp",
    "power off",
    "brake release",
    "unlock protective stop",
    "?",
)


@contextlib.contextmanager
def _connected(host: str, port: int) -> Iterator[socket.socket]:
    with socket.create_connection((host, port), timeout=_TIMEOUT) as connection:
        yield connection


def _drawn(ask: Ask) -> random.Random:
    return random.Random(ask.size)


def _port(ask: Ask) -> int:
    return _drawn(ask).choice(_PORTS)


def _script(host: str, ask: Ask) -> None:
    text = f"def {FOREIGN}():\n  movej([0, -1.57, {1.5 - 0.2 * ask.size}, -1.57, -1.57, 0], v=0.5)\nend\n".encode()
    with _connected(host, _drawn(ask).choice((_PRIMARY, _SECONDARY, _REALTIME))) as connection:
        middle = int(len(text) * ask.size)
        connection.sendall(text[:middle])
        time.sleep(ask.patience)
        connection.sendall(text[middle:])
        if ask.then != "interrupt":
            time.sleep(ask.patience)


def _line(host: str, ask: Ask) -> None:
    with _connected(host, _SECONDARY) as connection:
        connection.sendall(b"stopj(2.0)\n" if ask.size > 0.5 else b"set_digital_out(2, True)\n")
        time.sleep(ask.patience)


def _partial(host: str, ask: Ask) -> None:
    with _connected(host, _SECONDARY) as connection:
        connection.sendall(f"def {FOREIGN}():\n  movej([0, -1".encode())
        time.sleep(ask.patience)


def _garbage(host: str, ask: Ask) -> None:
    with _connected(host, _port(ask)) as connection:
        connection.sendall(_drawn(ask).randbytes(1 + int(3000 * ask.size)))
        time.sleep(ask.patience)


def _silence(host: str, ask: Ask) -> None:
    with _connected(host, _port(ask)):
        time.sleep(ask.patience + ask.size)


def _many(host: str, ask: Ask) -> None:
    with contextlib.ExitStack() as opened:
        for port in _PORTS[:4] * 2:
            opened.enter_context(_connected(host, port))
        time.sleep(ask.patience)


def _frame(kind: str, payload: bytes) -> bytes:
    """Pack an RTDE package (docs/protocols/rtde.md)."""
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


_VERSION = _frame("V", struct.pack(">H", 2))


def _rtde_frame(host: str, ask: Ask) -> None:
    with _connected(host, _RTDE) as connection:
        outputs = _frame("O", struct.pack(">d", 125.0) + b"actual_q,actual_qd")
        connection.sendall(_VERSION + outputs + _frame("S", b""))
        time.sleep(ask.patience + ask.size)


def _rtde_partial(host: str, ask: Ask) -> None:
    with _connected(host, _RTDE) as connection:
        connection.sendall((_VERSION + _frame("I", b"input_int_register_40"))[: 3 + int(20 * ask.size)])
        time.sleep(ask.patience)


def _rtde_claim(host: str, ask: Ask) -> None:
    """Claim inputs that other clients also want."""
    with _connected(host, _RTDE) as connection:
        names = ("speed_slider_mask,speed_slider_fraction", ",".join(f"input_int_register_{n}" for n in range(24, 48)))
        connection.sendall(_VERSION + _frame("I", names[ask.size > 0.5].encode()) + _frame("S", b""))
        time.sleep(ask.patience + ask.size)


def _dashboard_line(host: str, ask: Ask) -> None:
    with _connected(host, _DASHBOARD) as connection:
        connection.sendall(_drawn(ask).choice(_LINES).encode() + b"\n")
        if ask.size > 0.2:
            connection.recv(1000)


def _dashboard_flood(host: str, ask: Ask) -> None:
    with _connected(host, _DASHBOARD) as connection:
        connection.sendall(b"robotmode\n" * int(200 * ask.size))
        time.sleep(ask.patience)


RAW: dict[str, Callable[[str, Ask], None]] = {
    "script": _script,
    "line": _line,
    "partial": _partial,
    "garbage": _garbage,
    "silence": _silence,
    "many": _many,
    "rtde_frame": _rtde_frame,
    "rtde_partial": _rtde_partial,
    "rtde_claim": _rtde_claim,
    "dashboard_line": _dashboard_line,
    "dashboard_flood": _dashboard_flood,
}
