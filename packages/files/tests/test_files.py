"""Files of a controller, with a real OpenSSH server."""

from __future__ import annotations

import asyncio
import json
import os
import runpy
import socket
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import asyncssh
import pytest

import urlink.cli
from packages.files.tests.conftest import Server, needs_sshd
from urlink import BadValue, ConnectFailed, LinkTimeout, LocalError
from urlink_files import AccessDenied, ControllerFiles, FileRefused, UnknownHostKey, connect

pytestmark = [needs_sshd, pytest.mark.real_time]


def with_files(server: Server, work: Callable[[ControllerFiles], Coroutine[Any, Any, Any]], **options: Any) -> Any:
    """Connect to the server, and return the result of `work`."""

    async def run() -> Any:
        async with connect("127.0.0.1", **server.options | options) as files:
            return await work(files)

    return asyncio.run(run())


@pytest.fixture
def programs(server: Server) -> Path:
    """Folder of the programs, with two programs, an installation and a folder."""
    folder = server.root / "programs"
    for name in ("pick.urp", "place.urp", "default.installation"):
        (folder / name).write_bytes(name.encode() * 3)
    (folder / "cell").mkdir()
    (folder / "cell" / "inner.urp").write_bytes(b"inner")
    return folder


def names(files: Any) -> list[str]:
    return [os.path.basename(getattr(file, "path", file)) for file in files]


def test_ls_lists_places_patterns_and_folders(server: Server, programs: Path) -> None:
    found = with_files(server, lambda files: files.ls())
    assert names(found) == ["cell", "default.installation", "pick.urp", "place.urp"]
    assert [each.is_folder for each in found] == [True, False, False, False]
    assert found[2].size == 24
    assert found[2].modified.timestamp() == int((programs / "pick.urp").stat().st_mtime)
    assert names(with_files(server, lambda files: files.ls("programs/*.urp"))) == ["pick.urp", "place.urp"]
    assert names(with_files(server, lambda files: files.ls("programs/cell"))) == ["inner.urp"]
    assert names(with_files(server, lambda files: files.ls(str(programs / "cell")))) == ["inner.urp"]


def test_logs_are_only_the_logs_of_their_folder(server: Server) -> None:
    for name in ("log_history.txt", "polyscope.log", "polyscope.log.1", "secret"):
        (server.root / "root" / name).write_text(name)
    assert names(with_files(server, lambda files: files.ls("logs"))) == [
        "log_history.txt",
        "polyscope.log",
        "polyscope.log.1",
    ]


def test_empty_place_has_no_file(server: Server) -> None:
    with pytest.raises(FileRefused, match="has no file flightreports"):
        with_files(server, lambda files: files.ls("flightreports"))
    (server.root / "programs" / "empty").mkdir()
    assert with_files(server, lambda files: files.ls("programs/empty")) == []


def test_get_copies_files_completely(server: Server, programs: Path, tmp_path: Path) -> None:
    big = os.urandom(3_000_000)
    (programs / "big.urp").write_bytes(big)
    target = tmp_path / "new" / "backup"
    copies = with_files(server, lambda files: files.get(["programs/*.urp", "programs/default.installation"], target))
    assert sorted(names(copies)) == ["big.urp", "default.installation", "pick.urp", "place.urp"]
    assert (target / "big.urp").read_bytes() == big
    assert sorted(names(target.iterdir())) == sorted(names(copies))


def test_get_replaces_only_on_request(server: Server, programs: Path, tmp_path: Path) -> None:
    (tmp_path / "place.urp").write_text("mine")
    with pytest.raises(BadValue, match=r"place\.urp exists; pass replace=True"):
        with_files(server, lambda files: files.get("programs/*.urp", tmp_path))
    assert not (tmp_path / "pick.urp").exists()
    with_files(server, lambda files: files.get("programs/*.urp", tmp_path, replace=True))
    assert (tmp_path / "place.urp").read_text() == "place.urp" * 3


