"""Replacements for sockets, `poll`, `select` and selectors, for simulated connections."""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import socket as _socket
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

from ..deferred import Deferred, SteadyBytes
from .network import BUFFER, Computer, End, Listener, Network
from .scheduler import Scheduler, Task, current

#: First descriptor: above the usual descriptors of a process, with room below 1024, the limit of `select`.
_FIRST = 400

#: Events of `poll` with their numbers on Linux, because Windows has no `poll`, and macOS has no `POLLRDHUP`. Events in
#: `_ALWAYS` are reported whether they are requested or not.
_IN, _PRI, _OUT, _ERR, _HUP, _NVAL, _RDHUP = 0x1, 0x2, 0x4, 0x8, 0x10, 0x20, 0x2000
_ALWAYS = _ERR | _HUP | _NVAL

#: The flag of `recv` and `send`; Windows does not have it.
_DONTWAIT = getattr(_socket, "MSG_DONTWAIT", 0)

_RealSocket = _socket.socket


class Pollable:
    """Object with a descriptor, and with events for which tasks can wait."""

    def __init__(self, sockets: Sockets) -> None:
        self._sockets = sockets
        #: Waiting tasks, and the events that they wait for.
        self._waiters: list[tuple[Task, int]] = []
        #: Selectors with which this object is registered.
        self.selectors: list[Selector] = []
        self._number = sockets.open(self)

    def fileno(self) -> int:
        return self._number

    def events(self) -> int:
        """Return the events that `poll` reports."""
        raise NotImplementedError

    def changed(self) -> None:
        """Make the tasks ready that wait for a current event.

        A task that would only wait again does not run.
        """
        for selector in self.selectors:
            selector.look_at(self)
        if self._waiters:
            events = self.events()
            for task, mask in self._waiters:
                if events & mask:
                    self._sockets.scheduler.make_ready(task)

    def wait_for(self, mask: int, deadline: float | None) -> bool:
        """Wait until one of these events might be present; return False if the deadline came first."""
        scheduler = self._sockets.scheduler
        waiter = scheduler.running, mask
        self._waiters.append(waiter)
        try:
            return scheduler.wait(deadline)
        finally:
            self._waiters.remove(waiter)


