"""Details of commands that one missing statement would break."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Callable
from typing import Any, cast

import pytest

import urlink
from linkcore import clock
from linkcore.clock import Stamp
from linkcore.errors import Closed, LinkError, LinkTimeout
from linkcore.net.dialogue import Dialogue
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff, ConnectionState
from tests.contended import beside, contended_lock
from tests.fakes.line import Desk, Subscriber, slow
from tests.fakes.rtde import ScriptedRtde
from tests.waiting import until
from tests.worlds.guarded import is_held
from urlink.aio.awaited import AwaitedRtde
from urlink.command.interlock import Interlock
from urlink.command.safety import Safety
from urlink.command.safety_monitor import _Listening
from urlink.motion.links.reverse import ReverseLink, ReversePort
from urlink.motion.servo import force_control
from urlink.motion.servo.block_motion import KeptMessage
from urlink.motion.servo.linked_program import LinkedProgram
from urlink.protocol.enums import SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.rtde.packets import StartReply
from urlink.protocol.rtde.protocol import Requests
from urlink.protocol.rtde.transport import RtdeTransport
from urlink.rtde import client
from urlink.rtde.claims import CLAIM_TIMEOUT, BriefClaims, Claims
from urlink.rtde.client import Rtde
from urlink.rtde.outputs import OutputStream, connection_of
from urlink.session.identity import Identity
from urlink.session.source import Source

pytestmark = pytest.mark.simulated_time


def test_listening_is_marked_ended_before_subscriptions_end() -> None:
    listening = _Listening()
    seen: list[bool] = []
    listening.add(lambda: seen.append(listening.is_over))
    listening.end()
    assert seen == [True]


def test_send_line_accepts_leading_tab() -> None:
    with urlink.connect("sim://") as robot:
        robot.script.send_line("\tset_digital_out(0, True)")
        until(lambda: robot.controller.signals.digital_outputs & 1)


def test_next_link_on_a_fixed_port_replaces_the_previous_one() -> None:
    where = ReversePort("127.0.0.1", port=45_678)
    first = where.open()
    second = where.open()
    first.close(farewell=False)
    second.close(farewell=False)


class Standing:
    """Fake of the claims of settings, and of their connection; `on_subscribe` is called when they connect."""

    name, is_over, failure = "settings", False, None

    def __init__(self, on_subscribe: Callable[[], object] = lambda: None) -> None:
        self.connection = self
        self._on_subscribe = on_subscribe
        self.closed = 0

    def subscribe_inline(self, kind: type, callback: Callable[[Any], object], **options: Any) -> None:
        self._on_subscribe()

    def claim(self, names: tuple[str, ...]) -> None:
        pass

    def put(self, values: Any) -> None:
        pass

    def close(self, timeout: float) -> None:
        self.closed += 1

    def abandon(self) -> None:
        self.closed += 1


SLIDER = ("speed_slider_mask", "speed_slider_fraction")


def test_claim_without_wait_returns_while_lock_is_held() -> None:
    claims: list[object] = []
    seen: list[float] = []

    def meanwhile() -> None:
        begun = time.monotonic()
        thread = threading.Thread(target=lambda: claims.append(brief.claim(SLIDER, wait=False)))
        thread.start()
        thread.join(5.0)
        seen.append(time.monotonic() - begun)

    brief = BriefClaims(lambda plan: cast(Claims, Standing(meanwhile)))
    assert brief.claim(SLIDER, wait=True) is not None
    assert claims == [None]
    assert seen[0] < 1.0


def test_claims_are_marked_closed_before_release() -> None:
    """Another thread that claims an input just then gets no new connection."""
    opened: list[Standing] = []
    refused: list[Exception] = []

    def claim() -> None:
        try:
            brief.claim(SLIDER, wait=True)
        except Closed as error:
            refused.append(error)

    class Releasing(Standing):
        def close(self, timeout: float) -> None:
            super().close(timeout)
            beside(claim)

    def connect(plan: Requests) -> Claims:
        opened.append(Standing() if opened else Releasing())
        return cast(Claims, opened[-1])

    brief = BriefClaims(connect)
    brief.claim(SLIDER, wait=True)
    brief.close(1.0)
    assert [each.closed for each in opened] == [1, 1]
    assert len(refused) == 1


def test_claims_are_registered_before_connecting() -> None:
    """Closing the robot then also ends the attempt."""
    standing = Standing(lambda: brief.close(1.0))
    brief = BriefClaims(lambda plan: cast(Claims, standing))
    brief.claim(SLIDER, wait=True)
    assert standing.closed == 1


def test_settings_use_the_claim_timeout_for_connecting(monkeypatch: pytest.MonkeyPatch) -> None:
    timeouts: dict[str, float] = {}

    def noting(name: str, transport: Any, plan: Requests, source: Source) -> Connection:
        timeouts[name.rpartition("rtde ")[2]] = source.timeout
        return connection_of(name, transport, plan, source)

    monkeypatch.setattr(client, "connection_of", noting)
    with urlink.connect("sim://") as robot:
        robot.set_speed_slider(0.5)
    assert timeouts == {"settings": CLAIM_TIMEOUT}


def test_outputs_stream_is_named_after_rtde() -> None:
    with urlink.connect("sim://") as robot, robot.rtde.outputs("actual_q") as stream:
        assert stream.name.endswith("rtde")


def test_monitor_is_marked_closed_before_subscriptions_end(monkeypatch: pytest.MonkeyPatch) -> None:
    desk, seen = Desk(), list[bool]()
    monkeypatch.setattr(Subscriber, "close", lambda *arguments: seen.append(desk.monitor.is_closed))
    desk.clear()
    desk.monitor.close()
    assert seen
    assert all(seen)


def test_interpreter_is_registered_before_first_request(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[int] = []
    with urlink.connect("sim://") as robot:
        interpreters = robot._commanded().interpreters
        ask = Dialogue.ask

        def noting(dialogue: Dialogue, *arguments: Any, **how: Any) -> Any:
            seen.append(len(interpreters._open))
            return ask(dialogue, *arguments, **how)

        monkeypatch.setattr(Dialogue, "ask", noting)
        with robot.interpreter():
            pass
    assert seen[0] == 1


def test_torque_message_is_not_repeated_while_one_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []
    made: list[KeptMessage] = []

    def make(*arguments: Any) -> KeptMessage:
        made.append(KeptMessage(*arguments))
        return made[-1]

    feed = LinkedProgram.feed

    def noting(program: LinkedProgram, *data: Any) -> None:
        seen.append(made[-1].is_mute)
        feed(program, *data)

    monkeypatch.setattr(force_control, "KeptMessage", make)
    monkeypatch.setattr(LinkedProgram, "feed", noting)
    with urlink.connect("sim://?firmware=10.12") as robot, robot.motion.torque() as torque:
        torque.send([0.0] * 6)
    assert seen == [True]


def rtde_of_a_desk() -> Rtde:
    identity = Identity(Firmware(5, 11), True, None)
    source = Source(lambda: identity, lambda interface: ScriptedRtde(), Backoff(), 2.0, None, False)
    return Rtde("desk", source, lambda: identity.firmware)


def test_stream_opened_while_the_robot_closes_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[OutputStream[Any]] = []

    def noting(*arguments: Any, **options: Any) -> OutputStream[Any]:
        made.append(OutputStream(*arguments, **options))
        return made[-1]

    monkeypatch.setattr(client, "OutputStream", noting)
    with contended_lock(before=lambda: rtde.close()):
        rtde = rtde_of_a_desk()
    with pytest.raises(Closed):
        rtde.outputs("actual_q")
    assert made[0].is_over


# -- between two threads -----------------------------------------------------------------------------------


def test_output_registers_of_one_type_share_one_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    with urlink.connect("sim://") as robot:
        made = []
        outputs = type(robot.rtde).outputs

        def noting(rtde: Any, *names: Any, **how: Any) -> Any:
            made.append(names)
            return outputs(rtde, *names, **how)

        monkeypatch.setattr(type(robot.rtde), "outputs", noting)
        with contended_lock(before=lambda: registers.read_integer(24)):
            registers = robot.rtde.registers()
        registers.read_integer(25)
    assert len(made) == 1


def test_claim_succeeds_when_it_waited_for_a_reconnection(monkeypatch: pytest.MonkeyPatch) -> None:
    claims: list[Claims] = []

    def make(connection: Connection, transport: RtdeTransport, plan: Requests, timeout: float) -> Claims:
        def reconnect() -> None:
            before = transport.dialogue
            connection.abort()
            until(lambda: transport.dialogue not in (None, before))
            until(lambda: connection.state is ConnectionState.CONNECTED)

        with contended_lock(before=reconnect):
            claims.append(Claims(connection, transport, plan, timeout))
        return claims[-1]

    monkeypatch.setattr(client, "Claims", make)
    with urlink.connect("sim://") as robot:
        robot.registers.write_integer(25, 1)
        assert claims[0].has(("input_int_register_25",))


def test_rtde_replies_time_out_despite_other_packets() -> None:
    received: list[float] = []

    class Chatty:
        name = "chatty"

        def receive(self, left: float) -> tuple[bytes, Stamp]:
            received.append(left)
            assert left > 0.0
            time.sleep(0.1)
            return bytes(StartReply(accepted=True)), Stamp.now()

    with pytest.raises(LinkTimeout, match="0 of 1"):
        Rtde._replies(Chatty(), 1, clock.now() + 0.35)  # type: ignore[arg-type]
    assert len(received) == 4


def test_reason_of_a_timeout_is_read_under_the_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    desk = Desk(may_wait=True)
    desk.clear()
    desk.primary.deliver(slow(SafetyMode.PROTECTIVE_STOP))
    seen: list[bool] = []
    refusal = Interlock.refusal_to_begin

    def noting(interlock: Interlock, *arguments: Any) -> Any:
        seen.append(is_held(desk.section.lock))
        return refusal(interlock, *arguments)

    monkeypatch.setattr(Interlock, "refusal_to_begin", noting)
    with pytest.raises(LinkTimeout):
        Safety(desk.monitor).wait_enabled(0.1)
    assert seen
    assert all(seen)


def test_program_that_connects_while_link_closes_is_disconnected() -> None:
    class Closing(ReverseLink):
        """Link that another thread closes just after `_is_closed` was read as False."""

        was_closed = False

        @property
        def _is_closed(self) -> bool:
            was_closed = self.was_closed
            if not was_closed and self.said:
                self.close()
            return was_closed

        @_is_closed.setter
        def _is_closed(self, value: bool) -> None:
            self.was_closed = value

        said = False

    link = Closing(ReversePort("127.0.0.1", host="127.0.0.1"))
    with socket.create_connection(("127.0.0.1", link.endpoint.port)) as program:
        program.sendall(link.endpoint.token.to_bytes(4, "big"))
        link.said = True
        until(lambda: link.poll(True) or link.was_closed)
        program.settimeout(1.0)
        with contextlib.suppress(ConnectionResetError):
            assert program.recv(1) == b""


def test_rtde_deadline_includes_the_time_for_connecting() -> None:
    left: list[float] = []

    class Slow:
        name = "slow"

        def __getattr__(self, name: str) -> object:
            """Return a function without effect for each other method of a transport."""
            return lambda *arguments: None

        async def connect(self, timeout: float) -> None:
            await asyncio.sleep(0.3)

        async def receive_awaited(self, timeout: float) -> tuple[bytes, Stamp]:
            left.append(timeout)
            raise LinkTimeout("nothing")

    transport = AwaitedRtde(Slow(), Requests(("timestamp",), None))  # type: ignore[arg-type]
    with pytest.raises(LinkError):
        asyncio.run(transport.connect(0.5))
    assert max(left) <= 0.21
