"""`robot.rtde` with a scripted controller: streams, inputs, registers, and claims of inputs."""

from __future__ import annotations

import gc
import pickle
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue, Closed, ConnectionLost, LinkTimeout, LocalError
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff, ConnectionState
from linkcore.wire.packet import State, Vector
from tests.fakes.rtde import ScriptedRtde
from tests.urlink.rtde import names_stub
from tests.waiting import until
from urlink import InputInUse, NoSuchVariable
from urlink.protocol.firmware import Firmware
from urlink.protocol.rtde.packets import (
    InputsReply,
    InputsRequest,
    MessageLevel,
    OutputsRequest,
    RtdeMessage,
    StartRequest,
)
from urlink.rtde import Inputs, Outputs, Rtde, client
from urlink.session.identity import Identity
from urlink.session.source import Source

pytestmark = pytest.mark.simulated_time

AT_ONCE = Backoff(first=0, most=0)


class Cell(urlink.rtde.Outputs):
    actual_q: Vector
    output_int_register_24: int
    payload: float | None


@contextmanager
def rtde_of(*desks: ScriptedRtde, firmware: str = "5.11", refusal: str = "", timeout: float = 2.0) -> Iterator[Rtde]:
    """Provide an `Rtde` that connects to these scripted controllers, one after the other."""
    left = list(desks)
    known = Firmware.parse(firmware)

    def transport(interface: str) -> Any:
        assert interface == "rtde"
        return left.pop(0)

    source = Source(lambda: Identity(known, True, None), transport, AT_ONCE, timeout, None, False)
    rtde = Rtde("desk", source, lambda: known, refusal=refusal)
    try:
        yield rtde
    finally:
        rtde.close()


# -- outputs ---------------------------------------------------------------------------------------


def test_outputs_streams_variables() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde:
        stream = rtde.outputs("timestamp", "actual_q", frequency=125)
        assert desk.opened == 0, "the stream must not connect before its first use"
        state = stream.wait(2.0)
        assert state.actual_q.tolist() == [0.0] * 6
        desk.send_values(timestamp=7.0, actual_q=[1, 2, 3, 4, 5, 6])
        until(lambda: stream.latest is not None and stream.latest.timestamp == 7.0)
        newest = stream.latest
        assert newest is not None
        assert newest.actual_q.tolist() == [1, 2, 3, 4, 5, 6]
        assert newest.received is not None
        assert stream.stats.received == stream.stats.decoded
        assert stream.stats.failed == 0
        assert stream.recipe is not None
        assert stream.recipe.names == ("timestamp", "actual_q")
        assert (stream.left_out, str(stream.controller), stream.frequency) == ((), "5.11", 125)
        assert pickle.loads(pickle.dumps(newest)) == newest


def test_outputs_accepts_a_declared_class() -> None:
    desk = ScriptedRtde()
    desk.lacks = {"payload"}
    with rtde_of(desk) as rtde:
        stream = rtde.outputs(Cell)
        state = stream.wait(2.0)
        assert isinstance(state, Cell)
        assert (state.output_int_register_24, state.payload) == (0, None)
        assert stream.left_out == ("payload",)
        got: list[Cell] = []
        stream.subscribe(got.append)
        desk.send_values(output_int_register_24=5)
        until(lambda: bool(got))
        assert got[0].output_int_register_24 == 5


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda rtde: rtde.outputs(), "expected the names"),
        (lambda rtde: rtde.outputs("timestamp", frequency=501), "frequency=501; expected 1 to 500 packages per second"),
        (lambda rtde: rtde.outputs("timestamp", frequency=0.5), "frequency=0.5"),
        (lambda rtde: rtde.outputs("timestamp", frequency="125"), "frequency is '125'; expected a number"),
        (lambda rtde: rtde.outputs("timestamp", frequency=True), "frequency is True; expected a number"),
        (lambda rtde: rtde.outputs("timestamp", missing="maybe"), "missing='maybe'"),
        (lambda rtde: rtde.outputs(Outputs), "expected a class derived"),
        (lambda rtde: rtde.outputs(dict), "expected a class derived"),
        (lambda rtde: rtde.outputs(type("Nothing", (Outputs,), {})), "Nothing declares no variable"),
        (lambda rtde: rtde.inputs("speed_slider_mask"), "is a mask; request the variable"),
        (lambda rtde: rtde.inputs(), "expected the names"),
    ],
)
def test_invalid_arguments_are_rejected_before_sending(call: Callable[[Rtde], object], error: str) -> None:
    with rtde_of() as rtde, pytest.raises(BadValue, match=error):
        call(rtde)