def test_get_refuses_two_files_with_one_name(server: Server, programs: Path, tmp_path: Path) -> None:
    (programs / "cell" / "pick.urp").write_text("other")
    with pytest.raises(BadValue, match="have the same name"):
        with_files(server, lambda files: files.get(["programs/pick.urp", "programs/cell/pick.urp"], tmp_path))


def test_get_reports_errors_of_both_computers(server: Server, programs: Path, tmp_path: Path) -> None:
    with pytest.raises(FileRefused, match=r"has no file programs/none\.urp"):
        with_files(server, lambda files: files.get("programs/none.urp", tmp_path))
    with pytest.raises(FileRefused, match="programs/cell contains only folders"):
        with_files(server, lambda files: files.get("programs/cell", tmp_path))
    (tmp_path / "file").write_text("")
    with pytest.raises(LocalError, match=r"cannot write .*file"):
        with_files(server, lambda files: files.get("programs/pick.urp", tmp_path / "file" / "folder"))


def test_put_writes_below_programs(server: Server, programs: Path, tmp_path: Path) -> None:
    source = tmp_path / "new.urp"
    source.write_bytes(b"new program")
    put = with_files(server, lambda files: files.put(source))
    assert (names([put]), put.size) == (["new.urp"], 11)
    assert (programs / "new.urp").read_bytes() == b"new program"
    with pytest.raises(BadValue, match=r"already has .*new\.urp; pass replace=True"):
        with_files(server, lambda files: files.put(source))
    source.write_bytes(b"newer")
    with_files(server, lambda files: files.put(source, replace=True))
    with_files(server, lambda files: files.put(source, "programs/cell"))
    assert (programs / "new.urp").read_bytes() == (programs / "cell" / "new.urp").read_bytes() == b"newer"
    assert not [name for name in names(programs.iterdir()) if name.startswith(".")]


def test_put_into_a_missing_folder_is_refused(server: Server, programs: Path, tmp_path: Path) -> None:
    (tmp_path / "new.urp").write_text("")
    with pytest.raises(FileRefused, match="No such file"):
        with_files(server, lambda files: files.put(tmp_path / "new.urp", "programs/none"))
    with pytest.raises(BadValue, match=r"cannot read .*none\.urp"):
        with_files(server, lambda files: files.put(tmp_path / "none.urp"))


def test_failed_put_leaves_the_old_file(
    server: Server, programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pick.urp").write_text("new")

    async def fail(*arguments: object) -> None:
        raise asyncssh.SFTPFailure("no space")

    monkeypatch.setattr(asyncssh.SFTPClient, "posix_rename", fail)
    with pytest.raises(FileRefused, match="no space"):
        with_files(server, lambda files: files.put(tmp_path / "pick.urp", replace=True))
    assert (programs / "pick.urp").read_text() == "pick.urp" * 3
    assert sorted(names(programs.iterdir())) == ["cell", "default.installation", "pick.urp", "place.urp"]


def test_late_call_raises_link_timeout(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    async def wait(*arguments: object) -> None:
        await asyncio.sleep(5)

    async def late(files: ControllerFiles) -> None:
        files._timeout = 0.05
        await files.ls()

    monkeypatch.setattr(asyncssh.SFTPClient, "glob_sftpname", wait)
    with pytest.raises(LinkTimeout, match=r"programs was not complete after 0\.05 s"):
        with_files(server, late)


# -- connecting ----------------------------------------------------------------------------------------


def test_unknown_host_key_is_refused_with_its_fingerprint(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(UnknownHostKey, match=r"not in ~/\.ssh/known_hosts") as caught:
        with_files(server, lambda files: files.ls(), host_key=None)
    assert caught.value.fingerprint == server.fingerprint
    with pytest.raises(UnknownHostKey, match="but expected SHA256:other"):
        with_files(server, lambda files: files.ls(), host_key="SHA256:other")


def test_known_hosts_are_accepted(
    server: Server, keys: Path, programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".ssh").mkdir()
    public = " ".join((keys / "host.pub").read_text().split()[:2])
    (tmp_path / ".ssh" / "known_hosts").write_text(f"[127.0.0.1]:{server.port} {public}\n")
    assert len(with_files(server, lambda files: files.ls(), host_key=None)) == 4
    # A given fingerprint counts more than the file.
    with pytest.raises(UnknownHostKey, match="but expected SHA256:other"):
        with_files(server, lambda files: files.ls(), host_key="SHA256:other")


def test_wrong_key_is_denied(server: Server, keys: Path) -> None:
    with pytest.raises(AccessDenied, match="denies access to"):
        with_files(server, lambda files: files.ls(), key=keys / "other")
    with pytest.raises(AccessDenied, match="denies access to"):
        with_files(server, lambda files: files.ls(), key=keys / "other", password="wrong")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"host_key": "aa:bb"}, "host_key='aa:bb'; expected a fingerprint"),
        ({"key": "none"}, "cannot read the key none"),
    ],
)
def test_connect_refuses_invalid_arguments(server: Server, options: dict[str, Any], message: str) -> None:
    with pytest.raises(BadValue, match=message):
        with_files(server, lambda files: files.ls(), **options)


