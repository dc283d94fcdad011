"""Functions for the sockets of a program. The default name of a socket is "socket_0".

Drivers rely on two facts: integers are big endian, and the first element of a list that a function returns is the
number of received values. The following is from the manuals (cited from memory). At most 30 values are read at once.
After a timeout, the number is 0 and the values are -1, or NaN for floats. With a timeout of zero or less, a function
waits forever. The names and defaults of the parameters are also from the manuals.

The following is assumed:

- An attempt to connect times out after 2 s.
- A program reads at most 20 times in one cycle.
- After a timeout, received bytes are kept for the next read.
- A read from a socket that is not open takes one cycle and returns nothing.
- ASCII numbers have the form `(1.0,2.0,3.0)`. The text up to the closing parenthesis is consumed even if it cannot be
  parsed.
- Each received byte is one character of a text.
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
# Maximum number of reads by all threads in a cycle; further reads wait for the next cycle. Without this limit, no time
# would pass in a loop that reads from a peer which sends continuously.
_READS = 20
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,5})?")


# -- opening and closing -----------------------------------------------------------------------------


@declare(takes_time=True)
def socket_open(thread: ScriptThread, address: Any, port: Any, socket_name: Any = _NAME) -> Waiting:
    """Connect to a server, and return whether the connection is open."""
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

    According to the manual, the value is an integer. Public programs also pass other numbers, which are sent as text
    from `to_str` (assumed).
    """
    what, new = string(name, "socket_set_var: name"), number(value, "socket_set_var: value")
    return _send(thread, socket_name, _bytes(f"SET {what} {to_str(new)}\n"))


# -- reading -----------------------------------------------------------------------------------------


def _await(thread: ScriptThread, socket_name: Any, timeout: Any, is_there: Callable[[bytearray], bool]) -> Waiting:
    """Wait until `is_there` is true for the receive buffer, and return the buffer.

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
    """Wait for a line, consume it and its line feed, and return it without the line feed.

    Returns None on a timeout, or if the socket is not open.
    """
    buffer = yield from _await(thread, socket_name, timeout, lambda data: b"\n" in data)
    if buffer is None:
        return None
    line = bytes(buffer[: buffer.index(b"\n")])
    del buffer[: len(line) + 1]
    return line


def _read_numbers(thread: ScriptThread, count: int, code: str, socket_name: Any, timeout: Any) -> Waiting:
    """Wait for `count` numbers, and return a list of the number of values and the values.

    `code` is the format of one number for `struct`. On a timeout, the list contains 0 and then `count` times -1.
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
    # Missing values, and values that cannot be parsed, are NaN.
    return (len(found), *found, *[math.nan] * (count - len(found)))


@declare(takes_time=True)
def socket_read_line(thread: ScriptThread, socket_name: Any = _NAME, timeout: Any = 2) -> Waiting:
    """Wait for a line, and return it; on a timeout, return an empty string.

    The line feed, and a carriage return before it, are removed from the line.
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
    """Wait for text, and return it. If prefix or suffix is given, return the text between them."""
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
    """Send `GET name`, and return the integer in the reply, which has the form `name value`.

    If there is no reply, return 0 (assumed).
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
