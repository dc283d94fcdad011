"""The controller's ports: one thread that keeps the clock and serves every client.

Deadlines are absolute: cycle k is due k periods after the start, however late the one before was. A cycle that comes
late is caught up, and its packets still go out, as they would from a network that hiccups; beyond `LATEST` they are not
worth sending and are counted instead.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from linkcore.net.loop import Connection, Handler, ListeningPort, SelectorLoop

from ..ports import interface
from .assembly import Assembler
from .controller import STATE_RATE
from .intake import Intake

if TYPE_CHECKING:
    from .controller import Controller
    from .tampering import Segmenter

__all__ = ["Server"]

#: Seconds after which a packet is not worth sending any more.
LATEST = 0.25
#: Seconds beyond which the clock is set anew rather than caught up: the machine slept.
ASLEEP = 5.0
#: Seconds of catching up after which the sockets are served again, however far behind the clock is. A program can make
#: cycles that cost more than they last.
LONGEST_CATCH_UP = 0.05
#: Bytes taken from a client at once: each line of them may be a program.
RECEIVED_AT_ONCE = 1 << 12
#: Bytes of a line from a client; longer ones are thrown away.
LONGEST_LINE = 1 << 16
#: Seconds that other threads wait for the server's.
PATIENCE = 5.0
#: Seconds that a dashboard client has to take the last reply before its connection is closed.
LAST_REPLY = 2.0


class Client(Handler):
    """One connection, and the line that is being received.

    Attributes:
        port: name of the port.
        kind: name of the interface that it speaks.
        connection: what its bytes go to.
        assembler: makes programs of its lines.
        segmenter: of what is sent, or None where packets are sent as they are.
    """

    def __init__(self, server: Server, port: str, connection: Connection) -> None:
        self.port = port
        self.kind = interface(port)
        self.connection = connection
        self.assembler = Assembler()
        self.segmenter: Segmenter | None = None
        self._server = server
        self._line = bytearray()
        self._is_too_long = False

    def data_received(self, data: bytes) -> None:
        server = self._server
        if self.port != self.kind:
            # Text to a read-only port has no effect.
            server.refuse(len(data))
            return
        # What a line does begins in the next cycle, not in one after that at which the clock was looked at last.
        server.catch_up()
        *lines, rest = data.split(b"\n")
        for line in lines:
            if not self.connection.is_open:
                return
            self._extend(line)
            text = self._end()
            if text is not None:
                server.take(self, text)
        self._extend(rest)

    def connection_lost(self, reason: str, *, by_peer: bool) -> None:
        self._server.clients.discard(self)

    def _extend(self, part: bytes) -> None:
        """More of the line that is being received; thrown away where it gets too long."""
        if self._is_too_long or len(self._line) + len(part) > LONGEST_LINE:
            self._server.refuse(len(self._line) + len(part))
            self._line.clear()
            self._is_too_long = True
        else:
            self._line += part

    def _end(self) -> str | None:
        """The line, now that it is whole; None if it was too long."""
        text = None if self._is_too_long else self._line.decode("utf-8", "backslashreplace").removesuffix("\r")
        self._line.clear()
        self._is_too_long = False
        return text


class Server:
    """Serves the ports of one controller from one thread, which from then on owns the controller.

    Args:
        controller: to be served.
        host: address to listen on.
        ports: name -> number, 0 for a free one.

    Attributes:
        clients: connected at present.

    Raises:
        BadAddress: a port cannot be listened on.
    """

    def __init__(self, controller: Controller, host: str, ports: Mapping[str, int]) -> None:
        self.clients: set[Client] = set()
        self._controller = controller
        self._counters = controller.counters
        self._faults = controller.faults
        self._loop = SelectorLoop()
        self._intake = Intake(controller, self._loop.wake)
        self._is_closing = False
        self._is_called = False
        self._rate = controller.firmware.rate
        #: time of cycle 0 on the monotonic clock, and the cycles that are over
        self._epoch = 0.0
        self._done = 0
        self._segments_seen = self._faults.segments_changed
        self._ports: dict[str, ListeningPort] = {}
        try:
            for name, number in ports.items():
                self._ports[name] = self._listen(name, host, number)
            for port in self._ports.values():
                port.listen()
        except BaseException:
            self._loop.close()
            raise
        self._thread = threading.Thread(target=self._run, name=f"urlink sim {controller.model.name}", daemon=True)

    def _listen(self, name: str, host: str, number: int) -> ListeningPort:
        return self._loop.listen(
            host,
            number,
            lambda connection: self._accept(name, connection),
            purpose=name,
            output_limit=self._controller.output_limit,
            chunk=RECEIVED_AT_ONCE,
            is_listening=False,
        )

    @property
    def ports(self) -> dict[str, int]:
        """Name of each port -> its number."""
        return {name: port.number for name, port in self._ports.items()}

    @property
    def peers(self) -> set[str]:
        """Numeric addresses of the clients."""
        return {client.connection.peer[0] for client in self.clients}

    # -- from other threads ------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and all connections. Returns within `PATIENCE`."""
        self._is_closing = True
        self._loop.wake()
        if self._thread is not threading.current_thread():
            self._thread.join(PATIENCE)

    def call(self, change: Callable[[], object]) -> None:
        """Do something in the server's thread between two cycles, and wait until it is done.

        Raises:
            LinkTimeout: it was not done within `PATIENCE`.
            Exception: whatever `change` raises.
        """

        def call() -> None:
            self.catch_up()
            change()
            self._settle()
            # What was changed shows in the very next cycle.
            self._is_called = True

        if self._thread is threading.current_thread():
            change()
        else:
            self._loop.call(call, PATIENCE)

    # -- the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            self._is_closing = True
            self._intake.close()
            self._loop.close()

    def _serve(self) -> None:
        self._epoch = time.monotonic()
        while not self._is_closing:
            self.catch_up()
            self._intake.advance()
            wake = self._done + 1 if self._is_called else self._next(self._done)
            self._is_called = False
            self._loop.serve_once(self._epoch + wake / self._rate)

    def catch_up(self) -> None:
        """Advance the controller to the present, and send what that brings."""
        rate = self._rate
        due = int((time.monotonic() - self._epoch) * rate)
        behind = due - self._done
        if behind > ASLEEP * rate:
            self._epoch += (behind - 1) / rate
            self._counters.skipped += behind - 1
            behind = 1
        until = time.monotonic() + LONGEST_CATCH_UP
        has_time = True
        while behind > 0 and has_time and not self._is_closing:
            self._done += 1
            behind -= 1
            self._controller.advance()
            has_time = time.monotonic() < until
            if behind > LATEST * rate and has_time:
                self._counters.skipped += 1
                continue
            if behind and self._next(self._done - 1) == self._done:
                self._counters.late += 1
            self._emit(self._done)

    def _next(self, done: int) -> int:
        """The next cycle in which something is to be done on time; the ones between are caught up then."""
        if not self._controller.is_up or self._is_watched("realtime") or self._controller.programs.is_running:
            return done + 1
        rate = self._controller.firmware.rate
        state = -(-(done * STATE_RATE // rate + 1) * rate // STATE_RATE)
        fault = self._controller.next_fault
        return state if fault is None else max(done + 1, min(state, fault))

    def _settle(self) -> None:
        """Bring ports and connections into the state that controller and faults ask for."""
        if self._is_closing:
            return
        faults = self._faults
        self._open_or_refuse()
        cuts = faults.take_cuts()
        if cuts:
            self._reset(cuts)
        if faults.segments_changed != self._segments_seen:
            self._segments_seen = faults.segments_changed
            self._segment_anew()

    def _emit(self, cycle: int) -> None:
        """Send what this cycle has to send."""
        controller = self._controller
        self._settle()
        if not controller.is_up:
            return
        for message in controller.take_messages():
            self._broadcast("primary", message)
        if self._is_watched("realtime"):
            self._broadcast("realtime", controller.realtime_packet())
        rate = controller.firmware.rate
        is_due = cycle * STATE_RATE // rate != (cycle - 1) * STATE_RATE // rate
        if is_due and (self._is_watched("primary") or self._is_watched("secondary")):
            state = controller.state_package()
            self._broadcast("primary", state)
            self._broadcast("secondary", state)

    def _is_watched(self, kind: str) -> bool:
        return any(client.kind == kind for client in self.clients)

    def _broadcast(self, kind: str, packet: bytes) -> None:
        for port in (kind, f"{kind}_readonly"):
            clients = [client for client in self.clients if client.port == port and client.connection.is_open]
            if clients and not self._faults.is_stalled(port):
                data = self._faults.on_the_wire(port, packet)
                for client in clients:
                    self._put(client, data)

    def _put(self, client: Client, data: bytes) -> None:
        self._counters.sent += 1
        for segment in [data] if client.segmenter is None else client.segmenter.put(data):
            self._write(client, segment)

    def _write(self, client: Client, data: bytes) -> None:
        overflowed = client.connection.port.overflowed
        client.connection.write(data)
        self._counters.dropped += client.connection.port.overflowed - overflowed

    # -- clients -------------------------------------------------------------------------------------

    def _accept(self, port: str, connection: Connection) -> Client | None:
        if self._is_closing:
            return None
        # The clock may be waiting for its next appointment: who comes now is to see nothing of the past.
        self.catch_up()
        client = Client(self, port, connection)
        client.segmenter = self._faults.segmenter(port)
        self._counters.connections += 1
        self.clients.add(client)
        for package in self._controller.greeting(port):
            self._put(client, self._faults.lasting(port, package))
        return client

    def refuse(self, count: int) -> None:
        """So many bytes from clients are thrown away."""
        self._counters.refused_bytes += count

    def take(self, client: Client, text: str) -> None:
        """A line that a client has sent."""
        controller = self._controller
        if client.kind == "dashboard":
            reply = controller.dashboard.reply(text)
            if not self._faults.is_stalled(client.port):
                data = b"Disconnected\n" if reply is None else f"{reply}\n".encode()
                self._put(client, self._faults.on_the_wire(client.port, data))
            if reply is None:
                client.connection.finish(LAST_REPLY)
            return
        controller.received.append((client.port, text))
        refused = client.assembler.refused
        program = client.assembler.feed(text)
        self.refuse(client.assembler.refused - refused)
        if program is not None and not self._intake.put(program):
            self.refuse(len(program))

    # -- connections come and go ---------------------------------------------------------------------

    def _open_or_refuse(self) -> None:
        is_up = self._controller.is_up
        if not is_up:
            self._intake.clear()
        for name, port in self._ports.items():
            if port.is_listening and not is_up:
                port.refuse()
                self._reset({name})
            elif is_up:
                port.listen()
                # Connected but silent: the kernel has made the connection, and there it waits.
                if self._faults.is_stalled(name):
                    port.pause()
                else:
                    port.resume()

    def _segment_anew(self) -> None:
        for client in self.clients:
            held = b"" if client.segmenter is None else client.segmenter.rest()
            client.segmenter = self._faults.segmenter(client.port)
            if held:
                self._write(client, held)

    def _reset(self, ports: set[str]) -> None:
        for client in list(self.clients):
            if client.port in ports:
                client.connection.close(reset=True)