class Socket(Pollable):
    """Replacement for `socket.socket`: TCP, and the parts of UDP that are needed to find a route."""

    makefile = _RealSocket.makefile
    _io_refs = 0
    _closed = False

    def __init__(self, sockets: Sockets, family: int, kind: int, proto: int, end: End | None = None) -> None:
        self.family = _socket.AddressFamily(family if family >= 0 else _socket.AF_INET)
        self.type = _socket.SocketKind(kind if kind >= 0 else _socket.SOCK_STREAM)
        self.proto = max(proto, 0)
        super().__init__(sockets)
        self._computer = sockets.computer()
        self._timeout: float | None = _socket.getdefaulttimeout()
        self._receive_timeout = 0.0
        self._options: dict[tuple[int, int], bytes | int] = {}
        self._bound: tuple[str, int] | None = None
        self._listener: Listener | None = None
        self._end = end
        #: Outcome of the connection attempt: None before it, -1 while it is in progress, then 0 or an error number.
        self._connecting: int | None = None
        # Size that a waiting `recv` requests, and bytes that the kernel has passed to it while it could not return.
        self._asked = 0
        self._given = b""
        #: Function that returns whether this program currently accepts several steady packets at once.
        self.takes_batches: Callable[[], bool] = _never
        #: Function that takes a steady packet in place of the thread that waits for data. It must not wait. It returns
        #: whether it has taken the packet, and the seconds that the thread waits for the next data; None for no limit.
        self.take_in_place: Callable[[Deferred | SteadyBytes], tuple[bool, float | None]] = _takes_nothing
        # Thread that waits in `recv_deferred`, and the end of its wait.
        self._reader: Task | None = None
        self._until: float | None = None
        if end is not None:
            end.owner = self

    # -- names -------------------------------------------------------------------------------------------

    def getsockname(self) -> tuple[str, int]:
        if self._end is not None:
            return self._end.address, self._end.port
        return self._bound or ("0.0.0.0", 0)

    def getpeername(self) -> tuple[str, int]:
        if self._end is None or not self._end.is_connected or self._end.peer is None:
            raise OSError(errno.ENOTCONN, "Transport endpoint is not connected")
        return self._end.peer_name

    def gettimeout(self) -> float | None:
        return self._timeout

    def settimeout(self, timeout: float | None) -> None:
        if timeout is not None and timeout < 0:
            raise ValueError("Timeout value out of range")
        self._timeout = timeout

    def setblocking(self, flag: bool) -> None:
        self._timeout = None if flag else 0.0

    def getblocking(self) -> bool:
        return self._timeout != 0.0

    def setsockopt(self, level: int, option: int, value: bytes | int) -> None:
        self._alive()
        self._options[level, option] = value
        if level == _socket.SOL_SOCKET and option == _socket.SO_RCVTIMEO and isinstance(value, bytes):
            seconds, microseconds = struct.unpack("qq" if len(value) == 16 else "ii", value)
            self._receive_timeout = seconds + microseconds * 1e-6
        self._apply()

    def _apply(self) -> None:
        end = self._end
        if end is None:
            return
        linger = self._options.get((_socket.SOL_SOCKET, _socket.SO_LINGER))
        if isinstance(linger, bytes):
            is_on, seconds = struct.unpack("ii" if len(linger) == 8 else "hh", linger)
            end.linger = float(seconds) if is_on else None
        # Only Linux has the option.
        limit = self._options.get((_socket.IPPROTO_TCP, getattr(_socket, "TCP_USER_TIMEOUT", -1)))
        end.user_timeout = limit * 1e-3 if isinstance(limit, int) else 0.0
        size = self._options.get((_socket.SOL_SOCKET, _socket.SO_SNDBUF))
        end.send_buffer = 2 * size if isinstance(size, int) else BUFFER  # Linux doubles it

    def getsockopt(self, level: int, option: int, size: int = 0) -> Any:
        self._alive()
        if level == _socket.SOL_SOCKET and option == _socket.SO_ERROR:
            return self._take_error()
        if option == _socket.SO_RCVTIMEO and size:
            return bytes(16)
        value = self._options.get((level, option), 0)
        return value if not size or isinstance(value, bytes) else struct.pack("i", value)

    # -- servers -----------------------------------------------------------------------------------------

    def bind(self, address: Any) -> None:
        host, port = address[:2]
        if self._sockets.network.find(host, self._computer) is not self._computer:
            raise OSError(errno.EADDRNOTAVAIL, "Cannot assign requested address")
        port = port or self._computer.port()
        if port in self._computer.listeners:
            raise OSError(errno.EADDRINUSE, "Address already in use")
        self._bound = (host or "0.0.0.0", port)

    def listen(self, backlog: int = 128) -> None:
        self._alive()
        if self._bound is None:
            self._bound = ("0.0.0.0", self._computer.port())
        if self._listener is None:
            if self._bound[1] in self._computer.listeners:
                raise OSError(errno.EADDRINUSE, "Address already in use")
            self._listener = Listener(self._computer, self._bound[1], max(backlog, 1), self)
            self._computer.listeners[self._bound[1]] = self._listener

    def accept(self) -> tuple[Socket, tuple[str, int]]:
        self._step()
        listener = self._listener
        if listener is None:
            raise OSError(errno.EINVAL, "Invalid argument")
        self._wait(_IN, self._timeout)
        if self._listener is None:
            raise OSError(errno.EINVAL, "Invalid argument")
        end = listener.accepted.popleft()
        return Socket(self._sockets, self.family, self.type, self.proto, end), end.peer_name

    # -- connections -------------------------------------------------------------------------------------

    def connect_ex(self, address: Any) -> int:
        try:
            self.connect(address)
        except OSError as error:
            return error.errno or errno.EIO
        return 0

    def connect(self, address: Any) -> None:
        self._alive()
        self._step()
        host, port = address[:2]
        if self.type == _socket.SOCK_DGRAM:
            here = "127.0.0.1" if host.startswith("127.") else self._computer.address
            self._bound = (here, self._computer.port())
            return
        if self._end is not None and self._end.is_connected:
            raise OSError(errno.EISCONN, "Transport endpoint is already connected")
        if self._connecting is None:
            self._connecting = -1
            self._end = end = End(self._sockets.network, self._computer, self._computer.port())
            end.owner = self
            end.peer_name = (host, port)
            self._apply()
            self._sockets.network.connect(end, host, port, self._finished)
        elif self._timeout == 0.0 and self._connecting == -1:
            raise BlockingIOError(errno.EALREADY, "Operation already in progress")
        if self._timeout == 0.0 and self._connecting == -1:
            raise BlockingIOError(errno.EINPROGRESS, "Operation now in progress")
        self._wait(_OUT, self._timeout)
        outcome, self._connecting = self._connecting, None
        if outcome:
            raise OSError(outcome, os.strerror(outcome))

    def _finished(self, outcome: int) -> None:
        self._connecting = outcome
        if outcome and self._end is not None:
            self._end.error = outcome
            self._end.is_open = False
        self.changed()

    def recv(self, size: int, flags: int = 0) -> bytes:
        end = self._connected()
        given = self._wait_for_data(end, size, flags)
        if given or not end.received:
            return given
        return end.received.peek(size) if flags & _socket.MSG_PEEK else end.received.take(size)

    def recv_deferred(self, size: int) -> bytes | Deferred:
        """Receive as `recv` does, but return a single packet whose bytes are not made yet as it is."""
        end = self._connected()
        self._reader = self._scheduler().running
        try:
            given = self._wait_for_data(end, size, 0)
        finally:
            self._reader = None
        return given if given or not end.received else end.received.take_deferred(size)

    def pass_on(self, data: Deferred | SteadyBytes) -> bool:
        """Pass an arrived packet to the program in place of the thread that waits for it, without a change of threads.

        Return False if no thread waits, or the program cannot take the packet in this way.
        """
        reader, scheduler = self._reader, self._sockets.scheduler
        if reader is None or not data.is_steady or not self._computer.is_running or not scheduler.is_idle:
            return False
        try:
            is_taken, seconds = scheduler.stand_in(reader, lambda: self.take_in_place(data))
        except Exception as error:
            reader.error = error
            scheduler.make_ready(reader)
            return True
        if is_taken:
            self._until = reader.deadline = None if seconds is None else scheduler.now + seconds / self._computer.rate
            if reader.deadline is not None and reader.deadline < reader.alarm:
                scheduler.set_alarm(reader, reader.deadline)
        return is_taken

    def _wait_for_data(self, end: End, size: int, flags: int) -> bytes:
        """Wait until data can be received, or until the end of the data.

        Return bytes that the kernel has already passed to this call.
        """
        self._step()
        if not (end.received or end.is_ended or end.error or not end.is_open or self._is_shut_for_reading):
            if flags & _DONTWAIT:
                raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
            timeout = self._timeout
            self._asked = 0 if flags & _socket.MSG_PEEK else size
            try:
                if timeout is None and self._receive_timeout:
                    self._wait(_IN, self._receive_timeout, BlockingIOError)
                else:
                    self._wait(_IN, timeout)
            finally:
                self._asked = 0
            if self._given:
                data, self._given = self._given, b""
                return data
        if not end.received:
            self._raise_error(end)
        return b""

    def recv_into(self, buffer: Any, nbytes: int = 0, flags: int = 0) -> int:
        view = memoryview(buffer).cast("B")
        data = self.recv(nbytes or len(view), flags)
        view[: len(data)] = data
        return len(data)

    def send(self, data: Any, flags: int = 0) -> int:
        end = self._connected()
        self._step()
        if not isinstance(data, (Deferred, SteadyBytes)):
            data = bytes(data)
        if end.is_open and not end.is_shut and not end.room:
            if flags & _DONTWAIT:
                raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
            self._wait(_OUT, self._timeout)
        self._raise_error(end)
        if not end.is_open or end.is_shut:
            raise BrokenPipeError(errno.EPIPE, "Broken pipe")
        return end.send(data)

    @property
    def quiet_time(self) -> float:
        """Time in s for which packets can be sent at once by `send_batch`; 0 if the peer needs each packet at its time.

        It is on the clock of this computer.
        """
        end = self._end
        if end is None or end.peer is None:
            return 0.0
        peer = end.peer.owner
        if not isinstance(peer, Socket) or not peer.takes_batches() or self._computer.rate != 1.0:
            return 0.0
        return max(end.quiet_time, 0.0)

    def send_steady(self, packet: Deferred | SteadyBytes) -> bool:
        """Send a steady packet, and let time pass until it arrives; see `End.pass_on`."""
        end = self._end
        return end is not None and end.pass_on(packet)

    def send_batch(self, packets: Sequence[Deferred | SteadyBytes], delays: Sequence[float]) -> None:
        """Send steady packets, each after a delay in s from now; see `DeferredBatch`."""
        self._connected().send_batch(packets, delays)

    def sendall(self, data: Any, flags: int = 0) -> None:
        rest = memoryview(data).cast("B")
        while rest:
            rest = rest[self.send(rest, flags) :]

    def shutdown(self, how: int) -> None:
        self._step()
        if self._listener is not None:
            self._close_listener()
            return
        end = self._connected()
        if not end.is_open:
            raise OSError(errno.ENOTCONN, "Transport endpoint is not connected")
        if how in (_socket.SHUT_RD, _socket.SHUT_RDWR):
            self._is_shut_for_reading = True
        if how in (_socket.SHUT_WR, _socket.SHUT_RDWR):
            end.shut()
        self.changed()

    _is_shut_for_reading = False

    def close(self) -> None:
        self._closed = True
        if self._io_refs <= 0:
            self._real_close()

    def _decref_socketios(self) -> None:
        if self._io_refs > 0:
            self._io_refs -= 1
        if self._closed:
            self.close()

    def _real_close(self) -> None:
        number, self._number = self._number, -1
        if number < 0:
            return
        self._sockets.forget(number)
        self._close_listener()
        end = self._end
        if end is not None:
            end.close()
        self.changed()
        # These references would be parts of reference cycles, and simulated time runs without the garbage collector.
        self.takes_batches, self.take_in_place = _never, _takes_nothing
        if end is not None and end.owner is self:
            end.owner = None

    def _close_listener(self) -> None:
        listener, self._listener = self._listener, None
        if listener is not None:
            listener.close()
            self.changed()

    def detach(self) -> int:
        raise OSError(errno.EOPNOTSUPP, "a simulated socket has no real descriptor; detach() is not supported")

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):
            self._real_close()

    # -- waiting -----------------------------------------------------------------------------------------

    def events(self) -> int:
        """Return the events that `poll` reports."""
        end = self._end
        if self._number < 0:
            return _NVAL
        if self._listener is not None:
            return _IN if self._listener.accepted else 0
        if end is None:
            return _HUP | _OUT
        if self._connecting == -1:
            return 0
        found = _IN if end.received or self._given else 0
        if end.error:
            found |= _ERR | _HUP | _IN | _OUT
        if not end.is_open:
            found |= _HUP | _IN | _OUT
        elif end.is_writable:
            found |= _OUT
        if end.is_ended or self._is_shut_for_reading:
            found |= _IN | _RDHUP
        return found

    def changed(self) -> None:
        super().changed()
        if self._asked and self._end is not None and self._end.received and self._computer.is_in_c and not self._given:
            self._given = self._end.received.take(self._asked)

    def _wait(self, mask: int, timeout: float | None, late: type[OSError] = TimeoutError) -> None:
        """Wait for one of these events, or for the end of the socket."""
        mask |= _ALWAYS
        if not self.events() & mask:
            scheduler = self._scheduler()
            if timeout == 0.0:
                raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
            self._until = scheduler.deadline(timeout)
            while not self.events() & mask:
                if not self.wait_for(mask, self._until):
                    raise late(errno.EAGAIN, "timed out") if late is BlockingIOError else late("timed out")
        if self._number < 0 and not self._is_shut_for_reading:
            raise OSError(errno.EBADF, "Bad file descriptor")

    def _scheduler(self) -> Scheduler:
        scheduler = current()
        if scheduler is None:
            raise OSError(errno.EBADF, "a thread outside of the simulation cannot use the simulated network")
        return scheduler

    def _step(self) -> None:
        self._scheduler().step()
        self._alive()

    def _alive(self) -> None:
        if self._number < 0:
            raise OSError(errno.EBADF, "Bad file descriptor")

    def _connected(self) -> End:
        self._alive()
        if self._end is None or not (self._end.is_connected or self._end.error):
            raise OSError(errno.ENOTCONN, "Transport endpoint is not connected")
        return self._end

    def _take_error(self) -> int:
        if self._connecting != -1:
            self._connecting = None
        if self._end is None:
            return 0
        error, self._end.error = self._end.error, 0
        return error

    def _raise_error(self, end: End) -> None:
        error, end.error = end.error, 0
        if error:
            raise OSError(error, os.strerror(error))


