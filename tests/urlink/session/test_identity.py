"""Identification of a peer: controllers of every generation, and other servers that can listen at an address."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator

import pytest

import urlink
from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout, LocalError, WrongPeer
from tests.fakes.server import OneAfterAnother
from urlink.arm.models import MODELS
from urlink.packets import RobotState, VersionMessage
from urlink.protocol.firmware import RELEASES, Firmware, Release
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.session.identity import Identity, KnownIdentity, identify
from urlink.simulator import Controller
from urlink.simulator.interfaces.interface import package

pytestmark = pytest.mark.simulated_time

#: Tolerance for timeouts, in seconds, because the computer might be busy.
MARGIN = 3.0

Behaviour = Callable[[socket.socket, threading.Event], None]


class Server(OneAfterAnother):
    """Server with the same behaviour for each connection."""

    def __init__(self, behaviour: Behaviour) -> None:
        self.over = threading.Event()
        self._behaviour = behaviour
        super().__init__()

    def _talk(self, connection: socket.socket) -> None:
        self._behaviour(connection, self.over)

    def close(self) -> None:
        self.over.set()
        super().close()


@pytest.fixture
def serve() -> Iterator[Callable[[Behaviour], int]]:
    servers: list[Server] = []

    def serve(behaviour: Behaviour) -> int:
        servers.append(Server(behaviour))
        return servers[-1].port

    yield serve
    for server in servers:
        server.close()


def says(*parts: bytes, then_close: bool = False) -> Behaviour:
    """Return a behaviour that sends these parts, each in a separate segment, and then nothing."""

    def behave(connection: socket.socket, over: threading.Event) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for part in parts:
            connection.sendall(part)
        if not then_close:
            over.wait(30)

    return behave


def timed_identify(port: int, timeout: float) -> Identity:
    """Call `identify`, and check that it keeps its timeout even if it raises."""
    began = time.monotonic()
    try:
        return identify("127.0.0.1", port, timeout)
    finally:
        assert time.monotonic() - began < timeout + MARGIN


def greeting(model: str, firmware: str) -> tuple[bytes, bytes, bytes]:
    """Version message, first state and a later state of a controller."""
    controller = Controller(model, firmware)
    version = next(each for each in controller.greeting("primary") if is_version(each))
    return version, controller.state_package(first=True), controller.state_package()


def is_version(data: bytes) -> bool:
    return isinstance(PrimaryProtocol().decode(data), VersionMessage)


VERSION, FIRST_STATE, STATE = greeting("UR5e", "5.11")


# -- controllers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", RELEASES, ids=lambda row: str(row.since))
def test_every_generation_is_identified(row: Release) -> None:
    model = "UR10e" if row.since.is_e_series else "UR10"
    with Controller(model, row.since) as controller:
        for interface in ("primary", "secondary_readonly"):
            began = time.monotonic()
            identity = timed_identify(controller.ports[interface], 10)
            assert identity.firmware[:2] == row.since[:2]
            assert identity.said_so
            # The oldest controllers send no configuration data, which contain the model.
            assert identity.model == (model if 6 in row.state else None)
            if identity.model is not None:
                assert time.monotonic() - began < MARGIN, "identify must return when everything is known"


def test_version_after_first_state_is_used(serve: Callable[[Behaviour], int]) -> None:
    assert timed_identify(serve(says(FIRST_STATE, STATE, VERSION)), 10) == Identity(Firmware(5, 11), True, "UR5e")


def test_greeting_in_single_bytes_is_identified(serve: Callable[[Behaviour], int]) -> None:
    port = serve(says(*(bytes([byte]) for byte in VERSION + FIRST_STATE)))
    assert timed_identify(port, 10) == Identity(Firmware(5, 11), True, "UR5e")


def test_version_without_state_gives_no_model(serve: Callable[[Behaviour], int]) -> None:
    assert timed_identify(serve(says(VERSION)), 0.5) == Identity(Firmware(5, 11), True, None)


@pytest.mark.parametrize("row", RELEASES, ids=lambda row: str(row.since))
def test_firmware_is_inferred_from_sizes_without_version(serve: Callable[[Behaviour], int], row: Release) -> None:
    _, first, later = greeting("UR5e" if row.since.is_e_series else "UR5", str(row.since))
    identity = timed_identify(serve(says(first, later)), 0.25)
    assert not identity.said_so
    assert identity.firmware <= row.since, "expected the oldest firmware that sends such states"
    same = [each for each in RELEASES if each.since == identity.firmware]
    assert {kind: size for kind, size in same[0].state.items() if kind not in (5, 6)} == {
        kind: size for kind, size in row.state.items() if kind not in (5, 6)
    }
    assert (identity.model is None) == (6 not in row.state)


def test_peer_that_closes_after_greeting_is_identified(serve: Callable[[Behaviour], int]) -> None:
    port = serve(says(VERSION, FIRST_STATE, then_close=True))
    assert timed_identify(port, 10) == Identity(Firmware(5, 11), True, "UR5e")
    port = serve(says(VERSION, then_close=True))
    assert timed_identify(port, 10) == Identity(Firmware(5, 11), True, None)


def test_bad_package_does_not_prevent_identification(serve: Callable[[Behaviour], int]) -> None:
    bad = package(16, package(0, b"too short"))
    port = serve(says(bad, VERSION, FIRST_STATE))
    assert timed_identify(port, 10) == Identity(Firmware(5, 11), True, "UR5e")


def test_states_of_unknown_firmware_raise_wrong_peer(serve: Callable[[Behaviour], int]) -> None:
    state = PrimaryProtocol().decode(STATE)
    assert isinstance(state, RobotState)
    body = b"".join(bytes(part) for part in state.packages) + package(77, b"from the future")
    with pytest.raises(WrongPeer, match="sends packets of a UR controller, but not its version"):
        timed_identify(serve(says(package(16, body))), 0.3)


# -- other peers --------------------------------------------------------------------------------------


def test_refused_connection_raises_connect_failed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
    with pytest.raises(ConnectFailed, match="refused"):
        timed_identify(port, 5)


def test_silent_peer_raises_timeout(serve: Callable[[Behaviour], int]) -> None:
    with pytest.raises(LinkTimeout, match=r"accepted the connection, but sent nothing within 0\.3 s"):
        timed_identify(serve(says()), 0.3)


def test_peer_that_closes_at_once_raises_connection_lost(serve: Callable[[Behaviour], int]) -> None:
    with pytest.raises(ConnectionLost, match="closed the connection"):
        timed_identify(serve(says(then_close=True)), 5)


def test_peer_that_closes_within_message_raises_connection_lost(serve: Callable[[Behaviour], int]) -> None:
    with pytest.raises(ConnectionLost, match="closed the connection"):
        timed_identify(serve(says(VERSION[:20], then_close=True)), 5)


BANNERS = [
    b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n",
    b"SSH-2.0-OpenSSH_9.6p1 Debian-3\r\n",
    b"220 mail.example.org ESMTP\r\n",
    b"\xff\xfb\x01\xff\xfb\x03login: ",
]


@pytest.mark.parametrize("banner", BANNERS, ids=["http", "ssh", "smtp", "telnet"])
@pytest.mark.parametrize("then_close", [False, True])
def test_other_protocol_raises_wrong_peer(serve: Callable[[Behaviour], int], banner: bytes, then_close: bool) -> None:
    with pytest.raises(WrongPeer, match="does not send packets of a UR controller; its first bytes are") as caught:
        timed_identify(serve(says(banner, then_close=then_close)), 0.4)
    assert repr(banner[:8])[2:-1] in str(caught.value), "the first bytes must be shown as printable text"
    assert str(caught.value).isprintable()


def test_endless_invalid_data_raise_wrong_peer(serve: Callable[[Behaviour], int]) -> None:
    def flood(connection: socket.socket, over: threading.Event) -> None:
        while not over.is_set():
            connection.sendall(b"\xaa" * 65536)

    with pytest.raises(WrongPeer, match="without a valid packet"):
        timed_identify(serve(flood), 10)


def test_realtime_port_raises_wrong_peer() -> None:
    with Controller("UR5e", "5.11") as controller, pytest.raises(WrongPeer, match="the real-time interface") as caught:
        timed_identify(controller.ports["realtime"], 5)
    assert "30003" in str(caught.value)


def test_dashboard_port_raises_wrong_peer(serve: Callable[[Behaviour], int]) -> None:
    with pytest.raises(WrongPeer, match="dashboard server"):
        timed_identify(serve(says(b"Connected: Universal Robots Dashboard Server\n")), 5)


def test_too_slow_greeting_raises_timeout(serve: Callable[[Behaviour], int]) -> None:
    def trickle(connection: socket.socket, over: threading.Event) -> None:
        for byte in VERSION:
            connection.sendall(bytes([byte]))
            if over.wait(0.05):
                return

    with pytest.raises(LinkTimeout, match=r"did not identify itself within 0\.4 s; its first bytes are"):
        timed_identify(serve(trickle), 0.4)


def test_messages_without_identity_raise_timeout(serve: Callable[[Behaviour], int]) -> None:
    text = package(20, struct.pack(">QBB", 0, 253, 0) + b"hello")
    with pytest.raises(LinkTimeout, match="did not identify itself"):
        timed_identify(serve(says(text, text)), 0.3)


# -- connect() ----------------------------------------------------------------------------------------


def test_connect_raises_the_same_errors(serve: Callable[[Behaviour], int]) -> None:
    began = time.monotonic()
    with pytest.raises(LinkTimeout):
        urlink.connect(f"ur://127.0.0.1?primary={serve(says())}", timeout=0.3)
    with pytest.raises(WrongPeer):
        urlink.connect(f"ur://127.0.0.1?primary={serve(says(BANNERS[0]))}", timeout=0.3)
    assert time.monotonic() - began < 0.6 + MARGIN


def test_connect_uses_secondary_interface_without_primary(serve: Callable[[Behaviour], int]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        nobody = server.getsockname()[1]
    secondary = serve(says(VERSION, FIRST_STATE))
    with urlink.connect(f"ur://127.0.0.1?primary={nobody}&secondary={secondary}") as robot:
        assert (str(robot.firmware), robot.model) == ("5.11", "UR5e")


def test_identify_leaves_no_threads() -> None:
    with Controller("UR5e", "5.11") as controller:
        before = threading.active_count()
        timed_identify(controller.ports["primary"], 5)
        assert threading.active_count() == before


# -- kinematics ---------------------------------------------------------------------------------------


def test_kinematics_of_an_unknown_arm_raise_local_error() -> None:
    for model, why in ((None, "does not report its arm model"), ("UR77", "unknown arm model UR77")):
        with pytest.raises(LocalError, match=why):
            _ = Identity(Firmware(1, 6), True, model).kinematics


def test_kinematics_with_dh_of_another_arm_raise() -> None:
    with pytest.raises(WrongPeer, match=r"UR10e sends unusable DH parameters: .* link 2"):
        _ = Identity(Firmware(5, 11), True, "UR10e", MODELS["UR5e"]).kinematics


def test_kinematics_without_dh_use_published_values() -> None:
    assert repr(Identity(Firmware(5, 11), True, "UR10e").kinematics) == "<Arm UR10e, as published>"


def test_identity_is_queried_again_if_the_stream_reconnects() -> None:
    """The stream reconnected during the query, so a different controller might have answered."""
    asked: list[str] = []

    def ask() -> Identity:
        asked.append("asked")
        if len(asked) == 2:
            known.doubt()
        return Identity(Firmware(5, 11), True, "UR5e")

    known = KnownIdentity(ask)
    known.doubt()
    for asks in (2, 3, 3):
        assert known.identity.model == "UR5e"
        assert len(asked) == asks
