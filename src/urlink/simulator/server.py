"""The controller's ports: one thread that keeps the clock and serves every client.

Deadlines are absolute: cycle k is due k periods after the start, however late the one before was. A cycle that comes
late is caught up, and its packets still go out, as they would from a network that hiccups; beyond `LATEST` they are not
worth sending and are counted instead.
"""

from __future__ import annotations

import contextlib
import select
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import TYPE_CHECKING

from linkcore.errors import LinkTimeout

from .connections import Client, Port
from .controller import STATE_RATE
from .intake import Intake

if TYPE_CHECKING:
    from .controller import Controller

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
#: Seconds that other threads wait for the server's.
PATIENCE = 5.0

# Descriptors that select takes.
_SELECTABLE = 1024


class Server:
    """Serves the ports of one controller from one thread, which from then on owns the controller.

    Args:
        controller: to be served.
        host: address to listen on.
        ports: name -> number, 0 for a free one.

    Raises:
        BadAddress: a port cannot be listened on.
    """

    def __init__(self, controller: Controller, host: str, ports: Mapping[str, int]) -> None:
        self._controller = controller
        self._counters = controller.counters
        self._faults = controller.faults
        self._intake = Intake(controller, self._wake)
        self._ports: list[Port] = []
        self._calls: deque[tuple[Callable[[], object], Future[None]]] = deque()
        self._is_closing = False
        self._rate = controller.firmware.rate
        #: time of cycle 0 on the monotonic clock, and the cycles that are over
        self._epoch = 0.0
        self._done = 0
        self._segments_seen = self._faults.segments_changed
        self._waker, self._woken = socket.socketpair()
        self._selector = selectors.DefaultSelector()
        # The selector of Linux waits in whole milliseconds, too coarse for a cycle of two. But it is a descriptor
        # itself, and select, which can be told microseconds, waits for it; unless it has a number too high for select.
        fileno = getattr(self._selector, "fileno", int)()
        self._select_from = (fileno,) if 0 < fileno < _SELECTABLE else None
        try:
            for name, number in ports.items():
                self._ports.append(Port(name, host, number))
            for port in self._ports:
                port.listen()
                self._selector.register(port.socket, selectors.EVENT_READ, port)
        except BaseException:
            self._release()
            raise
        self._waker.setblocking(False)
        self._woken.setblocking(False)
        self._selector.register(self._woken, selectors.EVENT_READ, None)
        self._of_kind = {
            kind: [port for port in self._ports if port.kind == kind]
            for kind in ("primary", "secondary", "realtime", "dashboard")
        }
        self._thread = threading.Thread(target=self._run, name=f"urlink sim {controller.model.name}", daemon=True)

    @property
    def ports(self) -> dict[str, int]:
        """Name of each port -> its number."""
        return {port.name: port.number for port in self._ports}

    @property
    def peers(self) -> set[str]:
        """Numeric addresses of the clients."""
        return {client.peer for port in self._ports for client in port.clients}

    # -- from other threads ------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and all connections. Returns within `PATIENCE`."""
        self._is_closing = True
        self._wake()
        if self._thread is not threading.current_thread():
            self._thread.join(PATIENCE)

    def call(self, change: Callable[[], object]) -> None:
        """Do something in the server's thread between two cycles, and wait until it is done.

        Raises:
            LinkTimeout: it was not done within `PATIENCE`.
            Exception: whatever `change` raises.
        """
        if self._thread is threading.current_thread() or not self._thread.is_alive():
            change()
            return
        done: Future[None] = Future()
        self._calls.append((change, done))
        self._wake()
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            try:
                done.result(0.1)
            except FutureTimeout:
                if done.done():
                    raise
                if not self._thread.is_alive():
                    # It ended after it was asked.
                    self._do_calls()
            else:
                return
        raise LinkTimeout("the simulated controller does not answer")

    def _wake(self) -> None:
        # A full pipe wakes as well; a closed one belongs to a thread that has ended.
        with contextlib.suppress(OSError):
            self._waker.send(b"\0")

    # -- the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            self._is_closing = True
            self._intake.close()
            self._release()
            self._do_calls()

    def _serve(self) -> None:
        self._epoch = time.monotonic()
        while not self._is_closing:
            self._catch_up()
            self._intake.advance()
            # What a call has changed shows in the very next cycle.
            wake = self._done + 1 if self._do_calls() else self._next(self._done)
            self._wait(self._epoch + wake / self._rate)

    def _catch_up(self) -> None:
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
            for port in self._ports:
                if port.name in cuts:
                    self._end(port, reset=True)
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
        return any(port.clients for port in self._of_kind[kind])

    def _broadcast(self, kind: str, packet: bytes) -> None:
        for port in self._of_kind[kind]:
            if port.clients and not self._faults.is_stalled(port.name):
                data = self._faults.on_the_wire(port.name, packet)
                for client in list(port.clients):
                    self._put(client, data)

    def _put(self, client: Client, data: bytes) -> None:
        self._counters.sent += 1
        for segment in [data] if client.segmenter is None else client.segmenter.put(data):
            self._send(client, segment)

    def _send(self, client: Client, data: bytes) -> None:
        if not client.is_open:
            return
        if not client.pending:
            try:
                sent = client.link.send(data)
            except BlockingIOError:
                sent = 0
            except OSError:
                self._drop(client)
                return
            if sent == len(data):
                return
            data = data[sent:]
            self._selector.modify(client.link, selectors.EVENT_READ | selectors.EVENT_WRITE, client)
        client.pending += data
        if len(client.pending) > self._controller.output_limit:
            self._counters.dropped += 1
            self._drop(client, reset=True)

    # -- events --------------------------------------------------------------------------------------

    def _wait(self, deadline: float) -> None:
        """Serve sockets until the deadline, or until something was served."""
        remaining = deadline - time.monotonic()
        if self._select_from is None:
            # Whole milliseconds, rounded down: the selector would round up. The last part is slept.
            whole = int(remaining * 1e3)
            if whole >= 1:
                events = self._selector.select(whole * 1e-3)
            else:
                events = self._selector.select(0)
                if not events and remaining > 0.0:
                    time.sleep(remaining)
        elif select.select(self._select_from, (), (), max(remaining, 0.0))[0]:
            events = self._selector.select(0)
        else:
            return
        for key, mask in events:
            what = key.data
            if what is None:
                with contextlib.suppress(BlockingIOError):
                    self._woken.recv(4096)
            elif isinstance(what, Port):
                self._accept(what)
            else:
                if mask & selectors.EVENT_WRITE and what.is_open:
                    self._flush(what)
                if mask & selectors.EVENT_READ and what.is_open:
                    self._receive(what)

    def _do_calls(self) -> bool:
        """What other threads want done. True if there was anything."""
        if not self._calls:
            return False
        while self._calls:
            change, done = self._calls.popleft()
            try:
                change()
                self._settle()
            except Exception as error:
                done.set_exception(error)
            else:
                done.set_result(None)
        return True

    def _accept(self, port: Port) -> None:
        # The clock may be waiting for its next appointment: who comes now is to see nothing of the past.
        self._catch_up()
        if not port.is_listening or port.is_paused:
            return
        if self._faults.is_stalled(port.name):
            # Connected but silent: the kernel has made the connection, and there it waits.
            self._selector.unregister(port.socket)
            port.is_paused = True
            return
        client = port.accept()
        if client is None:
            return
        client.segmenter = self._faults.segmenter(port.name)
        self._counters.connections += 1
        self._selector.register(client.link, selectors.EVENT_READ, client)
        for package in self._controller.greeting(port.name):
            self._put(client, self._faults.lasting(port.name, package))

    def _flush(self, client: Client) -> None:
        try:
            sent = client.link.send(client.pending)
        except BlockingIOError:
            return
        except OSError:
            self._drop(client)
            return
        del client.pending[:sent]
        if not client.pending:
            self._selector.modify(client.link, selectors.EVENT_READ, client)

    def _receive(self, client: Client) -> None:
        try:
            data = client.link.recv(RECEIVED_AT_ONCE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(client)
        elif client.port.name != client.port.kind:
            # Text to a read-only port has no effect.
            self._counters.refused_bytes += len(data)
        else:
            # What a line does begins in the next cycle, not in one after that at which the clock was looked at last.
            self._catch_up()
            *lines, rest = data.split(b"\n")
            for line in lines:
                if not client.is_open:
                    return
                self._counters.refused_bytes += client.extend_line(line)
                text = client.end_line()
                if text is not None:
                    self._take(client, text)
            self._counters.refused_bytes += client.extend_line(rest)

    def _take(self, client: Client, text: str) -> None:
        """A line that a client has sent."""
        controller = self._controller
        if client.port.kind == "dashboard":
            reply = controller.dashboard.reply(text)
            if not self._faults.is_stalled(client.port.name):
                data = b"Disconnected\n" if reply is None else f"{reply}\n".encode()
                self._put(client, self._faults.on_the_wire(client.port.name, data))
            if reply is None and client.is_open:
                self._drop(client)
            return
        controller.received.append((client.port.name, text))
        refused = client.assembler.refused
        program = client.assembler.feed(text)
        self._counters.refused_bytes += client.assembler.refused - refused
        if program is not None and not self._intake.put(program):
            self._counters.refused_bytes += len(program)

    # -- connections come and go ---------------------------------------------------------------------

    def _open_or_refuse(self) -> None:
        is_up = self._controller.is_up
        if not is_up:
            self._intake.clear()
        for port in self._ports:
            if port.is_listening != is_up:
                if is_up:
                    port.listen()
                    self._selector.register(port.socket, selectors.EVENT_READ, port)
                else:
                    self._end(port, reset=True)
                    if not port.is_paused:
                        self._selector.unregister(port.socket)
                    port.refuse()
            elif port.is_paused and not self._faults.is_stalled(port.name):
                port.is_paused = False
                self._selector.register(port.socket, selectors.EVENT_READ, port)

    def _segment_anew(self) -> None:
        for port in self._ports:
            for client in list(port.clients):
                held = b"" if client.segmenter is None else client.segmenter.rest()
                client.segmenter = self._faults.segmenter(port.name)
                if held:
                    self._send(client, held)

    def _drop(self, client: Client, reset: bool = False) -> None:
        self._selector.unregister(client.link)
        client.close(reset)

    def _end(self, port: Port, reset: bool) -> None:
        for client in list(port.clients):
            self._drop(client, reset)

    def _release(self) -> None:
        for port in self._ports:
            self._end(port, reset=False)
            port.socket.close()
        self._selector.close()
        self._waker.close()
        self._woken.close()