def test_closed_and_silent_ports_are_reported(server: Server) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        with pytest.raises(LinkTimeout, match=r"did not accept the SSH connection within 0\.2 s"):
            with_files(server, lambda files: files.ls(), port=port, timeout=0.2)
    with pytest.raises(ConnectFailed, match="cannot connect to"):
        with_files(server, lambda files: files.ls(), port=port)


# -- the command ---------------------------------------------------------------------------------------


def command(server: Server, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    options = server.options
    where = ["--port", str(server.port), "--user", options["user"], "--key", str(server.key)]
    status = urlink.cli.main(["files", *words, *where, "--host-key", server.fingerprint])
    out, err = capsys.readouterr()
    return status, out, err


def test_command_lists_gets_and_puts(
    server: Server, programs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = command(server, capsys, "ls", "127.0.0.1")
    assert (status, err) == (0, "")
    assert out.splitlines()[0].endswith("/cell/")
    status, out, _ = command(server, capsys, "ls", "127.0.0.1", "programs/*.urp", "--json")
    assert [json.loads(line)["size"] for line in out.splitlines()] == [24, 27]
    status, out, _ = command(server, capsys, "get", "127.0.0.1", "programs/pick.urp", str(tmp_path))
    assert (status, out) == (0, f"{tmp_path / 'pick.urp'}\n")
    status, out, _ = command(server, capsys, "put", "127.0.0.1", str(tmp_path / "pick.urp"), "--into", "programs/cell")
    assert status == 0
    assert (programs / "cell" / "pick.urp").exists()
    status, _, err = command(server, capsys, "put", "127.0.0.1", str(tmp_path / "pick.urp"))
    assert status == 1
    assert "pass replace=True" in err
    for words in (["ls", "127.0.0.1", "a", "b"], ["get", "127.0.0.1", "programs"], ["put", "127.0.0.1"]):
        assert command(server, capsys, *words)[0] == 2


def test_example_backs_up_programs(
    server: Server, programs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    example = Path(__file__).parents[1] / "examples" / "back_up.py"
    where = ["--port", str(server.port), "--user", server.options["user"], "--key", str(server.key)]
    arguments = [*where, "--host-key", server.fingerprint, "--into", str(tmp_path / "backup")]
    monkeypatch.setattr(sys, "argv", [str(example), "127.0.0.1", *arguments])
    # In another process, the places would be the folders of a controller.
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(example), run_name="__main__")
    assert ended.value.code == 0
    (folder,) = (tmp_path / "backup").iterdir()
    assert sorted(names(folder.iterdir())) == ["default.installation", "pick.urp", "place.urp"]
