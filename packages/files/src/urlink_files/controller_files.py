"""`ControllerFiles`: lists and copies the files of a controller over SFTP."""

from __future__ import annotations

import asyncio
import contextlib
import os
import posixpath
import stat
from collections.abc import AsyncIterator, Coroutine, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, TypeVar

import asyncssh

from urlink import BadValue, ConnectFailed, ConnectionLost, LinkTimeout, LocalError, RemoteError
from urlink.tools import printable

from .places import patterns_of, target_of

T = TypeVar("T")

#: Number of bytes that are read from the controller at once.
_BLOCK = 1 << 20


class AccessDenied(RemoteError, PermissionError):
    """Error: the controller rejects the user, the password or the key."""

    # OSError would print only its first argument, and would treat several arguments as an error number.
    __str__ = Exception.__str__


class UnknownHostKey(RemoteError):
    """Error: the key of the server is not known, so the server might not be the controller.

    Attributes:
        fingerprint: Fingerprint of the key, such as "SHA256:..."; compare it with the fingerprint of the controller.
    """

    def __init__(self, text: str, fingerprint: str) -> None:
        super().__init__(text)
        self.fingerprint = fingerprint


class FileRefused(RemoteError):
    """Error: the controller does not read or write a file."""


@dataclass(frozen=True)
class RemoteFile:
    """File or folder of a controller.

    Attributes:
        path: Path on the controller.
        size: Size in bytes.
        modified: Time of the last change, by the clock of the controller.
        is_folder: Whether it is a folder.
    """

    path: str
    size: int
    modified: datetime
    is_folder: bool


