"""Simulated computers, and TCP between them: what the kernels and the cables do.

Order is kept within a connection and not between two. What is sent is kept until it is acknowledged, and sent again if
it is lost, after 0.2 s at first and twice as long each time (RFC 6298; 0.2 s is Linux's least). So what a program has
given up is still delivered, when the network is back, unless the connection was reset: as on a real network.
"""

from __future__ import annotations

import errno
import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

from .scheduler import Scheduler, Task

#: Bytes that a kernel holds for one direction of a connection, at each end.
BUFFER = 128 * 1024
#: Seconds until something is sent again for the first time, and at most.
_RETRANSMIT = (0.2, 60.0)
#: Seconds between two looks at what is not acknowledged, so that rounding cannot keep the clock where it is.
_LEAST = 1e-4
#: Seconds after which a connection is given up that nobody answers (Linux: tcp_syn_retries 6).
_CONNECT = 127.0


@dataclass
class Route:
    """One direction between two computers.

    Attributes:
        latency: seconds that a packet takes.
        jitter: up to so many more, drawn for each packet.
        bandwidth: bytes a second.
        is_silent: whether packets are lost.
    """

    latency: float = 1e-4
    jitter: float = 5e-5
    bandwidth: float = 125e6
    is_silent: bool = False


#: Above every number that Linux gives a process, 2**22 at most.
_PIDS = itertools.count(1 << 23)


class Watcher(Protocol):
    """The socket of a connection or a listener, which is told that something has happened to it."""

    def changed(self) -> None:
        """Look again whether there is something to read, or room to write."""


@dataclass(eq=False)
class Computer:
    """A computer with a kernel and one process: suspending or killing it leaves the kernel as it is.

    Attributes:
        name, address: how it is called.
        rate: seconds of its clock for one of the simulation; 1.0001 is 100 ppm fast.
        offset: seconds that its clock had when the simulation began.
        jumped: seconds by which its calendar clock was set; only `time.time` shows them.
        starts_threads: whether its process can start a thread.
        is_running: its process is not suspended.
        is_on: whether it has power: without, it takes and sends no packet, and has forgotten its connections.
        is_in_c: whether a function in C holds the interpreter's lock of its program.
        held: tasks that could run if its process did.
    """

    name: str
    address: str
    scheduler: Scheduler
    #: what `os.getpid` returns there: what this process keeps by it belongs to one computer of one simulation
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
        """Stop its process, as `SIGSTOP` does; the kernel goes on to acknowledge what comes."""
        self.scheduler.suspend(self)

    def resume(self) -> None:
        """Let its process go on."""
        self.scheduler.resume(self)

    def hold(self) -> None:
        """Have a function in C hold the interpreter's lock: no thread of its program executes Python until `release`.

        Unlike one that is suspended, a `recv` that waits completes in the kernel: it returns what came first, although
        later, and the next one what came after that.
        """
        self.is_in_c = True
        self.suspend()

    def release(self) -> None:
        """The function in C returns."""
        self.is_in_c = False
        self.resume()

    def kill(self) -> None:
        """End its process; the kernel closes its sockets, as each was set to be closed."""
        self.scheduler.suspend(self)
        for listener in list(self.listeners.values()):
            listener.close()
        for end in list(self.ends):
            end.close()

    def power_off(self) -> None:
        """Take its power: it sends and takes no packet any more, and its connections are forgotten."""
        self.is_on = False
        self.scheduler.suspend(self)
        self.listeners.clear()
        for end in list(self.ends):
            end.vanish()

    def power_on(self) -> None:
        """Give it power again, with nothing running on it."""
        self.is_on = True

    def port(self) -> int:
        """A port that is free."""
        self.next_port += 1
        while self.next_port in self.listeners:
            self.next_port += 1
        return self.next_port


@dataclass(eq=False)
class Listener:
    """A port that takes connections."""

    computer: Computer
    port: int
    backlog: int
    owner: Watcher
    accepted: deque[End] = field(default_factory=deque)

    def close(self) -> None:
        """Refuse from now on, and reset what nobody has accepted."""
        self.computer.listeners.pop(self.port, None)
        for end in self.accepted:
            end.reset()
        self.accepted.clear()


