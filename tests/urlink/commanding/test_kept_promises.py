"""Small promises of commands, each of which a forgotten statement would break."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest

import urlink
from linkcore.clock import Stamp
from linkcore.errors import Closed
from linkcore.net.dialogue import Dialogue
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from tests.waiting import until
from urlink.commanding.monitor import _Listening
from urlink.interfaces.rtde.protocol import Requests
from urlink.interfaces.rtde.recipes import Outputs
from urlink.motion.reverse import ReversePort
from urlink.rtde.claims import CLAIM_TIMEOUT, BriefClaims

pytestmark = pytest.mark.simulated_time


def test_listening_is_over_before_its_subscriptions_end() -> None:
    listening = _Listening()
    seen: list[bool] = []
    listening.add(lambda: seen.append(listening.is_over))
    listening.end()
    assert seen == [True]


def test_line_may_begin_with_a_tab() -> None:
    with urlink.connect("sim://") as robot:
        robot.script.send_line("\tset_digital_out(0, True)")
        until(lambda: robot.controller.signals.digital_outputs & 1)


def test_next_link_on_a_fixed_port_replaces_the_previous_one() -> None:
    where = ReversePort("127.0.0.1", port=45_678)
    first = where.open()
    second = where.open()
    first.close(farewell=False)
    second.close(farewell=False)


def test_claim_without_waiting_returns_while_another_waits() -> None:
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


def test_new_connection_ends_no_program() -> None:
    with urlink.connect("sim://") as robot:
        motion = robot.motion.speed_joints([0.1] * 6, duration=0.4)
        programs = robot.motion._context.programs
        for state in (ConnectionState.CONNECTING, ConnectionState.CONNECTED):
            programs.on_event(ConnectionEvent(state, "primary", None, Stamp.now()))
        assert not motion.done
        motion.wait()


def test_claims_are_closed_before_they_are_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []
    monkeypatch.setattr(BriefClaims, "give_back", lambda claims, timeout=1.0: seen.append(claims._is_closed))
    with urlink.connect("sim://") as robot:
        robot.rtde._brief.close(1.0)
    assert seen[0] is True


def test_claims_can_be_closed_while_they_connect(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_settings_connect_in_time() -> None:
    with urlink.connect("sim://") as robot:
        claims = robot.rtde._connect_briefly(Requests(("timestamp",), None))
        assert claims._connection._timeout == CLAIM_TIMEOUT
        claims.close(1.0)


def test_outputs_are_named_after_rtde() -> None:
    with urlink.connect("sim://") as robot, robot.rtde.outputs("actual_q") as stream:
        assert stream.name.endswith("rtde")


def test_monitor_is_closed_before_its_hooks_are_dropped() -> None:
    with urlink.connect("sim://") as robot:
        robot.realtime.wait()
        monitor, seen = robot.safety._monitor, []
        robot.motion.stop(wait=True)
        for listening in monitor._listening.values():
            listening.add(lambda: seen.append(monitor.is_closed))
        monitor.close()
    assert seen
    assert all(seen)


def test_interpreter_is_closed_with_its_robot(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_torque_repeats_nothing_while_it_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_what_opens_after_rtde_was_closed_is_closed() -> None:
    with urlink.connect("sim://") as robot:
        rtde = robot.rtde
        stream = rtde.outputs("actual_q")
        with rtde._lock:
            rtde._is_closed, rtde._open = True, []
        with pytest.raises(Closed):
            rtde._keep(stream)
        assert stream.is_over
