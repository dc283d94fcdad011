"""A real OpenSSH server on this computer, whose folders stand for those of a controller."""

from __future__ import annotations

import getpass
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.waiting import until
from urlink_files.places import PLACES

SSHD = shutil.which("sshd") or shutil.which("sshd", path="/usr/sbin:/usr/local/sbin")
needs_sshd = pytest.mark.skipif(SSHD is None, reason="sshd is not installed (apt install openssh-server)")


class Server(NamedTuple):
    """OpenSSH server at 127.0.0.1.

    Attributes:
        port: Port of the server.
        key: Private key of the user.
        fingerprint: Fingerprint of the server's key.
        root: Folder that contains the folders of the controller.
    """

    port: int
    key: Path
    fingerprint: str
    root: Path

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of `connect` for this server."""
        user = getpass.getuser()
        return {"port": self.port, "user": user, "key": self.key, "host_key": self.fingerprint, "timeout": 30.0}


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a key of the server, a key of the user, and a key that the server does not know."""
    folder = tmp_path_factory.mktemp("keys")
    for name in ("host", "user", "other"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(folder / name)], check=True)
    return folder


@pytest.fixture
def server(keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    """Run an OpenSSH server, and place the folders of the controller below a temporary folder."""
    assert SSHD is not None
    root = tmp_path / "controller"
    for name, place in PLACES.items():
        folder = root / place.folder.strip("/")
        folder.mkdir(parents=True, exist_ok=True)
        monkeypatch.setitem(PLACES, name, place._replace(folder=str(folder)))
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    config = tmp_path / "sshd_config"
    config.write_text(
        f"Port {port}\nListenAddress 127.0.0.1\nHostKey {keys / 'host'}\nAuthorizedKeysFile {keys / 'user.pub'}\n"
        f"PidFile none\nStrictModes no\nUsePAM no\nPasswordAuthentication no\nSubsystem sftp internal-sftp\n"
    )
    # As root, sshd needs this folder, which only its service creates.
    if getpass.getuser() == "root":
        Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)
    log = tmp_path / "sshd.log"
    process = subprocess.Popen([SSHD, "-D", "-f", str(config), "-E", str(log)])

    def answers() -> bool:
        assert process.poll() is None, log.read_text()
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except OSError:
            return False
        return True

    shown = subprocess.run(["ssh-keygen", "-lf", str(keys / "host.pub")], capture_output=True, text=True, check=True)
    try:
        until(answers)
        yield Server(port, keys / "user", shown.stdout.split()[1], root)
    finally:
        process.kill()
        process.wait()