class End:
    """One end of a connection, as the kernel of its computer has it.

    Attributes:
        received: bytes that the program has not taken.
        error: errno to be reported once; 0 for none.
        is_connected: the handshake is over.
        is_ended: the peer sends nothing more.
        is_open: neither closed here nor broken.
        linger: seconds of SO_LINGER; None where it is off.
        user_timeout: seconds without an acknowledgement after which it is given up; 0 for no limit.
        connecting_to: during the handshake, who is asked.
        refuse: what ends the handshake as a reset does: refused.
    """

    def __init__(self, network: Network, computer: Computer, port: int) -> None:
        self.network = network
        self.computer = computer
        self.port = port
        self.address = computer.address
        self.peer: End | None = None
        self.peer_name: tuple[str, int] = ("", 0)
        self.connecting_to: Computer | None = None
        self.refuse: Callable[[], object] = lambda: None
        self.owner: Watcher | None = None
        self.received = bytearray()
        self.error = 0
        self.is_connected = False
        self.is_ended = False
        self.is_open = True
        self.is_closing = False
        self.is_shut = False
        self.linger: float | None = None
        self.user_timeout = 0.0
        self.send_buffer = BUFFER
        # Segments by their first byte; b"" is the FIN.
        self._sent = 0
        self._acknowledged = 0
        self._segments: deque[tuple[int, bytes]] = deque()
        self._delivered = 0
        self._arrives = 0.0
        self._oldest = 0.0
        self._retransmit = _RETRANSMIT[0]
        self._is_retransmitting = False
        computer.ends[self] = None

    # -- the program's side ------------------------------------------------------------------------------

    @property
    def unacknowledged(self) -> int:
        """Bytes sent and not acknowledged; the FIN counts as one."""
        return self._sent - self._acknowledged

    @property
    def room(self) -> int:
        """Bytes that `send` would take."""
        return max(self.send_buffer - self.unacknowledged, 0)

    def send(self, data: bytes) -> int:
        """Hand bytes to the kernel; how many it took."""
        taken = bytes(data[: self.room])
        if taken:
            self._send(taken, len(taken))
            self.network.scheduler.note(taken)
        return len(taken)

    def take(self, size: int) -> bytes:
        """What has come, at most so many bytes."""
        data = bytes(self.received[:size])
        del self.received[:size]
        return data

    def shut(self) -> None:
        """Send the FIN: there is nothing more to come from here."""
        if not self.is_shut and self.is_open:
            self.is_shut = True
            self._send(b"", 1)

    def close(self) -> None:
        """The program needs it no longer."""
        if not self.is_open or self.is_closing:
            self._forget()
        elif self.linger == 0.0 or self.received or not self.is_connected:
            self.reset()
        else:
            # The kernel goes on delivering.
            self.is_closing = True
            self.shut()

    def reset(self) -> None:
        """Discard what is not acknowledged and send a reset, which is lost where the path is silent."""
        if self.is_open and self.is_connected and self.peer is not None:
            self._send_reset(self.peer)
        self._break(0)
        self._forget()

    def vanish(self) -> None:
        """The computer has lost its power."""
        self._break(0)
        self._forget()

    # -- the network's side ------------------------------------------------------------------------------

    def _send(self, data: bytes, size: int) -> None:
        if not self.unacknowledged:
            self._oldest = self.network.scheduler.now
            self._watch()
        segment = (self._sent, data)
        self._sent += size
        self._segments.append(segment)
        self._transmit(segment)

    def _transmit(self, segment: tuple[int, bytes]) -> None:
        peer = self.peer
        assert peer is not None
        route = self.network.route(self.computer, peer.computer)
        scheduler = self.network.scheduler
        when = (
            scheduler.now + route.latency + route.jitter * scheduler.random.random() + len(segment[1]) / route.bandwidth
        )
        # The order within a connection is kept.
        self._arrives = when = max(when, self._arrives)
        scheduler.call_at(when, lambda: self._arrive(segment))

    def _arrive(self, segment: tuple[int, bytes]) -> None:
        peer = self.peer
        assert peer is not None
        if not self.network.carries(self.computer, peer.computer) or not peer.computer.is_on:
            return  # lost: sent again later
        number, data = segment
        if not peer.is_open and data:
            peer._send_reset(self)
            return
        if number != self._delivered:
            if number < self._delivered:
                self._acknowledge()  # once more: the first acknowledgement was lost
            return
        if data and len(peer.received) + len(data) > BUFFER:
            return  # no room: sent again later
        self._delivered += len(data) or 1
        if data and not peer.is_closing:
            peer.received += data
        elif data:
            peer._send_reset(self)  # nobody will read it
            return
        else:
            peer.is_ended = True
        self._acknowledge()
        peer._changed()

    def _acknowledge(self) -> None:
        peer = self.peer
        assert peer is not None
        delivered = self._delivered
        route = self.network.route(peer.computer, self.computer)

        def acknowledged() -> None:
            if self.network.carries(peer.computer, self.computer) and self.is_open and delivered > self._acknowledged:
                self._acknowledged = delivered
                while self._segments and self._segments[0][0] < delivered:
                    self._segments.popleft()
                self._oldest = self.network.scheduler.now
                self._retransmit = _RETRANSMIT[0]
                if not self.unacknowledged and self.is_closing:
                    self._break(0)
                self._changed()

        self.network.scheduler.call_at(self.network.scheduler.now + route.latency, acknowledged)

    def _watch(self) -> None:
        """See to what is not acknowledged."""
        if self._is_retransmitting:
            return
        self._is_retransmitting = True
        scheduler = self.network.scheduler
        pause = self._retransmit
        if self.user_timeout:
            pause = min(pause, self._oldest + self.user_timeout - scheduler.now)
        scheduler.call_at(scheduler.now + max(pause, _LEAST), self._look)

    def _look(self) -> None:
        self._is_retransmitting = False
        if not self.is_open or not self.unacknowledged:
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

    def _changed(self) -> None:
        if self.owner is not None:
            self.owner.changed()