def _never() -> bool:
    return False


def _takes_nothing(data: Deferred | SteadyBytes) -> tuple[bool, float | None]:
    return False, None


class Sockets:
    """Sockets of a simulation, by their descriptors."""

    def __init__(self, scheduler: Scheduler, network: Network) -> None:
        self.scheduler = scheduler
        self.network = network
        self._open: dict[int, Pollable] = {}

    def computer(self) -> Computer:
        """Return the computer of the running task."""
        return cast("Computer", self.scheduler.running.computer)

    def open(self, opened: Pollable) -> int:
        number = _FIRST
        while number in self._open:
            number += 1
        self._open[number] = opened
        return number

    def forget(self, number: int) -> None:
        self._open.pop(number, None)

    def find(self, which: Any) -> Pollable | None:
        """Return the object with this descriptor; None if it does not belong to the simulation."""
        return self._open.get(_descriptor(which))

    @property
    def count(self) -> int:
        """Number of open sockets."""
        return sum(isinstance(each, Socket) for each in self._open.values())

    def pair(self) -> tuple[Socket, Socket]:
        """Replacement for `socket.socketpair`."""
        computer = self.computer()
        ends = End(self.network, computer, 0), End(self.network, computer, 0)
        for one, other in (ends, ends[::-1]):
            one.peer, one.is_connected = other, True
            # A pair belongs to the process rather than to the network. If its own pair broke, an event loop would never
            # wait again.
            computer.ends.pop(one)
        family = getattr(_socket, "AF_UNIX", _socket.AF_INET)  # Windows' Python has no AF_UNIX
        here, there = (Socket(self, family, _socket.SOCK_STREAM, 0, end) for end in ends)
        return here, there

    def addresses(self, host: Any, port: Any, family: int = 0, type: int = 0, proto: int = 0, flags: int = 0) -> Any:
        """Replacement for `socket.getaddrinfo`."""
        name = host.decode() if isinstance(host, bytes) else host
        name = name or ("0.0.0.0" if flags & _socket.AI_PASSIVE else "127.0.0.1")
        found = self.network.find(name, self.computer())
        is_numeric = name.replace(".", "").isdigit()
        if not is_numeric and (found is None or flags & _socket.AI_NUMERICHOST):
            raise _socket.gaierror(_socket.EAI_NONAME, "Name or service not known")
        address = name if is_numeric else "127.0.0.1" if found is self.computer() else found.address if found else name
        kind = _socket.SocketKind(type or _socket.SOCK_STREAM)
        return [(_socket.AF_INET, kind, proto or 6, "", (address, int(port or 0)))]

    def select(self, r: Iterable[Any], w: Iterable[Any], x: Iterable[Any], timeout: float | None = None) -> Any:
        """Replacement for `select.select`."""
        wanted = [(each, _IN) for each in r] + [(each, _OUT) for each in w]
        found = self.wait({_descriptor(each): mask for each, mask in wanted}, timeout)
        ready = [(each, mask) for each, mask in wanted if found.get(_descriptor(each), 0) & mask]
        return [e for e, m in ready if m == _IN], [e for e, m in ready if m == _OUT], []

    def wait(self, wanted: Mapping[int, int], timeout: float | None) -> dict[int, int]:
        """Wait for events of descriptors; return {descriptor: mask}, empty on a timeout."""
        scheduler = self.scheduler
        scheduler.step()
        deadline = scheduler.deadline(timeout)
        task = scheduler.running
        while True:
            found = {}
            watched = []
            for number, mask in wanted.items():
                each = self._open.get(number)
                if hit := (_NVAL if each is None else each.events()) & (mask | _ALWAYS):
                    found[number] = hit
                elif each is not None:
                    watched.append((each, (task, mask | _ALWAYS)))
            if found or (timeout is not None and timeout <= 0):
                return found
            for each, waiter in watched:
                each._waiters.append(waiter)
            if not scheduler.wait(deadline):
                timeout = 0
            for each, waiter in watched:
                each._waiters.remove(waiter)