def test_cb3_frequency_is_limited_to_125_hz() -> None:
    with rtde_of(firmware="3.15") as rtde, pytest.raises(BadValue, match="1 to 125"):
        rtde.outputs("timestamp", frequency=500)


def test_missing_variable_raises_at_first_use() -> None:
    desk = ScriptedRtde()
    desk.lacks = {"payload"}
    with rtde_of(desk) as rtde:
        stream = rtde.outputs("timestamp", "payload")
        with pytest.raises(NoSuchVariable, match="payload"):
            stream.wait(2.0)


def test_recipe_is_restored_after_lost_connection() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde:
        stream = rtde.outputs("timestamp")
        times: list[float] = []
        stream.subscribe(lambda state: times.append(state.timestamp), inline=True)
        until(lambda: len(times) == 1)
        desk.put(ConnectionLost("cut"))
        until(lambda: len(times) == 2)  # each connection starts with a data package
        desk.send_values(timestamp=9.0)
        until(lambda: times[-1] == 9.0)
        assert stream.stats.reconnects == 1
        assert [type(request).__name__ for request in desk.asked].count("OutputsRequest") == 2


def test_recipe_adapts_to_older_firmware_after_reconnection() -> None:
    """A controller that returns with an older firmware no longer has one of the variables."""
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde:
        stream = rtde.outputs("timestamp", "payload", missing="leave_out")
        assert stream.wait(2.0).payload == 0.0
        desk.lacks = {"payload"}
        desk.put(ConnectionLost("cut"))
        until(lambda: stream.stats.reconnects == 1 and stream.latest is not None)
        newest: Any = stream.latest
        assert newest.payload is None
        assert stream.left_out == ("payload",)


def test_stream_delivers_text_messages() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde:
        stream = rtde.outputs("timestamp")
        texts: list[RtdeMessage] = []
        stream.subscribe(texts.append, RtdeMessage)
        desk.put(bytes(RtdeMessage("2.0", message="hello", source="URControl", level=MessageLevel.INFO)))
        until(lambda: bool(texts))
        assert (texts[0].message, texts[0].source, texts[0].level) == ("hello", "URControl", MessageLevel.INFO)


def test_mismatched_package_is_only_counted() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde:
        stream = rtde.outputs("timestamp")
        stream.start()
        desk.put(b"\0\x05U\1\0")
        desk.send_values(timestamp=3.0)
        until(lambda: stream.latest is not None and stream.latest.timestamp == 3.0)
        assert stream.stats.failed == 1


# -- inputs ----------------------------------------------------------------------------------------


def test_masks_are_set_automatically() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde, rtde.inputs("speed_slider_fraction", "standard_digital_output") as inputs:
        assert inputs.names == ("speed_slider_fraction", "standard_digital_output")
        inputs.send(speed_slider_fraction=0.5)
        assert desk.written == {
            "speed_slider_mask": 1,
            "speed_slider_fraction": 0.5,
            "standard_digital_output_mask": 0,
            "standard_digital_output": 0,
        }
        inputs.send(standard_digital_output={0: True, 3: False})
        assert (desk.written["standard_digital_output_mask"], desk.written["standard_digital_output"]) == (0b1001, 1)
        assert desk.written["speed_slider_mask"] == 0
        inputs.send(standard_digital_output=0b110)
        assert (desk.written["standard_digital_output_mask"], desk.written["standard_digital_output"]) == (0xFF, 0b110)
        assert inputs.connection is ConnectionState.CONNECTED


def test_first_analog_output_needs_its_type() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde, rtde.inputs("standard_analog_output_0", "standard_analog_output_1") as inputs:
        with pytest.raises(BadValue, match="missing standard_analog_output_type; the first send"):
            inputs.send(standard_analog_output_0=0.5)
        inputs.send(standard_analog_output_0=0.5, standard_analog_output_type=1)
        assert (desk.written["standard_analog_output_mask"], desk.written["standard_analog_output_type"]) == (1, 1)
        inputs.send(standard_analog_output_1=1.0)
        assert (desk.written["standard_analog_output_mask"], desk.written["standard_analog_output_type"]) == (2, 1)


