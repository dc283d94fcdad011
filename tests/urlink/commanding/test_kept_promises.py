"""Small promises of commands, each of which a forgotten statement would break."""

from __future__ import annotations

import threading
import time

import pytest

import urlink
from linkcore.clock import Stamp
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from tests.waiting import until
from urlink.commanding.monitor import _Listening
from urlink.motion.reverse import ReversePort
from urlink.rtde.claims import BriefClaims

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