def _descriptor(which: Any) -> int:
    return which if isinstance(which, int) else which.fileno()


class Poll:
    """Replacement for `select.poll`."""

    def __init__(self, sockets: Sockets) -> None:
        self._sockets = sockets
        self._wanted: dict[int, int] = {}

    def register(self, fd: Any, eventmask: int = _IN | _PRI | _OUT) -> None:
        self._wanted[_descriptor(fd)] = eventmask

    modify = register

    def unregister(self, fd: Any) -> None:
        del self._wanted[_descriptor(fd)]

    def poll(self, timeout: float | None = None) -> list[tuple[int, int]]:
        seconds = None if timeout is None or timeout < 0 else timeout * 1e-3
        return list(self._sockets.wait(self._wanted, seconds).items())


class _Calls:
    """Calls in place of a task that selects; see `Selector.select_or_call`.

    Args:
        scheduler: Scheduler.
        call: Function to call. It returns the seconds until the next call; None if the task must continue.

    Attributes:
        is_over: Whether there are no more calls.
    """

    def __init__(self, scheduler: Scheduler, call: Callable[[], float | None]) -> None:
        self._scheduler = scheduler
        self._task = scheduler.running
        self._call = call
        self.is_over = False

    def schedule(self, seconds: float) -> None:
        """Make the next call after this time."""
        scheduler = self._scheduler
        scheduler.call_at(scheduler.now + seconds / self._task.computer.rate, self._make)

    def _make(self) -> None:
        if self.is_over:
            return
        scheduler, task, again = self._scheduler, self._task, None
        if task.computer.is_running and scheduler.is_idle:
            try:
                again = scheduler.stand_in(task, self._call)
            except Exception as error:
                task.error = error
        if again is None:
            self.is_over = True
            scheduler.make_ready(task)
        else:
            self.schedule(again)


