"""Simulated computers and TCP connections between them, including the behaviour of operating systems and cables.

The order of data is kept within a connection, but not between two connections. Sent data are kept until they are
acknowledged. Lost data are sent again. The first wait is 0.2 s, the minimum of Linux, and each further wait is twice as
long as the previous one (RFC 6298). So data of an abandoned command are still delivered when the network works again,
unless the connection was reset, as on a real network.
"""

from __future__ import annotations

import errno
import itertools
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

from ..deferred import Deferred, DeferredBatch, SteadyBytes
from .scheduler import Check, Scheduler, Task

#: Size of a kernel's buffer for one direction of a connection, at each end, in bytes.
BUFFER = 128 * 1024
#: Time until the first retransmission, and maximum time between retransmissions, in s.
_RETRANSMIT = (0.2, 60.0)
#: Minimum time between two checks for unacknowledged data, in s, so that rounding cannot stop the clock.
_LEAST = 1e-4
#: Time after which a connection attempt without an answer ends, in s (Linux: tcp_syn_retries 6).
_CONNECT = 127.0


@dataclass
class Route:
    """Network path in one direction between two computers.

    Attributes:
        latency: Time that a packet takes, in s.
        jitter: Maximum additional time, in s, which is drawn for each packet.
        bandwidth: Bandwidth, in bytes per second.
        is_silent: Whether packets are lost.
    """

    latency: float = 1e-4
    jitter: float = 5e-5
    bandwidth: float = 125e6
    is_silent: bool = False


#: Process ids above every number that Linux assigns, which is at most 2**22.
_PIDS = itertools.count(1 << 23)


class Watcher(Protocol):
    """Socket of a connection or a listener, which is notified of events."""

    def changed(self) -> None:
        """Check again whether there is something to read, or room to write."""

    def pass_on(self, data: Deferred | SteadyBytes) -> bool:
        """Pass arrived data to the program without a change of threads; return False if this is not possible now."""


@dataclass(eq=False)
class Computer:
    """Simulated computer with a kernel and one process.

    Suspending or killing the process does not affect the kernel.

    Attributes:
        name, address: Name and address of the computer.
        rate: Seconds by which the clock advances per second of the simulation; with 1.0001, the clock is 100 ppm too
            fast.
        offset: Time of its clock at the start of the simulation, in s.
        jumped: Adjustment of its calendar clock, in s; only `time.time` shows it.
        starts_threads: Whether its process can start a thread.
        is_running: Whether the process is running, so that it is not suspended.
        is_on: Whether it has power. Without power, it neither receives nor sends packets, and has lost its connections.
        is_in_c: Whether a function in C holds the interpreter's lock of its program.
        held: Tasks that could run if its process were running.
    """

    name: str
    address: str
    scheduler: Scheduler
    #: Result of `os.getpid` on this computer. Objects that this process keeps by it belong to one computer of one
    #: simulation.
    pid: int = field(default_factory=_PIDS.__next__)
    rate: float = 1.0
    offset: float = 1000.0
    jumped: float = 0.0
    starts_threads: bool = True
    is_running: bool = True
    is_on: bool = True
    is_in_c: bool = False
    held: list[Task] = field(default_factory=list)
    listeners: dict[int, Listener] = field(default_factory=dict)
    ends: dict[End, None] = field(default_factory=dict)
    next_port: int = 32768

    def suspend(self) -> None:
        """Suspend the process, as `SIGSTOP` does. The kernel continues to acknowledge data."""
        self.scheduler.suspend(self)

    def resume(self) -> None:
        """Let the suspended process continue."""
        self.scheduler.resume(self)

    def hold(self) -> None:
        """Simulate a function in C that holds the interpreter lock until `release`.

        No thread of the program executes Python in the meantime. In contrast to a suspended process, a waiting `recv`
        completes in the kernel: it returns the first data that arrived, although later. The next `recv` returns the
        data that arrived after that.
        """
        self.is_in_c = True
        self.suspend()

    def release(self) -> None:
        """Let the function in C return."""
        self.is_in_c = False
        self.resume()

    def kill(self) -> None:
        """End the process. The kernel closes the sockets of the process according to their options."""
        self.scheduler.suspend(self)
        for listener in list(self.listeners.values()):
            listener.close()
        for end in list(self.ends):
            end.close()

    def power_off(self) -> None:
        """Switch the computer off. It then neither receives nor sends packets, and loses its connections."""
        self.is_on = False
        self.scheduler.suspend(self)
        self.listeners.clear()
        for end in list(self.ends):
            end.vanish()

    def power_on(self) -> None:
        """Switch the computer on again. No process is running then."""
        self.is_on = True

    def port(self) -> int:
        """Return a free port."""
        self.next_port += 1
        while self.next_port in self.listeners:
            self.next_port += 1
        return self.next_port