def test_inputs_without_mask_are_required_in_first_send() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde, rtde.inputs("input_int_register_24", "input_double_register_24") as inputs:
        with pytest.raises(BadValue, match="missing input_double_register_24; the first send"):
            inputs.send(input_int_register_24=1)
        assert desk.written == {}
        inputs.send(input_int_register_24=1, input_double_register_24=0.5)
        inputs.send(input_int_register_24=2)
        assert desk.written == {"input_int_register_24": 2, "input_double_register_24": 0.5}


def test_concurrent_sends_are_serialised(monkeypatch: pytest.MonkeyPatch) -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde, rtde.inputs("input_int_register_24", "input_int_register_25") as inputs:
        inputs.send(input_int_register_24=0, input_int_register_25=0)
        send, other = Connection.send, threading.Thread(target=inputs.send, kwargs={"input_int_register_25": 2})

        def slow(*arguments: Any) -> None:
            monkeypatch.setattr(Connection, "send", send)
            other.start()
            other.join(0.05)  # without serialisation, the other thread would send its package now
            send(*arguments)

        monkeypatch.setattr(Connection, "send", slow)
        inputs.send(input_int_register_24=1)
        other.join(10)
        assert desk.written == {"input_int_register_24": 1, "input_int_register_25": 2}


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({}, "cannot send nothing"),
        ({"timestamp": 1}, "cannot send timestamp"),
        ({"speed_slider_mask": 1}, "cannot send speed_slider_mask"),
        ({"speed_slider_fraction": 1.01}, "expected 0 to 1"),
        ({"speed_slider_fraction": float("nan")}, "expected a finite number"),
        ({"speed_slider_fraction": "half"}, "expected a number"),
        ({"tool_digital_output": {2: True}}, "output of tool_digital_output=2; expected a whole number from 0 to 1"),
        ({"tool_digital_output": {True: True}}, "output of tool_digital_output=True; expected a whole number"),
        ({"tool_digital_output": {0: 7}}, "expected True or False"),
        ({"tool_digital_output": 4}, "expected a number that sets only bits of 0x3"),
        ({"input_int_register_24": 2**31}, "expected -2147483648 to 2147483647"),
        ({"input_int_register_24": 1.0}, "expected a whole number"),
        ({"external_force_torque": [0, 0, 0]}, "expected 6 finite numbers"),
        ({"input_bit_register_64": 2}, "expected True or False"),
    ],
)
def test_input_values_are_checked(values: dict[str, Any], error: str) -> None:
    desk = ScriptedRtde()
    names = ["speed_slider_fraction", "tool_digital_output", "input_int_register_24", "external_force_torque"]
    with rtde_of(desk) as rtde, rtde.inputs(*names, "input_bit_register_64") as inputs:
        with pytest.raises(BadValue, match=error):
            inputs.send(**values)
        assert desk.written == {}


def test_numpy_numbers_are_accepted() -> None:
    desk = ScriptedRtde()
    names = ["input_int_register_24", "external_force_torque", "input_bit_register_64"]
    with rtde_of(desk) as rtde, rtde.inputs(*names) as inputs:
        inputs.send(
            input_int_register_24=np.int64(-3), external_force_torque=np.arange(6), input_bit_register_64=np.True_
        )
        assert desk.written == {
            "input_int_register_24": -3,
            "external_force_torque": (0, 1, 2, 3, 4, 5),
            "input_bit_register_64": True,
        }


def test_closed_streams_and_inputs_are_released() -> None:
    desks = [ScriptedRtde(), ScriptedRtde(), ScriptedRtde()]
    with rtde_of(*desks) as rtde:
        with rtde.outputs("timestamp") as stream:
            stream.wait(2.0)
        assert desks[0].is_closed
        assert stream.is_over
        inputs = rtde.inputs("input_int_register_24")
        inputs.close()
        released: list[weakref.ref[Any]] = [weakref.ref(stream), weakref.ref(inputs)]
        del stream, inputs
        rtde.outputs("timestamp")  # forgets those that are closed
        gc.collect()
        assert [each() for each in released] == [None, None]


@pytest.mark.simulated_time
def test_close_ends_unanswered_claim() -> None:
    desk = ScriptedRtde()
    desk.answers[InputsRequest] = lambda request: []
    ended: list[float] = []
    with rtde_of(desk) as rtde:

        def claim() -> None:
            with pytest.raises(Closed):
                rtde.inputs("input_int_register_24")
            ended.append(time.monotonic())

        thread = threading.Thread(target=claim)
        thread.start()
        until(lambda: any(isinstance(each, InputsRequest) for each in desk.asked))
        begun = time.monotonic()
        rtde.close()
        thread.join()
        assert ended[0] - begun < 0.1, "the claim waited for its timeout"
        assert desk.is_closed