class ControllerFiles:
    """Files of a controller; made by `connect`. Each method raises `LinkTimeout` after the timeout of `connect`.

    Args:
        sftp: Connected SFTP client.
        host: Name of the controller, for messages.
        timeout: Maximum time for one call, in seconds.
    """

    def __init__(self, sftp: asyncssh.SFTPClient, host: str, timeout: float) -> None:
        self._sftp = sftp
        self._host = host
        self._timeout = timeout

    async def ls(self, name: str = "programs") -> list[RemoteFile]:
        """Return the files of a place, of a pattern such as ``programs/*.urp``, or of a folder, sorted by path.

        Raises:
            BadValue: If the name is invalid. Nothing is sent.
            FileRefused: If nothing has this name, or if the controller refuses access.
        """
        return await self._within(name, self._ls(name, patterns_of(name)))

    async def get(
        self, name: str | Sequence[str], folder: str | os.PathLike[str] = ".", *, replace: bool = False
    ) -> list[Path]:
        """Copy files of the controller into a folder of this computer, and return the copies.

        A copy gets the name of its file only after it is complete. Folders on the controller are skipped.

        Args:
            name: One or several places, patterns or paths.
            folder: Folder on this computer, which is created if it does not exist.
            replace: Whether to replace existing files.

        Raises:
            BadValue: If a name is invalid, or if a file exists and `replace` is False. Nothing is copied.
            FileRefused: If nothing has one of the names, or if the controller refuses access.
            LocalError: If a file cannot be written on this computer.
        """
        names = [name] if isinstance(name, str) else list(name)
        patterns = {each: patterns_of(each) for each in names}
        return await self._within(", ".join(names), self._get_all(patterns, Path(folder), replace))

    async def put(self, path: str | os.PathLike[str], folder: str = "programs", *, replace: bool = False) -> RemoteFile:
        """Copy a file of this computer to the controller, and return the new file.

        The file gets its name only after it is complete. A program that is loaded at the moment does not change.

        Args:
            path: File on this computer.
            folder: ``programs``, or an existing folder below it, such as ``programs/cell``.
            replace: Whether to replace an existing file.

        Raises:
            BadValue: If the file cannot be read, the folder is not in ``programs``, or a file exists and `replace` is
                False. Nothing is changed.
            FileRefused: If the controller refuses the file.
        """
        source = Path(path)
        target = target_of(folder, source.name)
        try:
            content = source.read_bytes()
        except OSError as error:
            raise BadValue(f"cannot read {source}: {error.strerror or error}") from error
        return await self._within(target, self._put(content, target, replace))

    async def _ls(self, name: str, patterns: Sequence[str]) -> list[RemoteFile]:
        found = await self._found(patterns, name)
        if len(found) == 1 and found[0].is_folder and found[0].path == patterns[0]:
            return await self._found([posixpath.join(found[0].path, "*")], name, may_be_empty=True)
        return found

    async def _get_all(self, patterns: Mapping[str, Sequence[str]], folder: Path, replace: bool) -> list[Path]:
        found = {file.path: file for name, rows in patterns.items() for file in await self._found(rows, name)}
        copies: dict[Path, str] = {}
        for file in found.values():
            copy = folder / posixpath.basename(file.path)
            if file.is_folder:
                continue
            if copy in copies:
                raise BadValue(f"{file.path} and {copies[copy]} have the same name; copy them into two folders")
            if copy.exists() and not replace:
                raise BadValue(f"{copy} exists; pass replace=True to replace it")
            copies[copy] = file.path
        if not copies:
            raise FileRefused(f"{self._host}: {', '.join(patterns)} contains only folders")
        with _local(folder):
            folder.mkdir(parents=True, exist_ok=True)
        for copy, path in copies.items():
            await self._get(path, copy)
        return list(copies)

    async def _put(self, content: bytes, target: str, replace: bool) -> RemoteFile:
        if not replace and await self._sftp.exists(target):
            raise BadValue(f"{self._host} already has {target}; pass replace=True to replace it")
        folder, name = posixpath.split(target)
        beside = posixpath.join(folder, f".{name}.urlink")
        try:
            async with self._sftp.open(beside, "wb") as file:
                await file.write(content)
            await self._sftp.posix_rename(beside, target)
        except BaseException:
            with contextlib.suppress(asyncssh.Error, OSError):
                await self._sftp.remove(beside)
            raise
        return _described(target, await self._sftp.stat(target))

    async def _get(self, path: str, copy: Path) -> None:
        beside = copy.with_name(f".{copy.name}.{os.getpid()}")
        try:
            async with self._sftp.open(path, "rb") as file:
                with _local(copy), beside.open("wb") as written:
                    while block := await file.read(_BLOCK):
                        written.write(block)
            with _local(copy):
                beside.replace(copy)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise

    async def _found(self, patterns: Sequence[str], name: str, *, may_be_empty: bool = False) -> list[RemoteFile]:
        """Return the files of patterns, sorted by path, or raise `FileRefused`."""
        found: dict[str, RemoteFile] = {}
        for pattern in patterns:
            with contextlib.suppress(asyncssh.SFTPNoSuchFile, asyncssh.SFTPNoSuchPath):
                for each in await self._sftp.glob_sftpname(pattern):
                    path = str(each.filename)
                    found[path] = _described(path, await self._sftp.stat(path))
        if not found and not may_be_empty:
            raise FileRefused(f"{self._host} has no file {name}")
        return [found[path] for path in sorted(found)]

    async def _within(self, what: str, call: Coroutine[Any, Any, T]) -> T:
        """Await a call until the timeout, and convert the errors of SFTP."""
        try:
            return await asyncio.wait_for(call, self._timeout)
        except (asyncio.TimeoutError, TimeoutError):
            raise LinkTimeout(f"{self._host}: {what} was not complete after {self._timeout:g} s") from None
        except asyncssh.SFTPConnectionLost as error:
            raise ConnectionLost(f"{self._host}: the connection was lost: {printable(str(error))}") from error
        except asyncssh.SFTPError as error:
            raise FileRefused(f"{self._host}: {what}: {printable(str(error))}") from error
        except asyncssh.Error as error:
            raise ConnectionLost(f"{self._host}: the connection was lost: {printable(str(error))}") from error