@dataclass(eq=False)
class Listener:
    """Port that accepts connections."""

    computer: Computer
    port: int
    backlog: int
    owner: Watcher
    accepted: deque[End] = field(default_factory=deque)

    def close(self) -> None:
        """Refuse new connections, and reset the connections that the program has not accepted."""
        self.computer.listeners.pop(self.port, None)
        for end in self.accepted:
            end.reset()
        self.accepted.clear()


class ReceiveBuffer:
    """Data that a kernel has received for a program. A packet whose bytes are not made yet stays one object.

    Attributes:
        size: Number of bytes.
    """

    def __init__(self) -> None:
        self._chunks: deque[bytes | memoryview | Deferred] = deque()
        self.size = 0

    def __len__(self) -> int:
        return self.size

    def put(self, data: bytes | Deferred) -> None:
        """Append received data."""
        self._chunks.append(data)
        self.size += len(data)

    def peek(self, size: int) -> bytes:
        """Return the first bytes, at most `size`."""
        return b"".join(map(bytes, self._chunks))[:size]

    def take(self, size: int) -> bytes:
        """Return and remove the first bytes, at most `size`."""
        chunks, taken = self._chunks, []
        while chunks and size > 0:
            chunk = bytes(chunks.popleft())
            if len(chunk) > size:
                chunks.appendleft(memoryview(chunk)[size:])
                chunk = chunk[:size]
            taken.append(chunk)
            size -= len(chunk)
            self.size -= len(chunk)
        return taken[0] if len(taken) == 1 else b"".join(taken)

    def take_deferred(self, size: int) -> bytes | Deferred:
        """Return and remove the same as `take`, but leave a single packet as it is."""
        first = self._chunks[0]
        if len(self._chunks) > 1 or isinstance(first, (bytes, memoryview)) or len(first) > size:
            return self.take(size)
        self._chunks.clear()
        self.size = 0
        return first