def test_failed_claim_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    desk = ScriptedRtde()
    desk.held = {"speed_slider_fraction"}
    with rtde_of(desk, ScriptedRtde()) as rtde:
        made: list[weakref.ref[Inputs]] = []

        def noting(*arguments: Any) -> Inputs:
            inputs = Inputs(*arguments)
            made.append(weakref.ref(inputs))
            return inputs

        monkeypatch.setattr(client, "Inputs", noting)
        with pytest.raises(InputInUse):
            rtde.inputs("speed_slider_fraction")
        held = rtde.inputs("input_int_register_24")
        gc.collect()
        assert [each() for each in made] == [None, held]


def test_write_does_not_wait() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde, rtde.inputs("input_int_register_24", "input_double_register_24") as inputs:
        inputs._write({"input_int_register_24": 1, "input_double_register_24": 0.5})
        assert desk.written == {"input_int_register_24": 1, "input_double_register_24": 0.5}
        with pytest.raises(BadValue, match="input_int_register_24"):
            inputs._write({"input_int_register_24": 0.5})
        desk.make_room(5)
        with pytest.raises(ConnectionLost, match="does not read"):
            inputs._write({"input_int_register_24": 2, "input_double_register_24": 0.5})
        desk.make_room(None)
        until(lambda: desk.opened == 2 and inputs.connection is ConnectionState.CONNECTED)
        inputs._write({"input_int_register_24": 3, "input_double_register_24": 0.5})
        assert desk.written["input_int_register_24"] == 3
        inputs.close()
        with pytest.raises(Closed):
            inputs._write({"input_int_register_24": 4, "input_double_register_24": 0.5})


def test_input_in_use_is_named() -> None:
    desk = ScriptedRtde()
    desk.held = {"speed_slider_fraction"}
    with rtde_of(desk) as rtde, pytest.raises(InputInUse, match="speed_slider_fraction") as caught:
        rtde.inputs("speed_slider_fraction")
    assert caught.value.names == ("speed_slider_fraction",)


def test_inputs_are_claimed_again_but_not_sent_again() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde, rtde.inputs("input_int_register_24") as inputs:
        inputs.send(input_int_register_24=4)
        desk.written.clear()
        desk.put(ConnectionLost("cut"))
        until(lambda: desk.opened == 2 and inputs.connection is ConnectionState.CONNECTED)
        assert desk.written == {}
        inputs.send(input_int_register_24=5)
        assert desk.written == {"input_int_register_24": 5}


def test_recording_refuses_all_inputs() -> None:
    with rtde_of(refusal="is a recording") as rtde:
        calls: list[Callable[[], object]] = [
            lambda: rtde.inputs("input_int_register_24"),
            rtde.who_holds,
            lambda: rtde.registers().write_integer(24, 1),
        ]
        for call in calls:
            with pytest.raises(LocalError, match="is a recording"):
                call()


def test_closed_inputs_raise_closed() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde:
        inputs = rtde.inputs("input_int_register_24")
        inputs.close()
        inputs.close()
        with pytest.raises(Closed):
            inputs.send(input_int_register_24=1)


def test_who_holds_lists_unavailable_inputs() -> None:
    desk = ScriptedRtde()
    desk.held = {"speed_slider_mask", "input_int_register_0"}
    desk.lacks = {"external_force_torque"}
    with rtde_of(desk) as rtde:
        assert rtde.who_holds() == {
            "speed_slider_mask": "in use",
            "external_force_torque": "not there",
            "input_int_register_0": "in use",
        }
    assert desk.is_closed


def test_missing_lists_variables_in_limited_requests() -> None:
    for protocol in (1, 2):
        desk = ScriptedRtde()
        desk.protocols = {protocol}
        desk.lacks = {"timestamp", "input_double_register_47"}
        with rtde_of(desk) as rtde:
            assert rtde.missing() == ("timestamp", "input_double_register_47")
        assert max(len(request.names) for request in desk.asked if isinstance(request, OutputsRequest)) <= 2048


# -- registers -------------------------------------------------------------------------------------


