"""History of a stream: its last seconds as arrays."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from linkcore.clock import Stamp
from linkcore.errors import BadValue
from linkcore.net.transport import Finished
from linkcore.streaming.connection_life import ConnectionEvent
from linkcore.streaming.history import History
from linkcore.streaming.stream import Stream
from tests.fakes.link import Count, ScriptedTransport, counts
from tests.waiting import until
from urlink.protocol.realtime.packets import RealtimeState

pytestmark = pytest.mark.simulated_time


class Nothing:
    """Subscription that is never called."""

    def close(self, timeout: float) -> None: ...


def of_states(*states: tuple[float, RealtimeState], seconds: float = 10.0) -> History:
    """Return a history of states that arrived at the given times."""
    callbacks: list[Any] = []

    def subscribe(keep: Any) -> Any:
        callbacks.append(keep)
        return Nothing()

    history = History(RealtimeState, seconds, subscribe)
    for received, state in states:
        state._stamp = Stamp(received, 1e9 + received)
        callbacks[0](state)
    return history


def test_history_keeps_packets_in_order(stream: Stream[Count], transport: ScriptedTransport) -> None:
    with stream.history(60.0) as history:
        assert len(history.array()) == 0
        transport.put(counts(*range(50)))
        until(lambda: len(history) == 50)
        array = history.array("number")
        assert array.dtype.names == ("received", "received_wall", "number")
        assert array["number"].tolist() == list(range(50))
        assert (np.diff(array["received"]) >= 0.0).all()
        assert (
            np.abs(array["received_wall"] - array["received"] - (array["received_wall"] - array["received"])[0]).max()
            < 1
        )
    transport.put(counts(99), Finished())
    assert stream.join(10)
    assert len(history.array()) == 50


def test_history_drops_older_states() -> None:
    states = [(t, RealtimeState("5.11", time=t)) for t in np.arange(0.0, 10.0, 0.1).tolist()]
    history = of_states(*states, seconds=1.05)
    assert history.array("time")["time"] == pytest.approx(np.arange(8.9, 9.95, 0.1))


def test_history_column_can_be_a_single_element() -> None:
    state = RealtimeState("5.11", q_actual=[1, 2, 3, 4, 5, 6])
    assert of_states((1.0, state)).array("q_actual_3")["q_actual_3"].tolist() == [4.0]
    with pytest.raises(BadValue, match="has no field 'q_actual_6'"):
        of_states((1.0, state)).array("q_actual_6")
    names: list[str] = ["q_actual"]
    with pytest.raises(BadValue, match="expected each name as an argument"):
        of_states((1.0, state)).array(names)  # type: ignore[arg-type]


def test_history_columns_have_the_shape_of_their_fields() -> None:
    first = RealtimeState("5.11", q_actual=[1, 2, 3, 4, 5, 6], digital_input_bits=5, time=2.5)
    second = RealtimeState("5.11", q_actual=[6, 5, 4, 3, 2, 1], digital_input_bits=6, time=2.6)
    history = of_states((1.0, first), (1.1, second))
    array = history.array("q_actual", "digital_input_bits", "joint_modes", "time")
    assert array["q_actual"].tolist() == [[1, 2, 3, 4, 5, 6], [6, 5, 4, 3, 2, 1]]
    assert array["digital_input_bits"].tolist() == [5, 6]
    assert array["joint_modes"].dtype == np.int64
    assert array["joint_modes"].shape == (2, 6)
    assert array["received"].tolist() == [1.0, 1.1]
    assert history["q_actual"].tolist() == array["q_actual"].tolist()
    assert history["received"].tolist() == [1.0, 1.1]
    everything = np.asarray(history)
    assert "payload_mass" in (everything.dtype.names or ())
    assert everything["time"].tolist() == [2.5, 2.6]


def test_history_drops_states_of_another_firmware() -> None:
    history = of_states((1.0, RealtimeState("5.9", time=1.0)), (1.1, RealtimeState("3.4", time=2.0)))
    assert history.array("time")["time"].tolist() == [2.0]
    assert "payload_mass" not in (history.array().dtype.names or ())
    with pytest.raises(BadValue, match="payload_mass of RealtimeState is not sent by this firmware"):
        history.array("payload_mass")


def test_history_rejects_invalid_arguments(stream: Stream[Count]) -> None:
    for seconds in (0.0, -1.0, math.inf, math.nan):
        with pytest.raises(BadValue, match="seconds"):
            stream.history(seconds)
    with pytest.raises(BadValue, match="has no fields to keep"):
        stream.of(ConnectionEvent).history(1.0)
    with stream.history(1.0) as history, pytest.raises(BadValue, match="no field 'q'; expected one of number"):
        history.array("q")