class End:
    """One end of a connection, as the operating system of a computer stores it.

    Attributes:
        received: Data that the program has not read.
        error: Error number to be reported once; 0 for none.
        is_connected: Whether the handshake is complete.
        is_ended: Whether the peer has finished sending.
        is_open: Whether the end is neither closed nor broken.
        linger: SO_LINGER, in s; None if it is off.
        user_timeout: Time without an acknowledgement after which the connection is aborted, in s; 0 for no limit.
        handshake: Attempt to connect, while it lasts.
    """

    def __init__(self, network: Network, computer: Computer, port: int) -> None:
        self.network = network
        self.computer = computer
        self.port = port
        self.address = computer.address
        self.peer: End | None = None
        self.peer_name: tuple[str, int] = ("", 0)
        self.handshake: _Handshake | None = None
        self.owner: Watcher | None = None
        self.received = ReceiveBuffer()
        self.error = 0
        self.is_connected = False
        self.is_ended = False
        self.is_open = True
        self.is_closing = False
        self.is_shut = False
        self.linger: float | None = None
        self.user_timeout = 0.0
        self.send_buffer = BUFFER
        # Segments by the number of their first byte; b"" is the FIN.
        self._sent = 0
        self._acknowledged = 0
        self._segments: deque[tuple[int, bytes | Deferred]] = deque()
        self._delivered = 0
        self._arrives = 0.0
        self._oldest = 0.0
        self._retransmit = _RETRANSMIT[0]
        self._is_retransmitting = False
        self._is_forgotten = False
        computer.ends[self] = None

    # -- the program's side ------------------------------------------------------------------------------

    @property
    def unacknowledged(self) -> int:
        """Number of bytes that are sent but not acknowledged; the FIN counts as one."""
        return self._sent - self._acknowledged

    @property
    def room(self) -> int:
        """Number of bytes that `send` would accept."""
        return max(self.send_buffer - self.unacknowledged, 0)

    @property
    def is_writable(self) -> bool:
        """Whether a third of the send buffer is free; only then, Linux reports room."""
        return 3 * (self.send_buffer - self._sent + self._acknowledged) >= self.send_buffer

    def send(self, data: bytes | Deferred) -> int:
        """Pass data to the kernel; return the number of bytes that it accepted."""
        size, room = len(data), self.room
        if size > room:
            data, size = bytes(data)[:room], room
        if size:
            self._send(data, size)
            self.network.scheduler.note(data if isinstance(data, bytes) else data.head)
        return size

    def send_batch(self, packets: Sequence[Deferred | SteadyBytes], delays: Sequence[float]) -> None:
        """Send packets, each after a delay in s from now. They arrive together, when the last one arrives.

        The caller has checked `quiet_time` and `room`.
        """
        assert self.peer is not None
        route, scheduler = self.network.route(self.computer, self.peer.computer), self.network.scheduler
        now, jitter, draw, arrives = scheduler.now, route.jitter, scheduler.random.random, self._arrives
        arrivals = []
        takes = route.latency + len(packets[0]) / route.bandwidth
        for delay in delays:
            arrives = max(now + delay + takes + jitter * draw(), arrives)
            arrivals.append(arrives)
        self._arrives = arrives
        batch = DeferredBatch(packets, [arrives - each for each in arrivals])
        scheduler.note(batch.head)
        self._send(batch, len(batch))

    def pass_on(self, packet: Deferred | SteadyBytes) -> bool:
        """Send a steady packet, and let time pass until it arrives.

        Return False, and send nothing, if anything else could happen before that. The function replaces the events of
        sending, arrival and acknowledgement. It is for a call of `Scheduler.call_at` that does nothing else afterwards.
        """
        peer, size, scheduler = self.peer, len(packet), self.network.scheduler
        if peer is None or self._quiet_time(size) <= 0.0 or peer.is_closing or peer.received.size + size > BUFFER:
            return False
        route = self.network.route(self.computer, peer.computer)
        takes = route.latency + route.jitter * scheduler.random.random() + size / route.bandwidth
        scheduler.note(packet.head)
        scheduler.now = self._arrives = max(scheduler.now + takes, self._arrives)
        self._sent = self._acknowledged = self._delivered = self._sent + size
        peer._receive(packet)
        return True

    @property
    def quiet_time(self) -> float:
        """Time in s during which packets can be sent so that they arrive before anything else happens."""
        return self._quiet_time(BUFFER)

    def _quiet_time(self, size: int) -> float:
        """Return the same as `quiet_time`, for at most this number of bytes."""
        peer = self.peer
        if peer is None or self.unacknowledged or not (self.is_open and peer.is_open and peer.computer.is_running):
            return 0.0
        route = self.network.route(self.computer, peer.computer)
        if route.is_silent:
            return 0.0
        longest = route.latency + route.jitter + size / route.bandwidth
        return self.network.scheduler.quiet_until - self.network.scheduler.now - longest

    def shut(self) -> None:
        """Send the FIN: this end has finished sending."""
        if not self.is_shut and self.is_open:
            self.is_shut = True
            self._send(b"", 1)

    def close(self) -> None:
        """Close this end, because the program no longer needs it."""
        if not self.is_open or self.is_closing:
            self._forget()
        elif self.linger == 0.0 or self.received or not self.is_connected:
            self.reset()
        else:
            # The kernel continues to deliver.
            self.is_closing = True
            self.shut()

    def reset(self) -> None:
        """Discard unacknowledged data and send a reset, which is lost if the path is silent."""
        if self.is_open and self.is_connected and self.peer is not None:
            self._send_reset(self.peer)
        self._break(0)
        self._forget()

    def vanish(self) -> None:
        """Discard the connection, because the computer has lost its power."""
        self._break(0)
        self._forget()

    # -- the network's side ------------------------------------------------------------------------------

    def _send(self, data: bytes | Deferred, size: int) -> None:
        if not self.unacknowledged:
            self._oldest = self.network.scheduler.now
            self._watch()
        segment = (self._sent, data)
        self._sent += size
        self._segments.append(segment)
        self._transmit(segment)

    def _transmit(self, segment: tuple[int, bytes | Deferred]) -> None:
        peer = self.peer
        assert peer is not None
        route = self.network.route(self.computer, peer.computer)
        scheduler = self.network.scheduler
        if isinstance(segment[1], DeferredBatch):
            when = max(scheduler.now + route.latency, self._arrives)  # `send_batch` has determined it
        else:
            when = (
                scheduler.now
                + route.latency
                + route.jitter * scheduler.random.random()
                + len(segment[1]) / route.bandwidth
            )
        # The order within a connection is kept.
        self._arrives = when = max(when, self._arrives)
        scheduler.call_at(when, lambda: self._arrive(segment))

    def _arrive(self, segment: tuple[int, bytes | Deferred]) -> None:
        peer = self.peer
        if peer is None:
            return  # both ends were closed
        if not self.network.carries(self.computer, peer.computer) or not peer.computer.is_on:
            return  # lost: sent again later
        number, data = segment
        if not peer.is_open and data:
            peer._send_reset(self)
            return
        if number != self._delivered:
            if number < self._delivered:
                self._acknowledge()  # again, because the first acknowledgement was lost
            return
        if data and len(peer.received) + len(data) > BUFFER:
            return  # no room: sent again later
        self._delivered += len(data) or 1
        if data and peer.is_closing:
            peer._send_reset(self)  # no program will read it
            return
        if data:
            peer._receive(data)
        else:
            peer.is_ended = True
            peer._changed()
        self._acknowledge()

    def _receive(self, data: bytes | Deferred) -> None:
        """Pass arrived data to the program, or keep them until the program reads them."""
        owner = self.owner
        if (
            isinstance(data, (Deferred, SteadyBytes))
            and not self.received.size
            and owner is not None
            and owner.pass_on(data)
        ):
            return
        self.received.put(data)
        self._changed()

    def _acknowledge(self) -> None:
        peer = self.peer
        assert peer is not None
        delivered = self._delivered
        route = self.network.route(peer.computer, self.computer)

        def acknowledged() -> None:
            if self.network.carries(peer.computer, self.computer) and self.is_open and delivered > self._acknowledged:
                was_full = not self.is_writable
                self._acknowledged = delivered
                while self._segments and self._segments[0][0] < delivered:
                    self._segments.popleft()
                self._oldest = self.network.scheduler.now
                self._retransmit = _RETRANSMIT[0]
                if not self.unacknowledged and self.is_closing:
                    self._break(0)
                if was_full:
                    self._changed()

        self.network.scheduler.call_at(self.network.scheduler.now + route.latency, acknowledged)

    def _watch(self) -> None:
        """Schedule a check of unacknowledged data."""
        if self._is_retransmitting:
            return
        self._is_retransmitting = True
        scheduler = self.network.scheduler
        pause = self._retransmit
        if self.user_timeout:
            pause = min(pause, self._oldest + self.user_timeout - scheduler.now)
        # An attribute with the check would be part of a reference cycle, and simulated time runs without the garbage
        # collector.
        check = Check(self._look, self._needs_look)
        scheduler.call_at(scheduler.now + max(pause, _LEAST), check)

    def _needs_look(self) -> bool:
        return self.is_open and self.unacknowledged > 0

    def _look(self) -> None:
        self._is_retransmitting = False
        if not self._needs_look():
            return
        waited = self.network.scheduler.now - self._oldest
        if self.user_timeout and waited >= self.user_timeout:
            self._break(errno.ETIMEDOUT)
            return
        if waited >= self._retransmit:
            self._retransmit = min(2 * self._retransmit, _RETRANSMIT[1])
            for segment in list(self._segments):
                self._transmit(segment)
        self._watch()

    def _send_reset(self, peer: End) -> None:
        route = self.network.route(self.computer, peer.computer)

        def arrive() -> None:
            if self.network.carries(self.computer, peer.computer) and peer.computer.is_on and peer.is_open:
                peer._break(errno.ECONNRESET)

        scheduler = self.network.scheduler
        scheduler.call_at(max(scheduler.now + route.latency, self._arrives), arrive)

    def _break(self, error: int) -> None:
        self.is_open = False
        self.error = error
        self._segments.clear()
        self._sent = self._acknowledged
        if self.is_closing:
            self._forget()
        self._changed()

    def _forget(self) -> None:
        self.computer.ends.pop(self, None)
        self._is_forgotten, self.handshake = True, None
        peer = self.peer
        if peer is not None and peer._is_forgotten:
            self.peer = peer.peer = None  # breaks a reference cycle

    def _changed(self) -> None:
        if self.owner is not None:
            self.owner.changed()


