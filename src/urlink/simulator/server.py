"""Server that offers the controller's interfaces over TCP.

One thread keeps the clock and transfers the bytes of every client.

Deadlines are absolute: cycle k is due k periods after the start, even if the previous cycle was late. If the thread got
no processor time for a while, it catches up cycle by cycle. The packets of these cycles are still sent, as if the
network had delayed them.

If a cycle is late by more than `LATEST`, it is counted, but its packets are not sent. Packets that became due in the
meantime are sent with the next cycle that is sent. If the thread is late by more than `ASLEEP`, the clock is set again.
Clients of a slow simulator therefore receive late packets and miss some, but all interfaces show the same time, and no
interface is silent.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence, Set

from linkcore import clock
from linkcore.deferred import LONGEST_BATCH, Deferred, SteadyBytes
from linkcore.net.loop import Connection, Handler, ListeningPort, SelectorLoop
from urlink.protocol.ports import interface_of

from .control_loop import ControlLoop, SteppedClock
from .faults.link import LinkFaults, Segmenter
from .interfaces.interface import Interface, InterfaceReceiver, ReadOnlyReceiver
from .programs.loader import ProgramLoader
from .robot.sensors import Samples
from .state import ControllerState

#: Age in seconds above which a packet is no longer sent. Up to this age, a client gets the packets of every cycle. If a
#: computer is too slow for all of its controllers, sending older packets would only delay the next ones.
LATEST = 1.0
#: Delay in seconds above which the computer was probably suspended. The clock is then set again instead of catching up.
ASLEEP = 5.0
#: Maximum time of catching up in seconds. After this time, the sockets are served, even if the controller is still
#: late. This limit is needed because a program can have cycles that take longer than their period.
LONGEST_CATCH_UP = 0.02
#: Cycles per second that are executed on time even if no client is connected, so that the modes and the time advance.
LEAST_RATE = 10
#: Maximum number of bytes that are read from a client at once. Each line of these bytes can be a program.
CHUNK = 1 << 12
#: Maximum time that other threads wait for the server's thread, in seconds.
TIMEOUT = 5.0
#: Seconds within which a client must take the last reply before its connection is closed.
LAST_REPLY = 2.0


class _Client(Handler):
    """Connection of one client. The link faults of its port apply to the packets that are sent over it.

    Attributes:
        name: Name of the port.
        connection: The connection.
        segmenter: Segmenter of its packets, as a fault requires it; None to send packets unchanged.
        receiver: Receiver of the client's bytes.
    """

    def __init__(self, server: Server, name: str, interface: Interface, connection: Connection) -> None:
        self.name = name
        self.connection = connection
        self.segmenter: Segmenter | None = None
        self._server = server
        is_read_only = name.endswith("_readonly")
        self.receiver: InterfaceReceiver = (
            ReadOnlyReceiver(server.counters) if is_read_only else interface.receiver(self)
        )

    @property
    def is_open(self) -> bool:
        return self.connection.is_open

    def send(self, packet: bytes) -> None:
        self._server.send(self, packet)

    @property
    def last_quiet_cycle(self) -> int:
        return self._server.last_quiet_cycle(self)

    def send_batch(self, packets: Sequence[Deferred | SteadyBytes], cycles: Sequence[int]) -> None:
        self._server.send_batch(self, packets, cycles)

    @property
    def pending(self) -> int:
        return self.connection.pending

    def finish(self) -> None:
        self.connection.finish(LAST_REPLY)

    def drop(self) -> None:
        self.connection.close(reset=True)

    def data_received(self, data: bytes) -> None:
        # Catch up first: a request of a client must take effect in the next cycle after its arrival, not in a cycle
        # that is already due.
        self._server.look_at_the_clock()
        self.receiver.feed(data)

    def connection_lost(self, reason: str, *, by_peer: bool) -> None:
        self.receiver.end()
        self._server.forget(self)
        del self.receiver  # it refers to this client


class Server:
    """Server for the interfaces of one controller. It runs in one thread, which then owns the controller.

    Args:
        loop: Control loop that advances the controller.
        state: State of the controller.
        interfaces: Name of each interface -> its handler.
        loader: Loader of programs, which compiles long ones in another thread.
        link: Faults of the connections.
        host: Address to listen on.
        numbers: Name of each port -> its number, 0 for a free one.
        output_limit: Maximum number of bytes that are buffered for one client.
        clock: Monotonic clock, in seconds. A test can pass its own clock.

    Attributes:
        counters: Counters of events on the interfaces.
        is_open: Whether the ports are open. After a reboot, the ports open a moment after the controller has come up.

    Raises:
        BadAddress: If the server cannot listen on a port.
    """

    def __init__(
        self,
        loop: ControlLoop,
        state: ControllerState,
        interfaces: Mapping[str, Interface],
        loader: ProgramLoader,
        link: LinkFaults,
        *,
        host: str,
        numbers: Mapping[str, int],
        output_limit: int,
        clock: Callable[[], float],
    ) -> None:
        # The clients of each port, and the names of the interfaces that have at least one client.
        self._clients: dict[str, list[_Client]] = {name: [] for name in numbers}
        self._watched: set[str] = set()
        # Names of the ports of each interface, and their clients.
        self._ports_of = {
            kind: [(name, self._clients[name]) for name in (kind, f"{kind}_readonly") if name in self._clients]
            for kind in interfaces
        }
        self._control = loop
        self._state = state
        self.counters = state.counters
        self._interfaces = interfaces
        # Interfaces that send packets on their own; the others only reply to clients.
        self._emitting = [item for item in interfaces.items() if type(item[1]).packets is not Interface.packets]
        # The same, with the real-time interface at the end, because its packets wake most threads, and steady packets
        # can only arrive at once while no thread is ready.
        self._passing_on = sorted(self._emitting, key=lambda item: item[0] == "realtime")
        self._loader = loader
        self._link = link
        self._sockets = SelectorLoop(clock)
        self._clock = clock
        self._is_stepped = isinstance(clock, SteppedClock)
        self._is_closing = False
        self._is_changed = False
        # Whether the current cycle was executed before it is due, and its packets must be sent when it is due.
        self._is_held = False
        # First cycle in which an interface other than the real-time interface sends packets, as long as no client sends
        # anything; 0 if unknown.
        self._others_due = 0
        # Whether steady packets may arrive at once, because the cycle that is due is the only work to do.
        self._passes_on = False
        # Whether the last `catch_up` ran out of time.
        self._is_behind = False
        self._rate = state.rate
        #: Time on the monotonic clock at which the server started, in s, and the controller's cycle at that time.
        self._epoch = 0.0
        self._first = state.cycle
        self._segments_seen = link.segments_changed
        self.is_open = True
        # Whether any port was paused at the last check of the ports.
        self._was_stalled = False
        self._listening: dict[str, ListeningPort] = {}
        try:
            for name, number in numbers.items():
                self._listening[name] = self._bind(name, host, number, output_limit)
            for name, port in self._listening.items():
                if interfaces[interface_of(name)].is_offered():
                    port.listen()
        except BaseException:
            self._sockets.close()
            raise
        loader.on_compiled = self._sockets.wake
        self._thread = threading.Thread(target=self._run, name=f"urlink sim {state.model.name}", daemon=True)

    def _bind(self, name: str, host: str, number: int, output_limit: int) -> ListeningPort:
        return self._sockets.listen(
            host,
            number,
            lambda connection: self._accept(name, connection),
            purpose=name,
            output_limit=output_limit,
            chunk=CHUNK,
            is_listening=False,
        )

    @property
    def numbers(self) -> dict[str, int]:
        """Ports: name -> number."""
        return {name: port.number for name, port in self._listening.items()}

    @property
    def peers(self) -> set[str]:
        """Numeric addresses of the clients."""
        return {client.connection.peer[0] for clients in self._clients.values() for client in clients}

    # -- from other threads ------------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread that serves the ports."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and all connections. Returns within `TIMEOUT`."""
        self._is_closing = True
        self._sockets.wake()
        if self._thread is not threading.current_thread():
            clock.join(self._thread, TIMEOUT)

    def call(self, change: Callable[[], object]) -> None:
        """Call a function in the server's thread between two cycles, and wait until it returns.

        Raises:
            LinkTimeout: If the function did not return within `TIMEOUT`.
            Exception: If `change` raises it.
        """

        def change_now() -> None:
            self.catch_up()
            change()
            self._settle()
            # Execute the next cycle on time, because it must show the change.
            self._is_changed = True

        if self._thread is threading.current_thread():
            change()
        else:
            self._sockets.call(change_now, TIMEOUT)

    # -- the thread --------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._epoch = self._clock()
            with clock.fine_timer():
                while not self._is_closing:
                    self.catch_up()
                    self._loader.advance()
                    self._sockets.serve_once(self._due(), self._advance_alone)
        finally:
            self._is_closing, self.is_open = True, False
            self._loader.close()
            self._sockets.close()

    def _advance_alone(self) -> float | None:
        """Advance the controller to the current time, if the work needs neither a wait nor the thread of the server.

        Return the time of the next cycle that must run on time; None if the thread must do the work.
        """
        now = self._first + int((self._clock() - self._epoch) * self._rate)
        fault = self._control.next_fault()
        is_due = fault is not None and fault <= now + 1
        if self._is_closing or self._loader.is_busy or is_due or self._control.calls_users:
            return None
        client = None if self._is_held or self._link.is_any_stalled else self._only_client
        if client is not None:
            self._run_ahead(client)
            if self._state.cycle == now - 1 and self._pass_on(client.connection):
                return self._epoch + (now + 1 - self._first) / self._rate
            self._passes_on = self._state.cycle == now - 1
        try:
            self.catch_up()
        finally:
            self._passes_on = False
        return self._due()

    @property
    def _only_client(self) -> _Client | None:
        """The only client of the real-time interface; None without one, or if its link has faults."""
        clients = self._clients.get("realtime", ())
        if len(clients) != 1 or self._clients.get("realtime_readonly") or clients[0].segmenter is not None:
            return None
        return clients[0]

    def _pass_on(self, client: Connection) -> bool:
        """Execute the cycle that is due, and let its real-time packet arrive; return False if it could not arrive yet.

        This is possible in simulated time if only this packet is sent, and nothing else happens before its arrival.
        """
        state = self._state
        if not state.is_up or self._when_others_are_due() <= state.cycle + 1:
            return False
        self._control.advance()
        packet = self._interfaces["realtime"].steady_packet()
        if packet is None or not state.outbox.is_empty or not client.write_steady(packet):
            self._emit(state.cycle)
            return False
        self.counters.sent += 1
        return True

    def _when_others_are_due(self) -> int:
        cycle = self._state.cycle
        if self._others_due <= cycle:
            due = [self._interfaces[kind].next_cycle(cycle) for kind in self._watched if kind != "realtime"]
            # Look again after a second, if nothing is planned.
            self._others_due = min([cycle + self._rate, *(each for each in due if each is not None)])
        return self._others_due

    def _run_ahead(self, client: _Client) -> None:
        """Execute cycles before they are due, and send their packets at once.

        This is possible in simulated time while nothing else can happen, the programs use nothing outside of the
        controller, and the clients need no packet at a certain time. The real-time packets that are sent together show
        the same modes and signals. A cycle that changes one of them, or that sends a message, is executed too, but its
        packets are sent when the cycle is due.
        """
        state, control = self._state, self._control
        begin = state.cycle
        last = client.last_quiet_cycle
        if last < begin + 2 or not control.is_self_contained:
            return
        fault = control.next_fault()
        if fault is not None:
            last = min(last, fault - 1)
        others = [(self._interfaces[kind], self._clients_of(kind)) for kind in self._watched if kind != "realtime"]
        steady = min([last, *(interface.last_steady(begin, last, clients) for interface, clients in others)])
        last = min([last, *(interface.last_ahead(begin, last, clients) for interface, clients in others)])
        realtime = self._interfaces["realtime"]
        packets: Sequence[Deferred] = []
        samples: Samples | None = None
        while state.cycle < last and not self._is_held:
            control.advance()
            packet = realtime.steady_packet()
            if packet is None or not state.outbox.is_empty:
                self._is_held = True
            elif not packets and (samples := control.advance_many(steady - state.cycle)) is not None:
                packets = realtime.later_packets(samples)
                break
            else:
                packets = [*packets, packet]
        if packets:
            client.send_batch(packets, range(begin + 1, begin + 1 + len(packets)))
            for interface, clients in others:
                interface.send_ahead(begin + len(packets), samples, clients)

    def _clients_of(self, kind: str) -> list[_Client]:
        return [client for _, clients in self._ports_of[kind] for client in clients]

    def last_quiet_cycle(self, client: _Client) -> int:
        """Return the last cycle whose packets can be sent to a client now; see `BatchClient.last_quiet_cycle`."""
        if client.segmenter is not None or self._link.is_any_stalled:
            return self._state.cycle
        quiet = min(client.connection.quiet_time, LONGEST_BATCH)
        if quiet <= 0.0:
            return self._state.cycle
        return self._first + int((self._clock() + quiet - self._epoch) * self._rate)

    def send_batch(self, client: _Client, packets: Sequence[Deferred | SteadyBytes], cycles: Sequence[int]) -> None:
        """Send the packets of several cycles to a client before these cycles are due."""
        now = self._clock()
        due = [self._epoch + (cycle - self._first) / self._rate for cycle in cycles]
        client.connection.write_batch(packets, [max(each - now, 0.0) for each in due])
        self.counters.sent += len(packets)

    def _due(self) -> float | None:
        """Return the time of the next cycle that must run on time; None if `step` advances the cycles."""
        if self._is_stepped:
            return None  # the clock does not advance while the thread waits for the sockets
        cycle = self._state.cycle
        wake = cycle if self._is_held else cycle + 1 if self._is_changed else self._next(cycle)
        self._is_changed = False
        return self._epoch + (wake - self._first) / self._rate

    def catch_up(self) -> None:
        """Advance the controller to the current time, and send the packets of its cycles."""
        self._others_due = 0
        rate, state, counters = self._rate, self._state, self.counters
        behind = int((self._clock() - self._epoch) * rate) - (state.cycle - self._first)
        if self._is_held and behind >= 0:
            self._is_held = False
            self._emit(state.cycle)
        if behind > ASLEEP * rate:
            self._epoch += (behind - 1) / rate
            counters.skipped += behind - 1
            behind = 1
        until = 0.0
        if behind > 1:
            until = self._clock() + LONGEST_CATCH_UP
        has_time = True
        while behind > 0 and has_time and not self._is_closing:
            # Whether this cycle had to run on time. If so, its packets are sent late.
            is_due = behind > 1 and self._next(state.cycle) == state.cycle + 1
            self._control.advance()
            behind -= 1
            has_time = behind == 0 or self._clock() < until
            if behind > LATEST * rate and has_time:
                counters.skipped += 1
                continue
            if is_due:
                counters.late += 1
            self._emit(state.cycle)
        self._is_behind = behind > 0

    def look_at_the_clock(self) -> None:
        """Advance to the current time before serving a client, unless the last `catch_up` did not finish.

        On a computer that is too slow for the controller, each client would otherwise have to wait while the thread
        catches up for other clients.
        """
        self._others_due = 0
        if not self._is_behind:
            self.catch_up()

    def _next(self, cycle: int) -> int:
        """Return the first cycle after this one that must run on time.

        The cycles before the returned one are executed together with it.
        """
        earliest = -(-(cycle * LEAST_RATE // self._rate + 1) * self._rate // LEAST_RATE)
        if self._loader.is_waiting:
            return cycle + 1
        for kind in self._watched:
            wanted = self._interfaces[kind].next_cycle(cycle)
            if wanted is not None and wanted < earliest:
                earliest = wanted
                if earliest == cycle + 1:
                    return earliest
        wanted = self._control.next_event(cycle)
        return earliest if wanted is None else min(earliest, wanted)

    # -- output --------------------------------------------------------------------------------------

    def _emit(self, cycle: int) -> None:
        """Send the packets of this cycle."""
        self._settle()
        if not self._state.is_up:
            return
        for kind, interface in self._passing_on if self._passes_on else self._emitting:
            if kind in self._watched:
                for packet in interface.packets(cycle):
                    self._broadcast(kind, packet)
            else:
                interface.skip()

    def _broadcast(self, kind: str, packet: bytes | Deferred) -> None:
        for name, clients in self._ports_of[kind]:
            if clients and not self._link.is_stalled(name):
                data = self._link.on_the_wire(name, packet)
                for client in clients:
                    if client.pending + len(data) > client.connection.port.output_limit:
                        # Drop the packet instead of closing the connection. Some public clients send programs for hours
                        # and never read, and this works with real controllers.
                        self.counters.unread += 1
                    else:
                        self._put(client, data)

    def send(self, client: _Client, packet: bytes) -> None:
        """Send a packet to one client, unless its port is stalled."""
        if not self._link.is_stalled(client.name):
            self._put(client, self._link.on_the_wire(client.name, packet))

    def _put(self, client: _Client, data: bytes | Deferred) -> None:
        self.counters.sent += 1
        if client.segmenter is None:
            self._write(client, data)
        else:
            for segment in client.segmenter.put(bytes(data)):
                self._write(client, segment)

    def _write(self, client: _Client, data: bytes | Deferred) -> None:
        if (
            self._passes_on
            and isinstance(data, (Deferred, SteadyBytes))
            and data.is_steady
            and client.connection.write_steady(data)
        ):
            return
        port = client.connection.port
        overflowed = port.overflowed
        client.connection.write(data)
        self.counters.dropped += port.overflowed - overflowed

    # -- clients -------------------------------------------------------------------------------------

    def _accept(self, name: str, connection: Connection) -> _Client | None:
        if self._is_closing:
            return None
        # The thread might have waited for a later cycle. Advance first, so that a new client gets no old packets.
        self.look_at_the_clock()
        interface = self._interfaces[interface_of(name)]
        client = _Client(self, name, interface, connection)
        client.segmenter = self._link.segmenter(name)
        self.counters.connections += 1
        self._clients[name].append(client)
        self._watched.add(interface_of(name))
        for packet in interface.greeting():
            self._put(client, self._link.lasting(name, packet))
        return client

    def forget(self, client: _Client) -> None:
        """Remove a client whose connection has ended."""
        self._others_due = 0
        self._clients[client.name].remove(client)
        kind = interface_of(client.name)
        if not self._clients.get(kind) and not self._clients.get(f"{kind}_readonly"):
            self._watched.discard(kind)

    # -- faults --------------------------------------------------------------------------------------

    def _settle(self) -> None:
        """Open, pause or close ports and connections, as the controller and its faults require."""
        if self._is_closing:
            return
        self._open_or_refuse()
        if cuts := self._link.take_cuts():
            self._reset(cuts)
        if self._link.segments_changed != self._segments_seen:
            self._segments_seen = self._link.segments_changed
            self._segment_anew()

    def _open_or_refuse(self) -> None:
        is_up, is_stalled = self._state.is_up, self._link.is_any_stalled
        if is_up and self.is_open and not is_stalled and not self._was_stalled:
            return  # the usual case in nearly every cycle
        if not is_up:
            self._loader.clear()
        for name, port in self._listening.items():
            if is_up and self._interfaces[interface_of(name)].is_offered():
                port.listen()
                # A stalled port is silent, but clients can still connect, because the operating system queues new
                # connections.
                if self._link.is_stalled(name):
                    port.pause()
                else:
                    port.resume()
            elif port.is_listening:
                port.refuse()
                self._reset({name})
        self.is_open, self._was_stalled = is_up, is_stalled

    def _segment_anew(self) -> None:
        for client in [client for clients in self._clients.values() for client in clients]:
            held = b"" if client.segmenter is None else client.segmenter.rest()
            client.segmenter = self._link.segmenter(client.name)
            if held:
                self._write(client, held)

    def _reset(self, ports: Set[str]) -> None:
        for name in ports & self._clients.keys():
            for client in self._clients[name]:
                client.connection.close(reset=True)
