"""Client side of RTDE with a scripted controller, and with recorded replies."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue, ConnectFailed, LinkTimeout, PacketError
from linkcore.streaming.receiver import Receiver
from linkcore.streaming.statistics import StreamCounters
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State
from tests import real_captures
from tests.fakes.rtde import RequestBoundary, ScriptedRtde
from tests.urlink.protocol.rtde_material import Recorded, recordings, replies
from urlink.protocol.rtde.packets import (
    ControllerVersionReply,
    DataPackage,
    InputsReply,
    InputsRequest,
    MessageLevel,
    OutputsReply,
    OutputsRequest,
    ProtocolReply,
    ProtocolRequest,
    RtdeBoundary,
    RtdeMessage,
    StartReply,
    StartRequest,
    decode_reply,
    decode_request,
    split_names,
)
from urlink.protocol.rtde.protocol import InputInUse, NoSuchVariable, Requests, RtdeProtocol, RtdeRefused, check_names
from urlink.protocol.rtde.recipes import Outputs, Recipe
from urlink.protocol.rtde.transport import RtdeTransport

pytestmark = pytest.mark.simulated_time


def opened(desk: ScriptedRtde, plan: Requests, timeout: float = 2.0) -> tuple[RtdeTransport, RtdeProtocol]:
    transport = RtdeTransport(desk, plan)
    transport.open(timeout)
    assert transport.dialogue is not None
    return transport, transport.dialogue


def received(transport: RtdeTransport, plan: Requests, count: int = 1) -> list[Any]:
    """Return the packets that a stream gets from the next chunks, including the bytes of the dialogue."""
    receiver = Receiver("desk", RtdeProtocol(plan), StreamCounters())
    packets: list[Any] = []
    while sum(isinstance(packet, Outputs) for packet in packets) < count:
        data, stamp = transport.receive(2.0)
        packets += receiver.feed(data, stamp)
    return packets


def asked(desk: ScriptedRtde) -> list[str]:
    return [type(request).__name__ for request in desk.asked]


def test_requests_are_sent_in_order() -> None:
    desk = ScriptedRtde()
    plan = Requests(("timestamp", "actual_q"), 125.0, inputs=[("speed_slider_mask", "speed_slider_fraction")])
    transport, dialogue = opened(desk, plan)
    names = ["Protocol", "ControllerVersion", "Outputs", "Inputs", "Start"]
    assert asked(desk) == [f"{name}Request" for name in names]
    assert (desk.asked[2].frequency, desk.asked[2].names) == (125.0, "timestamp,actual_q")
    assert str(dialogue.controller) == "5.11"
    assert [claim.number for claim in dialogue.claims] == [1]
    state = received(transport, plan)[-1]
    assert (state.timestamp, state.actual_q.tolist()) == (0.0, [0.0] * 6)
    desk.send_values(timestamp=41.0)
    data, _ = transport.receive(1.0)
    assert data == bytes(desk.data(timestamp=41.0))


@pytest.mark.parametrize(("firmware", "frequency"), [((3, 15, 8), 125.0), ((5, 4, 3), 500.0), ((10, 12, 0), 500.0)])
def test_default_frequency_is_maximum_of_controller(firmware: tuple[int, int, int], frequency: float) -> None:
    desk = ScriptedRtde()
    desk.firmware = (*firmware, 0)
    opened(desk, Requests(("timestamp",)))
    assert desk.asked[2].frequency == frequency


def test_interrupted_open_closes_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    desk = ScriptedRtde()

    def interrupted(transport: RtdeTransport, dialogue: object) -> None:
        assert not desk.is_closed
        raise KeyboardInterrupt

    monkeypatch.setattr(RtdeTransport, "_begin", interrupted)
    with pytest.raises(KeyboardInterrupt):
        RtdeTransport(desk, Requests(("timestamp",))).open(5.0)
    assert desk.is_closed


def test_missing_optional_variable_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    desk = ScriptedRtde()
    desk.lacks = {"payload", "payload_cog"}
    plan = Requests(("timestamp", "payload", "actual_q", "payload_cog"), optional=frozenset(["payload", "payload_cog"]))
    with caplog.at_level(logging.INFO):
        transport, dialogue = opened(desk, plan)
    assert dialogue.recipe is not None
    assert dialogue.recipe.names == ("timestamp", "actual_q")
    assert "does not have payload, payload_cog" in caplog.text
    state = received(transport, plan)[-1]
    assert (state.payload, state.payload_cog, state.actual_q.tolist()) == (None, None, [0.0] * 6)
    assert state.LEFT_OUT == ("payload", "payload_cog")


def test_missing_required_variable_raises() -> None:
    desk = ScriptedRtde()
    desk.lacks = {"payload"}
    with pytest.raises(NoSuchVariable, match=r"does not have actual_Q \(did you mean actual_q\?\), payload") as caught:
        opened(desk, Requests(("actual_Q", "timestamp", "payload")))
    assert caught.value.names == ("actual_Q", "payload")
    with pytest.raises(NoSuchVariable, match="none of payload"):
        opened(desk, Requests(("payload",), optional=frozenset(["payload"])))


def test_unknown_type_counts_as_missing_variable() -> None:
    desk = ScriptedRtde()
    desk.answers[OutputsRequest] = lambda request: [OutputsReply("2.0", recipe=1, types="STRING")]
    with pytest.raises(NoSuchVariable, match=r"timestamp .unknown type STRING"):
        opened(desk, Requests(("timestamp",)))


def test_input_in_use_raises() -> None:
    desk = ScriptedRtde()
    desk.held = {"speed_slider_mask"}
    with pytest.raises(InputInUse, match="another client or a fieldbus holds speed_slider_mask") as caught:
        opened(desk, Requests(inputs=[("input_int_register_24",), ("speed_slider_mask", "speed_slider_fraction")]))
    assert caught.value.names == ("speed_slider_mask",)


@pytest.mark.parametrize(
    ("request_class", "reply", "error"),
    [
        (StartRequest, StartReply(accepted=False), "refused to start"),
        (OutputsRequest, OutputsReply("2.0", recipe=0, types="DOUBLE"), "refused the outputs timestamp"),
        (OutputsRequest, OutputsReply("2.0", recipe=1, types="DOUBLE,DOUBLE"), "2 types .* for 1 names"),
        (OutputsRequest, OutputsReply("2.0", recipe=1, types=""), "0 types .* for 1 names"),
        (InputsRequest, InputsReply(recipe=0, types="INT32"), "refused the inputs input_int_register_24"),
    ],
)
def test_refusal_raises_rtde_refused(request_class: type[State], reply: State, error: str) -> None:
    desk = ScriptedRtde()
    desk.answers[request_class] = lambda request: [reply]
    with pytest.raises(RtdeRefused, match=error):
        opened(desk, Requests(("timestamp",), inputs=[("input_int_register_24",)]))


@pytest.mark.parametrize(
    ("request_class", "awaited"),
    [
        (ProtocolRequest, "ProtocolReply"),
        (OutputsRequest, "OutputsReply"),
        (StartRequest, "StartReply"),
    ],
)
def test_missing_reply_is_named(request_class: type[State], awaited: str) -> None:
    desk = ScriptedRtde()
    desk.answers[request_class] = lambda request: []
    with pytest.raises(LinkTimeout, match=rf"no {awaited} arrived within 0.05 s"):
        opened(desk, Requests(("timestamp",)), 0.05)


def test_start_without_data_times_out() -> None:
    desk = ScriptedRtde()
    desk.answers[StartRequest] = lambda request: [StartReply(accepted=True)]
    with pytest.raises(LinkTimeout, match=r"no data packages arrived within 0.05 s"):
        opened(desk, Requests(("timestamp",)), 0.05)


def test_text_and_data_before_a_reply_are_accepted(caplog: pytest.LogCaptureFixture) -> None:
    """PolyScope X sends "SafetySetup has not been confirmed yet" on each connection; data may precede a reply."""
    desk = ScriptedRtde()
    plan = Requests(("timestamp",), inputs=[("input_int_register_24",)])

    def after_text(request: Any) -> list[State]:
        text = RtdeMessage(f"{desk.protocol}.0", message="not confirmed", level=MessageLevel.WARNING)
        data = [] if desk.outputs is None else [desk.data()]
        return [text, *data, *desk.usual(request), text]

    desk.answers = dict.fromkeys((ProtocolRequest, OutputsRequest, InputsRequest, StartRequest), after_text)
    transport, dialogue = opened(desk, plan)
    assert dialogue.is_ready
    with caplog.at_level(logging.WARNING):
        packets = received(transport, plan)
    texts = [packet for packet in packets if isinstance(packet, RtdeMessage)]
    assert len(texts) >= 6
    assert all(text.message == "not confirmed" for text in texts)
    assert "message from the controller: 'not confirmed'" in caplog.text


def test_protocol_1_is_supported(caplog: pytest.LogCaptureFixture) -> None:
    desk = ScriptedRtde()
    desk.protocols = {1}
    plan = Requests(("timestamp", "actual_q"), 50.0)
    with caplog.at_level(logging.WARNING):
        transport, dialogue = opened(desk, plan)
    assert dialogue.protocol == 1
    assert dialogue.recipe is not None
    assert dialogue.recipe.number is None
    assert "125 Hz, not 50 Hz" in caplog.text
    assert received(transport, plan)[-1].actual_q.tolist() == [0.0] * 6
    desk.lacks = {"timestamp"}
    with pytest.raises(NoSuchVariable, match="timestamp"):
        opened(desk, plan)


def test_mismatched_data_packages_raise() -> None:
    desk = ScriptedRtde()
    plan = Requests(("timestamp",))
    opened(desk, plan)
    protocol = RtdeProtocol(plan)
    good = bytes(desk.data())
    with pytest.raises(PacketError, match="arrived before its recipe"):
        protocol.decode(good)
    for frame in (
        ProtocolReply(accepted=True),
        ControllerVersionReply(major=5, minor=11),
        OutputsReply("2.0", recipe=1, types="DOUBLE"),
    ):
        protocol.decode(bytes(frame))
    assert protocol.decode(good).timestamp == 0.0
    for bad in (b"\0\x0bU" + good[3:-1], good[:3] + b"\2" + good[4:]):
        with pytest.raises(PacketError, match="data package"):
            protocol.decode(bad)
    with pytest.raises(PacketError, match="unknown type 90"):
        protocol.decode(b"\0\3Z")
    assert protocol.unknown == 1


def test_recorded_recipe_is_replaced_at_next_connection() -> None:
    """A recording that starts late stores the current recipe separately; the next connection negotiates a new one."""
    recorded = Recipe(("timestamp", "payload"), ("DOUBLE", "DOUBLE"), 1)
    protocol = RtdeProtocol(Requests(recorded.names, optional=frozenset(recorded.names), recorded=recorded))
    assert protocol.decode(recorded.encode({"timestamp": 1.0, "payload": 2.0})).payload == 2.0
    for reply in (
        ProtocolReply(accepted=True),
        ControllerVersionReply(major=5, minor=4),
        OutputsReply("2.0", recipe=0, types="DOUBLE,NOT_FOUND"),
        OutputsReply("2.0", recipe=2, types="DOUBLE"),
        StartReply(accepted=True),
    ):
        protocol.decode(bytes(reply))
    state = protocol.decode(Recipe(("timestamp",), ("DOUBLE",), 2).encode({"timestamp": 3.0}))
    assert (state.timestamp, state.payload) == (3.0, None)


def test_transport_disconnects_when_dialogue_fails() -> None:
    desk = ScriptedRtde()
    desk.lacks = {"timestamp"}
    transport = RtdeTransport(desk, Requests(("timestamp",)))
    with pytest.raises(NoSuchVariable):
        transport.open(1.0)
    assert desk.is_closed
    refused = ScriptedRtde(ConnectFailed("refused"))
    with pytest.raises(ConnectFailed):
        RtdeTransport(refused, Requests(("timestamp",))).open(1.0)


@pytest.mark.parametrize(
    ("names", "error"),
    [
        ([], "expected the names"),
        ("actual_q", "expected the names"),
        (["actual_q", "timestamp", "actual_q"], "actual_q was given more than once"),
        (["actual q"], "is not a valid name"),
        (["a,b"], "is not a valid name"),
        ([""], "is not a valid name"),
        (["tail"], "is not a valid name"),
        ([f"output_bit_register_{number}" for number in range(1000, 1090)], "names have 2249 bytes"),
    ],
)
def test_invalid_names_are_rejected(names: list[str], error: str) -> None:
    with pytest.raises(BadValue, match=error):
        check_names(names)


# -- arbitrary replies -----------------------------------------------------------------------------

ANSWERS = st.one_of(
    replies(1),
    replies(2),
    st.builds(
        lambda number, types: OutputsReply("2.0", recipe=number, types=",".join(types)),
        st.integers(0, 2),
        st.lists(st.sampled_from(["DOUBLE", "VECTOR6D", "NOT_FOUND", "IN_USE", "STRING", ""]), max_size=3),
    ),
    st.builds(
        lambda number, types: InputsReply(recipe=number, types=",".join(types)),
        st.integers(0, 2),
        st.lists(st.sampled_from(["INT32", "DOUBLE", "NOT_FOUND", "IN_USE"]), max_size=2),
    ),
    st.sampled_from(
        [ProtocolReply(accepted=True), StartReply(accepted=True), ControllerVersionReply(major=5, minor=4)]
    ),
)


@pytest.mark.property
@given(
    answers=st.lists(ANSWERS.map(bytes) | st.binary(min_size=3, max_size=20), max_size=12),
    optional=st.booleans(),
    frequency=st.sampled_from([None, 125.0]),
)
def test_any_replies_give_packets_or_documented_errors(
    answers: list[bytes], optional: bool, frequency: float | None
) -> None:
    names = ("timestamp", "actual_q")
    plan = Requests(names, frequency, frozenset(names if optional else ()), [("input_int_register_24",)])
    protocol = RtdeProtocol(plan)
    for answer in answers:
        requests = Framer(RequestBoundary()).feed(protocol.requests())
        assert all(isinstance(decode_request(frame, protocol.protocol), State) for frame in requests)
        try:
            assert isinstance(protocol.decode(answer), State)
        except PacketError:
            continue
        except RtdeRefused:
            return
    if protocol.is_ready:
        assert protocol.recipe is not None
        assert set(protocol.recipe.names) <= set(names)
        assert optional or protocol.recipe.names == names
        assert len(protocol.claims) == 1


# -- recorded replies ------------------------------------------------------------------------------


def answers_in(recording: Recorded) -> tuple[Requests, dict[str, list[bytes]], bool]:
    """Return the requests of the recorded client, the replies to them, and whether all requests were granted."""
    unanswered = [frame for frame in Framer(RequestBoundary()).feed(recording.sent) if frame[2] not in b"MU"]
    protocol: Any = 1
    outputs: tuple[str, ...] = ()
    inputs: list[tuple[str, ...]] = []
    answers: dict[str, list[bytes]] = {kind: [] for kind in "VvOISPU"}
    is_granted = True
    for frame in Framer(RtdeBoundary()).feed(recording.received):
        reply: Any = decode_reply(frame, protocol)
        if isinstance(reply, RtdeMessage):
            continue
        if isinstance(reply, DataPackage):
            answers["U"].append(frame)
            continue
        request: Any = decode_request(unanswered.pop(0), protocol)
        if isinstance(reply, OutputsReply) and answers["O"]:
            answers["O"].clear()  # a second recipe replaces the first; our client requests only one recipe
            answers["U"].clear()
        answers[chr(frame[2])].append(frame)
        if isinstance(reply, ProtocolReply) and reply.accepted:
            protocol = request.wanted
        elif isinstance(reply, OutputsReply):
            outputs = split_names(request.names)
        elif isinstance(reply, InputsReply):
            inputs.append(split_names(request.names))
        is_granted &= "IN_USE" not in getattr(reply, "types", "") and "NOT_FOUND" not in getattr(reply, "types", "")
        is_granted &= getattr(reply, "accepted", True) or isinstance(reply, ProtocolReply)
        is_granted &= getattr(reply, "recipe", 1) != 0
    return Requests(outputs, inputs=inputs), answers, is_granted


#: Replies for requests that the recorded client did not make, or whose reply it did not wait for.
USUAL = {
    "V": bytes(ProtocolReply(accepted=False)),
    "v": bytes(ControllerVersionReply(major=5, minor=11)),
    "S": bytes(StartReply(accepted=True)),
}


def replayed(plan: Requests, answers: dict[str, list[bytes]]) -> Iterator[tuple[RtdeProtocol, bytes]]:
    """Yield our client and the recorded data packages, after its requests got the recorded replies."""
    protocol = RtdeProtocol(plan)
    left = {kind: list(frames) for kind, frames in answers.items()}
    while not protocol.is_ready:
        for frame in Framer(RequestBoundary()).feed(protocol.requests()):
            kind = chr(frame[2])
            protocol.take(left[kind].pop(0) if left[kind] else USUAL[kind])
    for frame in answers["U"]:
        yield protocol, frame


@pytest.mark.captures("rtde")
def test_client_accepts_recorded_replies() -> None:
    """With the replies that real clients got, our client succeeds or raises `RtdeRefused`."""
    granted = refused = packages = 0
    for recording in recordings(real_captures.folder("rtde")):
        plan, answers, is_granted = answers_in(recording)
        if "hand" in recording.name or not (plan.outputs or plan.inputs):
            continue  # handwritten requests for special replies, which our client does not make
        try:
            for protocol, frame in replayed(plan, answers):
                assert protocol.recipe is not None
                if len(frame) == protocol.recipe.size:
                    packages += isinstance(protocol.decode(frame), Outputs)
            assert is_granted, recording.name
            granted += 1
        except RtdeRefused:
            assert not is_granted, recording.name
            refused += 1
    assert granted > 50
    assert refused > 3
    assert packages > 1000
