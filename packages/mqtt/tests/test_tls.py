"""Encrypted MQTT: mosquitto with a certificate that the test makes."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import urlink
from packages.mqtt.tests.panel import Panel
from tests.mosquitto import needs_broker, running
from tests.waiting import until
from urlink.simulator import Controller
from urlink_mqtt import Broker, Server

#: Marks of the simulated arm of these tests. The limits are long because a busy machine causes silence and delays.
pytestmark = [
    pytest.mark.urlink(
        model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
    ),
    needs_broker,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed (apt install openssl)"),
]

#: After a failed handshake, paho-mqtt leaves the socket to the garbage collector.
handshake_fails = pytest.mark.filterwarnings(
    "ignore:unclosed <ssl:ResourceWarning", "ignore:.*SSLSocket:pytest.PytestUnraisableExceptionWarning"
)

HOME = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]


class Encrypted(NamedTuple):
    """Broker at 127.0.0.1 that accepts only encrypted connections.

    Attributes:
        port: TCP port of the broker.
        ca: Certificate to check the broker's certificate.
    """

    port: int
    ca: str


def certificates(folder: Path, name: str) -> Path:
    """Make ca.pem, broker.pem and broker.key for a broker of this name or address."""
    folder.mkdir()
    key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"]
    by = ["-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial"]
    (folder / "broker.ext").write_text(f"subjectAltName={name}\nbasicConstraints=CA:FALSE\n")
    for arguments in (
        ["req", "-x509", *key, "-days", "2", "-subj", "/CN=a-ca", "-keyout", "ca.key", "-out", "ca.pem"],
        ["req", "-new", *key, "-subj", "/CN=broker", "-keyout", "broker.key", "-out", "broker.csr"],
        ["x509", "-req", "-in", "broker.csr", *by, "-days", "2", "-extfile", "broker.ext", "-out", "broker.pem"],
    ):
        subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True, timeout=60)
    return folder


@pytest.fixture
def encrypted(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Encrypted]:
    """Broker whose certificate is for 127.0.0.1, or for the name in the parameter of the test."""
    folder = certificates(tmp_path / "certificates", getattr(request, "param", "IP:127.0.0.1"))
    files = f"certfile {folder}/broker.pem\nkeyfile {folder}/broker.key\ntls_version tlsv1.2\n"
    with running(tmp_path, files) as port:
        yield Encrypted(port, str(folder / "ca.pem"))


def test_client_moves_robot_over_tls(encrypted: Encrypted, urlink_robot: urlink.Robot) -> None:
    where = Broker("127.0.0.1", encrypted.port, tls=True, ca=encrypted.ca)
    with Server(urlink_robot, "arm", where, status_rate=20.0, allow_commands=True):
        panel = Panel(encrypted.port, ca=encrypted.ca)
        assert panel.ask("move_joints", {"q": HOME})["phase"] in ("sent", "running")
        until(lambda: panel.of("motion") and panel.of("motion")[-1]["phase"] == "done")
        panel.close()
    assert urlink_robot.realtime.wait().q_actual.tolist() == pytest.approx(HOME, abs=1e-3)


def test_lost_client_ends_its_motion_over_tls(encrypted: Encrypted, urlink_robot: urlink.Robot) -> None:
    where = Broker("127.0.0.1", encrypted.port, tls=True, ca=encrypted.ca)
    with Server(urlink_robot, "arm", where, status_rate=20.0, allow_commands=True):
        panel = Panel(encrypted.port, ca=encrypted.ca)
        panel.ask("move_joints", {"q": [1.5, *HOME[1:]], "speed": 0.1})
        until(lambda: urlink_robot.realtime.wait().qd_target.any())
        panel.lose()
        until(lambda: not urlink_robot.realtime.wait().qd_target.any())
        panel.close()
    assert urlink_robot.realtime.wait().q_actual[0] < 1.0


@handshake_fails
def test_certificate_of_other_authority_is_rejected(
    encrypted: Encrypted, urlink_robot: urlink.Robot, tmp_path: Path
) -> None:
    other = certificates(tmp_path / "other", "IP:127.0.0.1") / "ca.pem"
    with pytest.raises(urlink.ConnectFailed, match="certificate verify failed"):
        Server(urlink_robot, "arm", Broker("127.0.0.1", encrypted.port, tls=True, ca=str(other)))
    # The authorities that this computer trusts do not know it either.
    with pytest.raises(urlink.ConnectFailed, match="certificate verify failed"):
        Server(urlink_robot, "arm", Broker("127.0.0.1", encrypted.port, tls=True))


@handshake_fails
@pytest.mark.parametrize("encrypted", ["DNS:another.local"], indirect=True)
def test_certificate_of_other_name_is_rejected(encrypted: Encrypted, urlink_robot: urlink.Robot) -> None:
    with pytest.raises(urlink.ConnectFailed, match=r"not valid for '127\.0\.0\.1'"):
        Server(urlink_robot, "arm", Broker("127.0.0.1", encrypted.port, tls=True, ca=encrypted.ca))


def test_unencrypted_connection_to_encrypted_broker_fails(encrypted: Encrypted, urlink_robot: urlink.Robot) -> None:
    with pytest.raises(urlink.ConnectFailed, match=f"the broker at 127.0.0.1:{encrypted.port}"):
        Server(urlink_robot, "arm", Broker("127.0.0.1", encrypted.port))


def test_error_names_file_without_certificate(urlink_robot: urlink.Robot, tmp_path: Path) -> None:
    (tmp_path / "empty.pem").write_text("")
    with socket.create_server(("127.0.0.1", 0)) as nobody, pytest.raises(urlink.BadValue, match=r"empty\.pem"):
        Server(urlink_robot, "arm", Broker("127.0.0.1", nobody.getsockname()[1], tls=True, ca=f"{tmp_path}/empty.pem"))


def test_command_line_serves_over_tls(encrypted: Encrypted, urlink_controller: Controller) -> None:
    command = [sys.executable, "-m", "urlink.cli", "serve", "mqtt", f"arm={urlink_controller.address}"]
    where = ["--broker", "127.0.0.1", "--port", str(encrypted.port), "--ca", encrypted.ca]
    process = subprocess.Popen([*command, *where])
    try:
        panel = Panel(encrypted.port, ca=encrypted.ca)
        until(lambda: panel.status.get("served"))
        process.send_signal(signal.SIGTERM)
        process.wait(60.0)
        until(lambda: panel.status.get("served") is False)
        panel.close()
    finally:
        process.kill()
        process.wait()
