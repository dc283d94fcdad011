"""Details of commands that one missing statement would break."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from typing import Any

import pytest

import urlink
from linkcore import clock
from linkcore.clock import Stamp
from linkcore.errors import Closed, LinkError, LinkTimeout
from linkcore.net.dialogue import Dialogue
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from tests.contended import Contended
from tests.waiting import until
from tests.worlds.guarded import is_held
from urlink.aio.awaited import AwaitedRtde
from urlink.command.interlock import Interlock
from urlink.command.safety_monitor import _Listening
from urlink.motion.links.reverse import ReverseLink, ReversePort
from urlink.protocol.rtde.packets import StartReply
from urlink.protocol.rtde.protocol import Requests
from urlink.protocol.rtde.recipes import Outputs
from urlink.rtde.claims import CLAIM_TIMEOUT, BriefClaims
from urlink.rtde.client import Rtde

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


def test_claim_without_wait_returns_while_lock_is_held() -> None:
    with urlink.connect("sim://") as robot:
        brief: BriefClaims = robot.rtde._brief
        with brief._lock:
            begun = time.monotonic()
            claimed: list[object] = []
            names = ("speed_slider_mask", "speed_slider_fraction")
            thread = threading.Thread(target=lambda: claimed.append(brief.claim(names, wait=False)))
            thread.start()
            thread.join(5.0)
            assert claimed == [None]
            assert time.monotonic() - begun < 1.0
        thread.join()


def test_connection_events_do_not_end_a_running_program() -> None:
    with urlink.connect("sim://") as robot:
        motion = robot.motion.speed_joints([0.1] * 6, duration=0.4)
        programs = robot.motion._context.programs
        for state in (ConnectionState.CONNECTING, ConnectionState.CONNECTED):
            programs.on_event(ConnectionEvent(state, "primary", None, Stamp.now()))
        assert not motion.done
        motion.wait()


def test_claims_are_marked_closed_before_release(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []
    monkeypatch.setattr(BriefClaims, "give_back", lambda claims, timeout=1.0: seen.append(claims._is_closed))
    with urlink.connect("sim://") as robot:
        robot.rtde._brief.close(1.0)
    assert seen[0] is True


def test_claims_are_registered_before_connecting(monkeypatch: pytest.MonkeyPatch) -> None:
    with urlink.connect("sim://") as robot:
        brief, seen = robot.rtde._brief, []
        subscribe = Connection.subscribe_inline

        def noting(connection: Connection, kind: type, callback: Any, **how: Any) -> Any:
            if kind is Outputs:
                seen.append(brief._standing is not None)
            return subscribe(connection, kind, callback, **how)

        monkeypatch.setattr(Connection, "subscribe_inline", noting)
        robot.set_speed_slider(0.5)
    assert seen == [True]


def test_settings_use_the_claim_timeout_for_connecting() -> None:
    with urlink.connect("sim://") as robot:
        claims = robot.rtde._connect_briefly(Requests(("timestamp",), None))
        assert claims._connection._timeout == CLAIM_TIMEOUT
        claims.close(1.0)


def test_outputs_stream_is_named_after_rtde() -> None:
    with urlink.connect("sim://") as robot, robot.rtde.outputs("actual_q") as stream:
        assert stream.name.endswith("rtde")


def test_monitor_is_marked_closed_before_subscriptions_end() -> None:
    with urlink.connect("sim://") as robot:
        robot.realtime.wait()
        monitor, seen = robot.safety._monitor, []
        robot.motion.stop(wait=True)
        for listening in monitor._listening.values():
            listening.add(lambda: seen.append(monitor.is_closed))
        monitor.close()
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
    with urlink.connect("sim://?firmware=10.12") as robot:
        torque = robot.motion.torque()
        with torque:
            say = torque._say

            def noting(*data: Any) -> None:
                seen.append(torque._message.is_mute)
                say(*data)

            monkeypatch.setattr(torque, "_say", noting)
            torque.send([0.0] * 6)
    assert seen == [True]


def test_stream_opened_after_rtde_close_is_closed() -> None:
    with urlink.connect("sim://") as robot:
        rtde = robot.rtde
        stream = rtde.outputs("actual_q")
        with rtde._lock:
            rtde._is_closed, rtde._open = True, []
        with pytest.raises(Closed):
            rtde._keep(stream)
        assert stream.is_over


# -- between two threads -----------------------------------------------------------------------------------


def test_output_registers_of_one_type_share_one_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    with urlink.connect("sim://") as robot:
        made = []
        outputs = type(robot.rtde).outputs

        def noting(rtde: Any, *names: Any, **how: Any) -> Any:
            made.append(names)
            return outputs(rtde, *names, **how)

        monkeypatch.setattr(type(robot.rtde), "outputs", noting)
        registers = robot.registers
        registers._lock = Contended(registers._lock, before=lambda: registers.read_integer(24))  # type: ignore[assignment]
        registers.read_integer(25)
    assert len(made) == 1


def test_claim_succeeds_when_it_waited_for_a_reconnection() -> None:
    with urlink.connect("sim://") as robot:
        robot.registers.write_integer(24, 1)
        claims = robot.rtde._claimed()

        def reconnect() -> None:
            before = claims._transport.dialogue
            claims._connection.abort()
            until(lambda: claims._transport.dialogue not in (None, before))
            until(lambda: claims._connection.state is ConnectionState.CONNECTED)

        claims._lock = Contended(claims._lock, before=reconnect)  # type: ignore[assignment]
        claims.claim(("input_int_register_25",))
        assert claims.has(("input_int_register_25",))


def test_stream_opened_while_the_robot_closes_is_closed() -> None:
    class Opened:
        is_over = False

        def close(self, timeout: float = 2.0) -> None:
            self.is_over = True

    with urlink.connect("sim://") as robot:
        rtde, opened = robot.rtde, Opened()
        rtde._lock = Contended(rtde._lock, before=rtde.close)  # type: ignore[assignment]
        with pytest.raises(Closed):
            rtde._keep(opened)  # type: ignore[type-var]
        assert opened.is_over


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
    with urlink.connect("sim://") as robot:
        robot.controller.faults.protective_stop()
        until(lambda: robot.safety.refusal)
        seen: list[bool] = []
        refusal = Interlock.refusal_to_begin

        def noting(interlock: Interlock, *arguments: Any) -> Any:
            seen.append(is_held(robot.safety._monitor._section.lock))
            return refusal(interlock, *arguments)

        monkeypatch.setattr(Interlock, "refusal_to_begin", noting)
        with pytest.raises(LinkTimeout):
            robot.safety.wait_enabled(0.1)
    assert seen
    assert all(seen)


def test_program_that_connects_while_link_closes_is_disconnected() -> None:
    class Closing(ReverseLink):
        """Link that another thread closes just after `_is_closed` was read as False."""

        _was_closed = False

        @property
        def _is_closed(self) -> bool:
            was_closed = self._was_closed
            if not was_closed and self.said:
                self.close()
            return was_closed

        @_is_closed.setter
        def _is_closed(self, value: bool) -> None:
            self._was_closed = value

        said = False

    link = Closing(ReversePort("127.0.0.1", host="127.0.0.1"))
    with socket.create_connection(("127.0.0.1", link.endpoint.port)) as program:
        program.sendall(link.endpoint.token.to_bytes(4, "big"))
        link.said = True
        until(lambda: link.poll(True) or link._was_closed)
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
