"""Functions of the program's sockets. The default name of a socket is "socket_0".

Drivers rely on two facts. Integers are big endian, and the first element of a list that was read is the count of
values. The manuals (cited from memory) contain the following: at most 30 values are read at once. On a timeout, the
count is 0 and the values are -1, or NaN for floats. A timeout of zero or less waits forever. Names and defaults of
parameters are also from the manuals.

The following is assumed:

- Connecting times out after 2 s.
- A program reads at most 20 times in a cycle.
- On a timeout, the received bytes are kept for the next read.
- Reading from a socket that is not open returns nothing after one cycle.
- ASCII numbers have the form `(1.0,2.0,3.0)`. The text up to the closing bracket is consumed even if it cannot be
  parsed.
- Text is bytes, one character each.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable
from typing import Any

from ..errors import MAX_STRING, Fault
from ..machine import ScriptThread, Waiting
from ..values import to_str
from .declaration import boolean, declare, integer, number, string
from .mathematics import made

_NAME = "socket_0"
_CONNECTING = 2.0
_MOST = 30
# Maximum number of reads of all threads in a cycle; further reads wait for the next cycle. Otherwise no time would pass
# in a loop that reads from a peer which sends without end.
_READS = 20
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,5})?")


# -- opening and closing -----------------------------------------------------------------------------


@declare(takes_time=True)
def socket_open(thread: ScriptThread, address: Any, port: Any, socket_name: Any = _NAME) -> Waiting:
    """Connect, and return whether it succeeded."""
    name, sockets = string(socket_name, "socket_open: socket_name"), thread.world.sockets
    host, number_ = string(address, "socket_open: address"), integer(port, "socket_open: port", 0, 65535)
    sockets.close(name)
    sockets.open(name, host, number_)
    left = _CONNECTING / thread.world.period
    while sockets.state(name) == "connecting" and left > 0:
        left -= 1
        yield
    if sockets.state(name) == "open":
        return True
    sockets.close(name)
    return False


@declare()
def socket_close(thread: ScriptThread, socket_name: Any = _NAME) -> None:
    thread.world.sockets.close(string(socket_name, "socket_close: socket_name"))


# -- sending -----------------------------------------------------------------------------------------


def _send(thread: ScriptThread, socket_name: Any, data: bytes) -> bool:
    thread.machine.charge(len(data))
    return thread.world.sockets.send(string(socket_name, "socket_name"), data)


def _bytes(text: str) -> bytes:
    return text.encode("latin-1", "replace")


@declare()
def socket_send_string(thread: ScriptThread, str: Any, socket_name: Any = _NAME) -> bool:
    return _send(thread, socket_name, _bytes(to_str(str)))


@declare()
def socket_send_line(thread: ScriptThread, str: Any, socket_name: Any = _NAME) -> bool:
    return _send(thread, socket_name, _bytes(to_str(str)) + b"\n")


@declare()
def socket_send_byte(thread: ScriptThread, value: Any, socket_name: Any = _NAME) -> bool:
    return _send(thread, socket_name, bytes([integer(value, "socket_send_byte: value", 0, 255)]))


@declare()
def socket_send_int(thread: ScriptThread, value: Any, socket_name: Any = _NAME) -> bool:
    return _send(thread, socket_name, integer(value, "socket_send_int: value").to_bytes(4, "big", signed=True))


@declare()
def socket_set_var(thread: ScriptThread, name: Any, value: Any, socket_name: Any = _NAME) -> bool:
    """Send `SET name value`.

    The manual mentions integers. Public programs pass other numbers, which are sent as their `to_str` text (assumed).
    """
    what, new = string(name, "socket_set_var: name"), number(value, "socket_set_var: value")
    return _send(thread, socket_name, _bytes(f"SET {what} {to_str(new)}\n"))


# -- reading -----------------------------------------------------------------------------------------


def _await(thread: ScriptThread, socket_name: Any, timeout: Any, is_there: Callable[[bytearray], bool]) -> Waiting:
    """Return the receive buffer when `is_there` is true for it.

    Returns None on a timeout, or if the socket is not open.
    """
    sockets = thread.world.sockets
    name, seconds = string(socket_name, "socket_name"), number(timeout, "timeout")
    if thread.machine.reads >= _READS:
        yield
    thread.machine.reads += 1
    left = seconds / thread.world.period - 1e-6 if seconds > 0 else math.inf
    while True:
        buffer = sockets.received(name)
        if is_there(buffer):
            return buffer
        if sockets.state(name) != "open":
            yield
            return None
        if left <= 0:
            return None
        left -= 1
        yield


def _read_line(thread: ScriptThread, socket_name: Any, timeout: Any) -> Waiting:
    """Return a line without its line feed, which is consumed.

    Returns None on a timeout, or if the socket is not open.
    """
    buffer = yield from _await(thread, socket_name, timeout, lambda data: b"\n" in data)
    if buffer is None:
        return None
    line = bytes(buffer[: buffer.index(b"\n")])
    del buffer[: len(line) + 1]
    return line


def _read_numbers(thread: ScriptThread, count: int, code: str, socket_name: Any, timeout: Any) -> Waiting:
    """Return a list of `count` and the numbers, with the format `code` of `struct`.

    On a timeout, the list contains 0 and `count` times -1.
    """
    layout = struct.Struct(f">{count}{code}")
    buffer = yield from _await(thread, socket_name, timeout, lambda data: len(data) >= layout.size)
    if buffer is None:
        return (0, *[-1] * count)
    numbers = layout.unpack_from(buffer)
    del buffer[: layout.size]
    return (count, *numbers)


@declare(takes_time=True)
def socket_read_binary_integer(
    thread: ScriptThread, number: Any, socket_name: Any = _NAME, timeout: Any = 2
) -> Waiting:
    count = integer(number, "socket_read_binary_integer: number", 1, _MOST)
    return _read_numbers(thread, count, "i", socket_name, timeout)


@declare(takes_time=True)
def socket_read_byte_list(thread: ScriptThread, number: Any, socket_name: Any = _NAME, timeout: Any = 2) -> Waiting:
    count = integer(number, "socket_read_byte_list: number", 1, _MOST)
    return _read_numbers(thread, count, "B", socket_name, timeout)


@declare(takes_time=True)
def socket_read_ascii_float(thread: ScriptThread, number: Any, socket_name: Any = _NAME, timeout: Any = 2) -> Waiting:
    count = integer(number, "socket_read_ascii_float: number", 1, _MOST)
    buffer = yield from _await(thread, socket_name, timeout, lambda data: b")" in data)
    found: list[float] = []
    if buffer is not None:
        end = buffer.index(b")")
        text = bytes(buffer[:end][-MAX_STRING:]).decode("latin-1")
        del buffer[: end + 1]
        thread.machine.charge(len(text))
        for part in text.rpartition("(")[2].split(",")[:count]:
            if not _NUMBER.fullmatch(part.strip()):
                break
            found.append(float(part))
    # Values that cannot be parsed are NaN.
    return (len(found), *found, *[math.nan] * (count - len(found)))


@declare(takes_time=True)
def socket_read_line(thread: ScriptThread, socket_name: Any = _NAME, timeout: Any = 2) -> Waiting:
    """Return a line; empty on a timeout.

    The line feed, and a carriage return before it, are consumed but not returned.
    """
    line = yield from _read_line(thread, socket_name, timeout)
    return "" if line is None else made(thread, line.removesuffix(b"\r").decode("latin-1"))


@declare(takes_time=True)
def socket_read_string(
    thread: ScriptThread,
    socket_name: Any = _NAME,
    prefix: Any = "",
    suffix: Any = "",
    interpret_escape: Any = False,
    timeout: Any = 2,
) -> Waiting:
    """Return all received text, or the text between prefix and suffix if they are given."""
    begin, end = string(prefix, "prefix"), string(suffix, "suffix")
    if boolean(interpret_escape, "interpret_escape"):
        begin, end = _unescaped(begin), _unescaped(end)
    first, last = _bytes(begin), _bytes(end)

    def is_there(data: bytearray) -> bool:
        at = data.find(first)
        return bool(data) and at >= 0 and (not last or data.find(last, at + len(first)) >= 0)

    buffer = yield from _await(thread, socket_name, timeout, is_there)
    if buffer is None:
        return ""
    begin_at = buffer.find(first) + len(first)
    end_at = buffer.find(last, begin_at) if last else min(len(buffer), begin_at + MAX_STRING)
    text = bytes(buffer[begin_at:end_at])
    del buffer[: end_at + len(last)]
    return made(thread, text.decode("latin-1"))


def _unescaped(text: str) -> str:
    return text.replace("\\n", "\n").replace("\\r", "\r").replace("\\t", "\t")


@declare(takes_time=True)
def socket_get_var(thread: ScriptThread, name: Any, socket_name: Any = _NAME, timeout: Any = 2) -> Waiting:
    """Send `GET name`, and return the integer of the reply `name value`.

    Without a reply, return 0 (assumed).
    """
    what = string(name, "socket_get_var: name")
    if not _send(thread, socket_name, _bytes(f"GET {what}\n")):
        return 0
    line = yield from _read_line(thread, socket_name, timeout)
    if line is None:
        return 0
    key, _, value = line.decode("latin-1").strip().rpartition(" ")
    if key != what or not re.fullmatch(r"[+-]?[0-9]{1,10}", value):
        raise Fault(f"socket_get_var: expected the reply '{what} <integer>'")
    return integer(int(value), "socket_get_var: value")
