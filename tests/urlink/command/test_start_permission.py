"""Two clients and one controller: however late texts arrive, a program proceeds only with its own permission."""

from __future__ import annotations

import itertools
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from tests.fakes.line import FIRMWARE, STARTED, STOPPED, Programming, Run
from tests.fakes.world import NotedSensors
from urlink.protocol.firmware import Firmware
from urlink.protocol.primary.robot_message import TextMessage
from urlink.simulator.registers import RegisterBanks
from urlink.simulator.urscript import compile_script
from urlink.simulator.urscript.machine import Execution
from urlink.simulator.urscript.world import ScriptWorld

MOVED = "moves the arm"


class Client(Programming):
    """Client whose texts stay in the network until the test delivers them.

    Only messages of the controller notify its handles that a program has begun.
    """

    def __init__(self, firmware: str, first_token: int) -> None:
        super().__init__(firmware=firmware)
        self.programs._start_tokens = itertools.count(first_token)
        #: Handle of each program, by the program's name.
        self.begun: dict[str, Run] = {}
        #: Names of programs that got their permission while their handle had not ended.
        self.permitted: set[str] = set()

    def begin(self, stays: bool) -> None:
        """Send a program. Without `stays`, it is cancelled before its text is read."""
        life = self.programs.life("motion")
        run = self._start(self.programs.own([f'textmsg("{MOVED}")', "sync()"]), life)
        self.begun[run.program] = run
        if not stays:
            life.cancel("the client has disconnected", brake=False)


class Clients(RuleBasedStateMachine):
    """Programs of two clients on one controller, which executes exactly the sent texts."""

    firmware = "5.11"

    def __init__(self) -> None:
        super().__init__()
        self.clients = [Client(self.firmware, 0), Client(self.firmware, 100)]
        #: For each client, the texts that have not been read yet.
        self.wires: list[list[str]] = [[], []]
        self.registers, self.flags = RegisterBanks(), [False] * 32
        self.cycle = 0
        self.running: tuple[str, Execution] | None = None
        self.moved: list[str] = []

    # -- the world of a program ------------------------------------------------------------------------

    def execution(self, text: str) -> Execution:
        motion = SimpleNamespace(release=lambda: None, stopj=lambda acceleration: SimpleNamespace(is_over=True))
        world = SimpleNamespace(
            firmware=Firmware.parse(self.firmware),
            registers=self.registers,
            flags=self.flags,
            motion=motion,
            sockets=SimpleNamespace(close_all=lambda: None),
            text_message=self.text_message,
            sensors=NotedSensors((0.0,) * 6),
        )
        return Execution(compile_script(text, Firmware.parse(self.firmware)), cast(ScriptWorld, world))

    def text_message(self, text: str) -> None:
        assert self.running is not None
        if text == MOVED:
            self.moved.append(self.running[0])
            return
        for client in self.clients:
            before = len(client.sent)
            client.primary.deliver(TextMessage(FIRMWARE, text=text))
            if len(client.sent) > before:
                assert not client.begun[self.running[0]].done
                client.permitted.add(self.running[0])

    def tell_key(self, title: str, name: str) -> None:
        for client in self.clients:
            client.key(title, name)

    def collect(self) -> None:
        """Move the texts that the clients have sent to their wires."""
        for client, wire in zip(self.clients, self.wires, strict=True):
            wire += client.sent
            client.sent.clear()

    # -- events ----------------------------------------------------------------------------------------

    @rule(who=st.integers(0, 1), stays=st.booleans())
    def send(self, who: int, stays: bool) -> None:
        self.clients[who].begin(stays)
        self.collect()

    @rule(who=st.integers(0, 1), data=st.data())
    def give_up(self, who: int, data: Any) -> None:
        running = [run for run in self.clients[who].begun.values() if not run.done]
        if running:
            data.draw(st.sampled_from(running), label="which").cancel()
            self.collect()

    @precondition(lambda self: any(self.wires))
    @rule(data=st.data(), cycles=st.integers(0, 2))
    def arrive(self, data: Any, cycles: int) -> None:
        """Read the next text of one client, in the order of its connection, and let `cycles` cycles pass."""
        wire = data.draw(st.sampled_from([wire for wire in self.wires if wire]), label="from")
        text = wire.pop(0)
        execution = self.execution(text)
        if execution.script.kind == "sec":
            execution.advance()
            assert execution.error is None
            self.run_on(cycles)
            return
        if self.running is not None:
            name, before = self.running
            before.stop()
            self.tell_key(STOPPED, name)
        self.running = (execution.script.name, execution)
        self.tell_key(STARTED, execution.script.name)
        self.run_on(cycles)

    @rule(cycles=st.integers(1, 3))
    def run_on(self, cycles: int) -> None:
        for _ in range(cycles):
            if self.running is None:
                break
            name, execution = self.running
            execution.advance()
            assert execution.error is None
            if execution.is_over:
                self.running = None
                self.tell_key(STOPPED, name)
        self.collect()

    @invariant()
    def only_permitted_programs_have_moved(self) -> None:
        assert set(self.moved) <= {name for client in self.clients for name in client.permitted}


class ClientsOfFlags(Clients):
    firmware = "3.4"


TestTheRegister = pytest.mark.property(Clients.TestCase)
TestTheFlags = pytest.mark.property(ClientsOfFlags.TestCase)
TestTheRegister.settings = TestTheFlags.settings = settings(deadline=None, stateful_step_count=30)