class Network:
    """Simulated network: computers, and the paths between them.

    Args:
        scheduler: Scheduler that provides the time.
        route: Default for each direction between two computers.
    """

    def __init__(self, scheduler: Scheduler, route: Route) -> None:
        self.scheduler = scheduler
        self.computers: dict[str, Computer] = {}
        self._default = route
        self._routes: dict[tuple[str, str], Route] = {}

    def add(self, name: str, address: str) -> Computer:
        """Add a computer with its own name and address."""
        computer = Computer(name, address, self.scheduler)
        self.computers[name] = computer
        return computer

    def find(self, host: str, seen_from: Computer) -> Computer | None:
        """Return the computer with this name or address; None if there is none."""
        if host in ("", "localhost", "0.0.0.0", "::", "::1") or host.startswith("127."):
            return seen_from
        for computer in self.computers.values():
            if host in (computer.name, computer.address):
                return computer
        return None

    def route(self, source: Computer, target: Computer) -> Route:
        """Return the route from one computer to another. Its attributes can be read and changed."""
        key = (source.name, target.name)
        if key not in self._routes:
            within = Route(latency=1e-5, jitter=1e-5, bandwidth=1e9)
            self._routes[key] = within if source is target else replace(self._default)
        return self._routes[key]

    def carries(self, source: Computer, target: Computer) -> bool:
        """Whether a packet from `source` that reaches `target` now is received."""
        return source.is_on and not self.route(source, target).is_silent

    def silence(self, source: Computer, target: Computer) -> None:
        """Lose every packet in one direction, until `mend`."""
        self.route(source, target).is_silent = True

    def cut(self, one: Computer, other: Computer) -> None:
        """Lose every packet between two computers, in both directions, until `mend`."""
        self.silence(one, other)
        self.silence(other, one)

    def mend(self, one: Computer, other: Computer) -> None:
        """Let packets pass again."""
        self.route(one, other).is_silent = self.route(other, one).is_silent = False

    def reset(self, one: Computer, other: Computer) -> None:
        """Reset every connection between two computers at both ends, as a firewall does.

        A connection attempt in progress is refused, because Linux reports a reset during the handshake as a refusal.
        """
        for source, target in ((one, other), (other, one)):
            for end in list(source.ends):
                if end.handshake is not None and end.handshake.target is target:
                    end.handshake.refuse()
                elif end.is_open and end.peer is not None and end.peer.computer is target:
                    end._break(errno.ECONNRESET)

    def connect(self, end: End, host: str, port: int, finished: Callable[[int], object]) -> None:
        """Make a connection, and call `finished` with 0 or an error number.

        If `end` is closed before that, `finished` is not called.
        """
        target = self.find(host, end.computer)
        if target is None:
            finished(errno.EHOSTUNREACH)
            return
        if target is end.computer:
            end.address = "127.0.0.1" if not host or host in ("localhost", "0.0.0.0") else host
        end.handshake = _Handshake(self, end, target, port, finished)
        end.handshake.ask()


