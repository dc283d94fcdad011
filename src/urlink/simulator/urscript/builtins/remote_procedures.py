"""Functions for remote procedure calls (XML-RPC) from programs.

A program calls `h = rpc_factory("xmlrpc", "http://127.0.0.1:40404/RPC2")`, and then `h.method(arguments)`. A call is an
HTTP request over a connection of the program. So the server can be on any computer to which the sockets of the program
can connect: this computer, or the computer of a client that is connected to the controller. According to the manual, a
pose is sent as a struct of x, y, z, rx, ry and rz.

The following is assumed. Each call opens a new connection, and fails after `TIMEOUT`. If the method fails, or if there
is no such method or server, the program ends. Received structs with other members become structs of URScript.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlsplit

from linkcore.errors import BadValue, PacketError
from linkcore.wire.http import HttpParser, HttpRequest, HttpResponse

from ..errors import MAX_NESTING, MAX_STRING, Fault, type_error
from ..machine import ScriptThread, Waiting
from ..values import Charge, PoseValue, RpcHandle, Struct, checked, list_of, struct_of, type_name
from .declaration import declare, string

#: Maximum duration of a call, in s.
TIMEOUT = 30.0
_POSE = ("x", "y", "z", "rx", "ry", "rz")


@declare(since="3.0")
def rpc_factory(thread: ScriptThread, type: Any, url: Any) -> RpcHandle:
    """Return a handle for the methods of a server. No connection is opened before the first call of a method."""
    if string(type, "rpc_factory: type") != "xmlrpc":
        raise Fault(f"rpc_factory: type is '{type}'; expected 'xmlrpc'")
    address = string(url, "rpc_factory: url")
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port or 80
    except ValueError:
        host, port = None, 0
    if host is None or parts.scheme != "http":
        raise Fault(f"rpc_factory: '{address}' is not an address such as http://127.0.0.1:40404/RPC2")
    return RpcHandle(address, host, port, parts.path or "/RPC2")


def call_method(thread: ScriptThread, base: Any, name: str, arguments: Sequence[Any]) -> Waiting:
    """Execute the remote call `base.name(arguments)`, and return its result."""
    if not isinstance(base, RpcHandle):
        raise type_error(f"{type_name(base)} has no method '{name}'")
    if name == "closeXMLRPCClientConnection":
        return None
    name = base.prefix + name
    # Import this module only when it is used, because it loads a large part of the standard library.
    from xmlrpc.client import dumps

    body = dumps(tuple(map(_sent, arguments)), methodname=name).encode()
    thread.machine.charge(len(body))
    answer = yield from _exchange(thread, base, name, body)
    return parse_answer(answer, f"{name}: {base.url}", thread.machine.charge)


def _exchange(thread: ScriptThread, handle: RpcHandle, name: str, body: bytes) -> Waiting:
    """Send a request, and return the body of the response."""
    what, sockets = f"{name}: {handle.url}", thread.world.sockets
    thread.machine.remote_calls += 1
    # Choose a name that no program can use for its own sockets: a string in a program cannot contain both kinds of
    # quotes.
    socket, left = f"rpc '{thread.machine.remote_calls}\"", TIMEOUT / thread.world.period
    sockets.open(socket, handle.host, handle.port)
    try:
        while sockets.state(socket) == "connecting" and left > 0:
            left -= 1
            yield
        try:
            request = HttpRequest("POST", handle.path, {"Content-Type": "text/xml"}, body)
            is_sent = sockets.send(socket, request.encode(f"{handle.host}:{handle.port}"))
        except BadValue as error:
            raise Fault(f"{what}: {error}") from None
        if not is_sent:
            raise Fault(f"{what}: cannot connect to the server")
        parser = HttpParser("response")
        while True:
            buffer = sockets.received(socket)
            data = bytes(buffer)
            buffer.clear()
            try:
                response = parser.feed(data) if data else None
                if response is None and not data and sockets.state(socket) != "open":
                    response = parser.end()
            except PacketError as error:
                raise Fault(f"{what}: the reply of the server is not valid XML-RPC: {error}") from None
            if response is not None:
                assert isinstance(response, HttpResponse)
                if response.status != 200:
                    raise Fault(f"{what}: the server replied with HTTP status {response.status} {response.reason}")
                return response.body
            if left <= 0:
                raise Fault(f"{what}: the server did not reply within {TIMEOUT:g} s")
            left -= 1
            yield
    finally:
        sockets.close(socket)


def _sent(value: Any) -> Any:
    """Return a value of URScript as a value that `dumps` accepts."""
    if isinstance(value, PoseValue):
        return dict(zip(_POSE, map(float, value), strict=True))
    if value.__class__ is tuple:
        return [_sent(item) for item in value]
    if isinstance(value, Struct):
        return {name: _sent(member) for name, member in value.members.items()}
    if isinstance(value, (bool, int, float, str)):
        return value
    raise type_error(f"a {type_name(value)} cannot be an argument of a remote method")


def parse_answer(body: bytes, what: str, charge: Charge) -> Any:
    """Return the value in the response to a call.

    Args:
        body: Body of the HTTP response.
        what: Method and server, used in the error message.
        charge: Function that counts new elements as work and memory of the program.

    Raises:
        Fault: If the body is not a valid response, if it reports that the method has failed, or if it contains a value
            that URScript does not support.
    """
    from xmlrpc.client import Fault as RemoteFault
    from xmlrpc.client import loads

    charge(len(body))
    try:
        (result,), _ = loads(body)
    except RemoteFault as fault:
        raise Fault(f"{what}: the server replied with fault {fault.faultCode}: {fault.faultString}") from None
    except Exception:  # the standard library raises various exceptions for invalid responses
        raise Fault(f"{what}: the reply of the server is not valid XML-RPC") from None
    return _value(result, what, charge, 0)


def _value(result: Any, what: str, charge: Charge, depth: int) -> Any:
    if depth > MAX_NESTING:
        raise Fault(f"{what}: the server returned values that are nested too deeply; the limit is {MAX_NESTING}")
    if isinstance(result, bool):
        return result
    if isinstance(result, str):
        if len(result) > MAX_STRING:
            raise Fault(f"String too long: {len(result)} characters")
        return result
    if isinstance(result, (int, float)):
        return _number(result)
    if isinstance(result, list):
        return list_of([_value(item, what, charge, depth + 1) for item in result], charge)
    if isinstance(result, dict):
        if result.keys() == set(_POSE) and all(isinstance(result[key], (int, float)) for key in _POSE):
            return PoseValue(float(_number(result[key])) for key in _POSE)
        return struct_of({str(key): _value(member, what, charge, depth + 1) for key, member in result.items()}, charge)
    raise Fault(f"{what}: the server returned a value of type {type(result).__name__}, which URScript does not support")


def _number(result: float | int) -> float | int:
    """Return a number. An integer that exceeds 32 bits is converted to a float."""
    if isinstance(result, float) or -(2**31) <= result < 2**31:
        return checked(result)
    return checked(float(result) if abs(result) < 1e300 else math.inf)