class Network:
    """The computers and the paths between them.

    Args:
        scheduler: whose time it has.
        route: of each direction between two computers that is not set.
    """

    def __init__(self, scheduler: Scheduler, route: Route) -> None:
        self.scheduler = scheduler
        self.computers: dict[str, Computer] = {}
        self._default = route
        self._routes: dict[tuple[str, str], Route] = {}

    def add(self, name: str, address: str) -> Computer:
        """A computer with a name and an address of its own."""
        computer = Computer(name, address, self.scheduler)
        self.computers[name] = computer
        return computer

    def find(self, host: str, seen_from: Computer) -> Computer | None:
        """The computer with this name or address."""
        if host in ("", "localhost", "0.0.0.0", "::", "::1") or host.startswith("127."):
            return seen_from
        for computer in self.computers.values():
            if host in (computer.name, computer.address):
                return computer
        return None

    def route(self, source: Computer, target: Computer) -> Route:
        """One direction between two computers, to be read or changed."""
        key = (source.name, target.name)
        if key not in self._routes:
            within = Route(latency=1e-5, jitter=1e-5, bandwidth=1e9)
            self._routes[key] = within if source is target else replace(self._default)
        return self._routes[key]

    def carries(self, source: Computer, target: Computer) -> bool:
        """Whether a packet that arrives now does so."""
        return source.is_on and not self.route(source, target).is_silent

    def silence(self, source: Computer, target: Computer) -> None:
        """Lose every packet in one direction, until `mend`."""
        self.route(source, target).is_silent = True

    def cut(self, one: Computer, other: Computer) -> None:
        """Lose every packet between two computers, in both directions, until `mend`."""
        self.silence(one, other)
        self.silence(other, one)

    def mend(self, one: Computer, other: Computer) -> None:
        """Carry packets again."""
        self.route(one, other).is_silent = self.route(other, one).is_silent = False

    def reset(self, one: Computer, other: Computer) -> None:
        """Have every connection between two computers reset at both ends, as by a firewall.

        One that is being made is refused: so Linux reports a reset during the handshake.
        """
        for source, target in ((one, other), (other, one)):
            for end in list(source.ends):
                if end.connecting_to is target:
                    end.refuse()
                elif end.is_open and end.peer is not None and end.peer.computer is target:
                    end._break(errno.ECONNRESET)

    def connect(self, end: End, host: str, port: int, finished: Callable[[int], object]) -> None:
        """Make a connection; `finished` is called with 0 or an errno, unless `end` is closed before."""
        target = self.find(host, end.computer)
        scheduler = self.scheduler
        source = end.computer
        if target is None:
            finished(errno.EHOSTUNREACH)
            return
        if target is source:
            end.address = "127.0.0.1" if not host or host in ("localhost", "0.0.0.0") else host
        begun = scheduler.now

        def ended(outcome: int) -> None:
            end.connecting_to, end.refuse = None, lambda: None
            finished(outcome)

        def ask(pause: float) -> None:
            if not end.is_open or end.is_connected:
                return
            if scheduler.now - begun >= _CONNECT:
                ended(errno.ETIMEDOUT)
                return
            scheduler.call_at(scheduler.now + self.route(source, target).latency, arrive)
            scheduler.call_at(scheduler.now + pause, lambda: ask(2 * pause))

        def answer(what: Callable[[], object]) -> None:
            if self.carries(target, source):
                scheduler.call_at(scheduler.now + self.route(target, source).latency, what)

        def arrive() -> None:
            if not end.is_open or end.is_connected or not self.carries(source, target) or not target.is_on:
                return
            listener = target.listeners.get(port)
            if listener is None:
                answer(refused)
            elif end.peer is None and len(listener.accepted) <= listener.backlog:
                peer = End(self, target, port)
                peer.address = end.address if target is source else target.address
                peer.peer, end.peer = end, peer
                peer.peer_name = (end.address, end.port)
                peer.is_connected = True
                listener.accepted.append(peer)
                listener.owner.changed()
                answer(connected)
            elif end.peer is not None:
                answer(connected)

        def refused() -> None:
            if end.is_open and not end.is_connected:
                ended(errno.ECONNREFUSED)

        def connected() -> None:
            if not end.is_open and end.peer is not None:
                end._send_reset(end.peer)  # given up meanwhile
            elif not end.is_connected and self.carries(target, source):
                end.is_connected = True
                ended(0)

        end.connecting_to, end.refuse = target, refused
        ask(1.0)