class _Handshake:
    """Attempt to connect one end to a port of a computer.

    Args:
        network: Network.
        end: End of the connection at the computer that connects.
        target: Computer to connect to.
        port: Port to connect to.
        finished: Function that is called with 0 or an error number.

    Attributes:
        target: See the argument.
    """

    def __init__(
        self, network: Network, end: End, target: Computer, port: int, finished: Callable[[int], object]
    ) -> None:
        self.target = target
        self._network = network
        self._scheduler = network.scheduler
        self._end = end
        self._port = port
        self._finished = finished
        self._begun = self._scheduler.now
        self._pause = 1.0

    def ask(self) -> None:
        """Send a request, and send it again until there is an answer."""
        end, scheduler = self._end, self._scheduler
        if not end.is_open or end.is_connected:
            return
        if scheduler.now - self._begun >= _CONNECT:
            self._over(errno.ETIMEDOUT)
            return
        route = self._network.route(end.computer, self.target)
        scheduler.call_at(scheduler.now + route.latency, self._arrive)
        scheduler.call_at(scheduler.now + self._pause, self.ask)
        self._pause *= 2

    def refuse(self) -> None:
        """End the attempt with a refusal, as after a reset."""
        if self._end.is_open and not self._end.is_connected:
            self._over(errno.ECONNREFUSED)

    def _over(self, outcome: int) -> None:
        self._end.handshake = None
        self._finished(outcome)

    def _arrive(self) -> None:
        """Process the request at the target."""
        network, end, target = self._network, self._end, self.target
        if not end.is_open or end.is_connected or not network.carries(end.computer, target) or not target.is_on:
            return
        listener = target.listeners.get(self._port)
        if listener is None:
            self._answer(self.refuse)
        elif end.peer is None and len(listener.accepted) <= listener.backlog:
            peer = End(network, target, self._port)
            peer.address = end.address if target is end.computer else target.address
            peer.peer, end.peer = end, peer
            peer.peer_name = (end.address, end.port)
            peer.is_connected = True
            listener.accepted.append(peer)
            listener.owner.changed()
            self._answer(self._connected)
        elif end.peer is not None:
            self._answer(self._connected)

    def _answer(self, what: Callable[[], object]) -> None:
        back, scheduler = (self.target, self._end.computer), self._scheduler
        if self._network.carries(*back):
            scheduler.call_at(scheduler.now + self._network.route(*back).latency, what)

    def _connected(self) -> None:
        end = self._end
        if not end.is_open and end.peer is not None:
            end._send_reset(end.peer)  # closed in the meantime
        elif not end.is_connected and self._network.carries(self.target, end.computer):
            end.is_connected = True
            self._over(0)