def test_registers_are_claimed_at_first_write() -> None:
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde:
        registers = rtde.registers()
        registers.write_integer(24, 7)
        registers.write_float(47, 0.25)
        registers.write_bit(64, True)
        registers.write_integer(24, 8)
        assert desk.written == {
            "input_int_register_24": 8,
            "input_double_register_47": 0.25,
            "input_bit_register_64": True,
        }
        assert [type(request).__name__ for request in desk.asked].count("InputsRequest") == 3
        desk.put(ConnectionLost("cut"))
        until(lambda: desk.opened == 2 and len(desk.claims) == 3)

        def is_written() -> bool:
            try:
                registers.write_float(47, 0.5)
            except ConnectionLost:
                return False
            return True

        until(is_written)
        assert desk.written["input_double_register_47"] == 0.5
        assert [type(request).__name__ for request in desk.asked].count("InputsRequest") == 6


def test_unavailable_registers_are_rejected() -> None:
    desk = ScriptedRtde()
    desk.held = {"input_int_register_24"}
    with rtde_of(desk) as rtde:
        registers = rtde.registers()
        for number in (-1, 48, 1.0):
            with pytest.raises(BadValue, match="whole number from 0 to 47"):
                registers.write_integer(number, 1)  # type: ignore[arg-type]
        with pytest.raises(
            BadValue,
            match=r"expected 24 to 47, because lower registers are for fieldbuses and PLCs \(robot.rtde.registers",
        ):
            registers.write_float(23, 1)
        with pytest.raises(BadValue, match="64 to 127"):
            registers.write_bit(63, True)
        with pytest.raises(InputInUse, match="input_int_register_24"):
            registers.write_integer(24, 1)
        rtde.registers(lower=True).write_integer(0, 1)
        assert desk.written == {"input_int_register_0": 1}


def test_refused_claim_raises_rtde_refused() -> None:
    desk = ScriptedRtde()
    desk.answers[InputsRequest] = lambda request: [InputsReply(recipe=0, types="INT32")]
    with rtde_of(desk) as rtde, pytest.raises(urlink.RtdeRefused, match="refused the inputs"):
        rtde.registers().write_integer(24, 1)


def test_register_write_in_handler_fails_at_once_during_claim() -> None:
    """The interrupted main thread waits for a reply, and cannot continue before the handler has returned."""
    desk = ScriptedRtde()
    with rtde_of(desk) as rtde:
        registers = rtde.registers()
        failures: list[tuple[Exception, float]] = []

        def handler(request: Any) -> list[State]:
            began = time.monotonic()
            with pytest.raises(LinkTimeout, match="this signal handler has interrupted") as caught:
                registers.write_integer(25, 1)
            failures.append((caught.value, time.monotonic() - began))
            return desk.usual(request)

        desk.answers[InputsRequest] = handler  # it is called in the claiming thread, like a signal handler
        registers.write_integer(24, 1)
        assert len(failures) == 1
        assert failures[0][1] < 0.01  # seconds of simulated time


def test_late_reply_is_not_used_for_next_claim() -> None:
    desk = ScriptedRtde()
    late: list[State] = []

    def keep(request: Any) -> list[State]:
        late.extend(desk.usual(request))
        return []

    with rtde_of(desk, timeout=0.2) as rtde:
        registers = rtde.registers()
        desk.answers[InputsRequest] = keep
        with pytest.raises(LinkTimeout, match="input_int_register_24 was not answered"):
            registers.write_integer(24, 1)
        desk.answers.clear()
        until(lambda: desk.opened == 2 and len(desk.asked) and type(desk.asked[-1]) is StartRequest)
        desk.put(b"".join(map(bytes, late)))

        def is_written() -> bool:
            try:
                registers.write_integer(25, 2)
            except (ConnectionLost, LinkTimeout):
                return False
            return True

        until(is_written)
        assert desk.written == {"input_int_register_25": 2}


def test_read_methods_return_output_registers() -> None:
    desks = [ScriptedRtde() for _ in range(4)]
    with rtde_of(*desks) as rtde:
        registers = rtde.registers(lower=True)
        assert registers.read_integer(0) == 0
        desks[0].send_values(output_int_register_47=-5)
        until(lambda: registers.read_integer(47) == -5)
        assert registers.read_float(30) == 0.0
        assert registers.read_bit(64) is False
        assert registers.read_bit(33) is False
        desks[3].send_values(output_bit_registers32_to_63=2)
        until(lambda: registers.read_bit(33))


def test_names_stub_equals_table() -> None:
    assert names_stub.PATH.read_text(encoding="utf-8") == names_stub.text(), "run tests/urlink/rtde/names_stub.py"