class Selector(Pollable, selectors._BaseSelectorImpl):
    """Replacement for `selectors.DefaultSelector`. Its deadlines have the resolution of the clock.

    Like epoll, the selector has a descriptor. It checks only objects that have changed since they last had nothing to
    report. It reports nothing for closed objects.
    """

    def __init__(self, sockets: Sockets) -> None:
        selectors._BaseSelectorImpl.__init__(self)
        Pollable.__init__(self, sockets)
        # Descriptor and events of each registered object, and the objects to check, in the order of their changes.
        self._watched: dict[Pollable, tuple[int, int]] = {}
        self._changed: dict[Pollable, None] = {}

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        key = super().register(fileobj, events, data)
        found = self._sockets.find(key.fd)
        if found is None:
            super().unregister(fileobj)
            raise OSError(errno.EBADF, "Bad file descriptor")
        mask = (_IN if events & selectors.EVENT_READ else 0) | (_OUT if events & selectors.EVENT_WRITE else 0)
        self._watched[found] = key.fd, mask | _ALWAYS
        found.selectors.append(self)
        self.look_at(found)
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        key = super().unregister(fileobj)
        found = next(each for each, (number, _) in self._watched.items() if number == key.fd)
        found.selectors.remove(self)
        self._changed.pop(found, None)
        del self._watched[found]
        return key

    def close(self) -> None:
        for found in self._watched:
            found.selectors.remove(self)
        self._watched.clear()
        self._changed.clear()
        super().close()
        self._sockets.forget(self._number)

    def look_at(self, found: Pollable) -> None:
        """Note that a registered object has changed."""
        self._changed[found] = None
        if self._waiters:
            self.changed()

    def events(self) -> int:
        return _IN if self._ready() else 0

    def _ready(self) -> list[tuple[int, int]]:
        """Return (descriptor, events) of each object that can be reported."""
        ready = []
        for found in list(self._changed):
            number, mask = self._watched[found]
            hit = found.events() & mask
            if hit and hit != _NVAL:
                ready.append((number, hit))
            else:
                del self._changed[found]
        return ready

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        scheduler = self._sockets.scheduler
        scheduler.step()
        deadline = scheduler.deadline(timeout)
        while not (found := self._ready()) and (timeout is None or timeout > 0):
            if not self.wait_for(_IN, deadline):
                timeout = 0
        return self._keys(found)

    def select_or_call(
        self, seconds: float, call: Callable[[], float | None]
    ) -> list[tuple[selectors.SelectorKey, int]]:
        """Select without a timeout, and call a function after `seconds`, without a change of threads.

        Args:
            seconds: Time until the first call, in s.
            call: Function that must not wait. It returns the seconds until its next call. If it returns None,
                `select_or_call` returns.
        """
        scheduler = self._sockets.scheduler
        scheduler.step()
        calls = _Calls(scheduler, call)
        calls.schedule(seconds)
        while not (found := self._ready()) and not calls.is_over:
            self.wait_for(_IN, None)
        calls.is_over = True
        return self._keys(found)

    def _keys(self, found: list[tuple[int, int]]) -> list[tuple[selectors.SelectorKey, int]]:
        ready = []
        for number, events in found:
            key = self._fd_to_key[number]  # type: ignore[attr-defined]
            mask = selectors.EVENT_READ if events & ~_OUT else 0
            if events & ~_IN:
                mask |= selectors.EVENT_WRITE
            if mask & key.events:
                ready.append((key, mask & key.events))
        return ready