@contextlib.asynccontextmanager
async def connect(
    host: str,
    *,
    port: int = 22,
    user: str = "root",
    password: str | None = None,
    key: str | os.PathLike[str] | None = None,
    host_key: str | None = None,
    timeout: float = 60.0,
) -> AsyncIterator[ControllerFiles]:
    """Connect to the SSH server of a controller: ``async with urlink_files.connect(host) as files:``.

    Args:
        host: Name or address of the controller.
        port: Port of the SSH server.
        user: User on the controller.
        password: Password of the user. On an e-Series, the password of root is the admin password of PolyScope.
        key: File with a private key. If None, the keys of this user and its SSH agent are tried.
        host_key: Fingerprint of the key of the controller, such as "SHA256:...". If None, the key must be in the file
            ~/.ssh/known_hosts.
        timeout: Maximum time to connect, and for each later call, in seconds.

    Raises:
        BadValue: If an argument is invalid, or the key file cannot be read.
        UnknownHostKey: If the key of the server is not known, or differs from `host_key`.
        AccessDenied: If the controller rejects the user, the password or the key.
        ConnectFailed, LinkTimeout: If no SSH server answers.
    """
    if host_key is not None and not (isinstance(host_key, str) and host_key.startswith("SHA256:")):
        raise BadValue(f"host_key={host_key!r}; expected a fingerprint such as 'SHA256:...'")
    # An empty tuple stands for the default: the keys of this user, and the file known_hosts.
    keys: list[asyncssh.SSHKey] | tuple[()] = () if key is None else [_private_key(key)]
    # No trusted keys, certificates or revoked keys: only `Client` decides. An empty value would stand for known_hosts.
    trusted: tuple[()] | tuple[list[str], list[str], list[str]] = () if host_key is None else ([], [], [])
    seen: list[str] = []

    class Client(asyncssh.SSHClient):
        def validate_host_public_key(self, host: str, addr: str, port: int, key: asyncssh.SSHKey) -> bool:
            seen.append(key.get_fingerprint())
            return host_key is not None and seen[-1] == host_key

    try:
        async with contextlib.AsyncExitStack() as opened:
            # No configuration file: it could switch off the check of the host key.
            connecting = asyncssh.connect(
                host,
                port,
                username=user,
                password=password,
                client_keys=keys,
                known_hosts=trusted,
                config=None,
                client_factory=Client,
            )
            connection = await asyncio.wait_for(connecting, timeout)
            opened.callback(connection.abort)
            sftp = await asyncio.wait_for(connection.start_sftp_client(), timeout)
            opened.pop_all()
    except (asyncio.TimeoutError, TimeoutError):
        raise LinkTimeout(f"{host}:{port} did not accept the SSH connection within {timeout:g} s") from None
    except asyncssh.HostKeyNotVerifiable as error:
        fingerprint = seen[-1] if seen else ""
        expected = f"expected {host_key}" if host_key else "it is not in ~/.ssh/known_hosts"
        raise UnknownHostKey(
            f"{host}:{port} has the host key {fingerprint or 'of an unknown type'}, but {expected}; compare it with "
            "the key of the controller, and pass it as the host key",
            fingerprint,
        ) from error
    except asyncssh.PermissionDenied as error:
        raise AccessDenied(f"{host}:{port} denies access to {user!r}: {printable(str(error))}") from error
    except (OSError, asyncssh.Error) as error:
        raise ConnectFailed(f"cannot connect to {host}:{port}: {printable(str(error))}") from error
    try:
        yield ControllerFiles(sftp, host, timeout)
    finally:
        sftp.exit()
        connection.abort()
        with contextlib.suppress(asyncio.TimeoutError, TimeoutError):
            await asyncio.wait_for(connection.wait_closed(), timeout)


def _private_key(path: str | os.PathLike[str]) -> asyncssh.SSHKey:
    try:
        return asyncssh.read_private_key(os.fspath(path))
    except (OSError, asyncssh.KeyImportError, asyncssh.KeyEncryptionError) as error:
        raise BadValue(f"cannot read the key {os.fspath(path)}: {printable(str(error))}") from error


def _described(path: str, attributes: asyncssh.SFTPAttrs) -> RemoteFile:
    return RemoteFile(
        path,
        attributes.size or 0,
        datetime.fromtimestamp(attributes.mtime or 0, timezone.utc),
        stat.S_ISDIR(attributes.permissions or 0),
    )


@contextlib.contextmanager
def _local(path: Path) -> Iterator[None]:
    """Convert an error of the file system of this computer."""
    try:
        yield
    except OSError as error:
        raise LocalError(f"cannot write {path}: {error.strerror or error}") from error
