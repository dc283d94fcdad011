"""Several RTDE clients that claim, write, start, release and disconnect, compared with a model of the server."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.urlink.simulator.rtde_peer import Peer, package, packages, step
from urlink.protocol.rtde.variables import INPUTS
from urlink.simulator import Controller, Still
from urlink.simulator.registers import FIELDBUSES

NUMBERS = {f"input_int_register_{number}": st.integers(-(2**31), 2**31 - 1) for number in (0, 23, 24)}
FLOATS = {f"input_double_register_{number}": st.floats(allow_nan=False) for number in (0, 47)}
BITS: dict[str, st.SearchStrategy[Any]] = {
    "input_bit_registers0_to_31": st.integers(0, 2**32 - 1),
    "input_bit_register_64": st.booleans(),
}
BYTE = st.integers(0, 255)
OUTPUTS: dict[str, st.SearchStrategy[Any]] = {"standard_digital_output_mask": BYTE, "standard_digital_output": BYTE}
SLIDER: dict[str, st.SearchStrategy[Any]] = {
    "speed_slider_mask": st.integers(0, 2),
    "speed_slider_fraction": st.floats(0.0, 1.0),
}
VALUES: dict[str, st.SearchStrategy[Any]] = {**NUMBERS, **FLOATS, **BITS, **OUTPUTS, **SLIDER}
NAMES = [*VALUES, "nonsense"]
RATE = 500


@dataclass
class Client:
    """State of one client in the model."""

    peer: Peer
    requests: int = 0
    recipes: dict[int, list[str]] = field(default_factory=dict)
    held: set[str] = field(default_factory=set)
    step: int = 0
    started: int | None = None


class Server(RuleBasedStateMachine):
    """State machine that runs the model in parallel with the controller."""

    def __init__(self) -> None:
        super().__init__()
        self.sim = Controller("UR5e", "5.11", motion=Still())
        self.clients: list[Client] = []
        # Inputs of closed connections, each with the last cycle in which they stay claimed.
        self.stale: list[tuple[int, set[str]]] = []
        self.stale_cycles = 0
        self.inputs: dict[str, Any] = {}
        self.digital_outputs = 0
        self.slider = 1.0

    def client(self, data: st.DataObject) -> Client:
        return data.draw(st.sampled_from(self.clients))

    # -- rules -----------------------------------------------------------------------------------------

    @precondition(lambda self: len(self.clients) < 4)
    @rule()
    def connect(self) -> None:
        self.clients.append(Client(Peer(self.sim)))

    @precondition(lambda self: self.clients)
    @rule(data=st.data(), names=st.lists(st.sampled_from(NAMES), min_size=1, max_size=4))
    def claim(self, data: st.DataObject, names: list[str]) -> None:
        client = self.client(data)
        client.requests += 1
        taken = {name for name in names if self.is_taken(name, client)}
        number, types = client.peer.inputs(*names)
        expected = [
            "NOT_FOUND" if name not in INPUTS else "IN_USE" if name in taken else INPUTS[name].type for name in names
        ]
        is_good = not taken and "nonsense" not in names
        assert (number, types) == (client.requests if is_good else 0, expected)
        if is_good:
            client.recipes[number] = names
            client.held.update(names)

    def is_taken(self, name: str, client: Client) -> bool:
        now = self.sim.cycle
        return (
            (self.sim.fieldbus is not None and name in FIELDBUSES[self.sim.fieldbus])
            or any(name in other.held for other in self.clients if other is not client)
            or any(name in names for until, names in self.stale if until >= now)
        )

    @precondition(lambda self: any(client.recipes for client in self.clients))
    @rule(data=st.data())
    def write(self, data: st.DataObject) -> None:
        client = data.draw(st.sampled_from([client for client in self.clients if client.recipes]))
        number, names = data.draw(st.sampled_from(sorted(client.recipes.items())))
        if len(set(names)) < len(names):
            return
        values = {name: data.draw(VALUES[name], label=name) for name in names}
        client.peer.write(number, **values)
        self.inputs.update(values)
        if OUTPUTS.keys() & values.keys():
            mask = self.inputs.get("standard_digital_output_mask", 0)
            self.digital_outputs = self.digital_outputs & ~mask | self.inputs.get("standard_digital_output", 0) & mask
        if values.get("speed_slider_mask") == 1:
            self.slider = self.inputs.get("speed_slider_fraction", 0.0)

    @precondition(lambda self: self.clients)
    @rule(data=st.data(), payload=st.binary(min_size=1, max_size=12))
    def write_nonsense(self, data: st.DataObject, payload: bytes) -> None:
        client = self.client(data)
        if payload[0] not in client.recipes:
            before = self.sim.counters.ignored_packages
            client.peer.session.feed(package("U", payload))
            assert self.sim.counters.ignored_packages == before + 1

    @precondition(lambda self: self.clients)
    @rule(data=st.data(), every=st.integers(1, 5), is_known=st.booleans())
    def set_up_outputs(self, data: st.DataObject, every: int, is_known: bool) -> None:
        client = self.client(data)
        client.started, client.step = None, every if is_known else 0
        number, _ = client.peer.outputs("control_step" if is_known else "nonsense", frequency=RATE / every)
        assert number == int(is_known)

    @precondition(lambda self: self.clients)
    @rule(data=st.data())
    def start(self, data: st.DataObject) -> None:
        client = self.client(data)
        assert client.peer.start() is (client.step > 0)
        client.started = self.sim.cycle if client.step else None

    @precondition(lambda self: self.clients)
    @rule(data=st.data())
    def pause(self, data: st.DataObject) -> None:
        client = self.client(data)
        assert client.peer.ask("P") == b"\1"
        client.started = None

    @precondition(lambda self: self.clients)
    @rule(data=st.data())
    def drop(self, data: st.DataObject) -> None:
        client = self.client(data)
        self.clients.remove(client)
        client.peer.close()
        if self.stale_cycles:
            self.stale.append((self.sim.cycle + self.stale_cycles, client.held))

    @rule(cycles=st.integers(0, 20))
    def let_inputs_go_stale(self, cycles: int) -> None:
        self.sim.faults.rtde_stale_inputs(cycles / RATE)
        self.stale_cycles = cycles

    @rule(name=st.sampled_from([None, *FIELDBUSES]))
    def enable_a_fieldbus(self, name: str | None) -> None:
        self.sim.fieldbus = name

    @rule(cycles=st.integers(1, 12))
    def wait(self, cycles: int) -> None:
        before = self.sim.cycle
        step(self.sim, cycles)
        for client in self.clients:
            expected = [
                cycle
                for cycle in range(before + 1, before + cycles + 1)
                if client.started is not None and (cycle - client.started) % client.step == 0
            ]
            if client.started is not None:
                assert [values["control_step"] for values in client.peer.data()] == expected
            else:
                assert client.peer.take() == []

    # -- invariants ------------------------------------------------------------------------------------

    @invariant()
    def inputs_have_the_last_written_values(self) -> None:
        inputs = self.sim.registers.inputs
        for name in NUMBERS:
            assert inputs.integers[int(name.rpartition("_")[2])] == self.inputs.get(name, 0)
        for name in FLOATS:
            assert inputs.floats[int(name.rpartition("_")[2])] == self.inputs.get(name, 0.0)
        assert inputs.bits & 0xFFFFFFFF == self.inputs.get("input_bit_registers0_to_31", 0)
        assert bool(inputs.bits >> 64 & 1) == self.inputs.get("input_bit_register_64", False)
        assert self.sim.signals.digital_outputs == self.digital_outputs
        assert self.sim.speed_fraction == self.slider

    @invariant()
    def all_clients_stay_connected(self) -> None:
        assert all(client.peer.is_open for client in self.clients)
        assert len(self.sim.rtde.sessions) == len(self.clients)


TestServer = pytest.mark.property(Server.TestCase)
TestServer.settings = settings(stateful_step_count=40)


REQUESTS = st.tuples(st.sampled_from("VvOISPMUZ"), st.binary(max_size=40) | st.sampled_from(NAMES).map(str.encode))


@pytest.mark.property
@given(
    pieces=st.lists(REQUESTS.map(lambda request: package(*request)) | st.binary(max_size=30), max_size=30),
    protocol=st.sampled_from([1, 2]),
)
def test_server_survives_any_bytes(pieces: list[bytes], protocol: int) -> None:
    sim = Controller("UR5e", "5.11", motion=Still())
    peer, other = Peer(sim, protocol), Peer(sim)
    other.outputs("control_step")
    assert other.start()
    for piece in pieces:
        if peer.is_open:
            peer.session.feed(piece)
        step(sim)
    assert [data["control_step"] for data in other.data()] == list(range(1, len(pieces) + 1))
    replies = packages(bytes(peer.sent))
    assert {kind for kind, _ in replies} <= set("VvOISPU")
