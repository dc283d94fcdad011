"""The bundle: what a run leaves, in one file that others can judge anew.

A ZIP archive of the logbook, the requirements with the limits of this run, and a manifest with the SHA-256 of both,
whose own is the digest of the bundle. What shows whose robot it is, as far as it is known where it stands, is
overwritten with as many x: serial numbers, names of programs, network addresses. The calibration of the arm is kept:
positions cannot be judged without it.
"""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from urlink import BadRecording, BadValue, RecordingWriter
from urlink.packets import KeyMessage
from urlink.tools import COMMANDS, Kind, RecordingFile, strict_json

from .evidence import Evidence
from .logbook import NOTES
from .requirements import Requirement, read, written

_BYTES, _REQUIREMENTS, _MANIFEST = "bytes.urlog", "requirements.toml", "MANIFEST.json"
_FORMAT = 1
#: Maximum size of each part once it is unpacked, in bytes. The logbook of a run of five minutes takes about 300 MB.
_LARGEST = {_MANIFEST: 1 << 16, _REQUIREMENTS: 1 << 20, _BYTES: 1 << 30}
#: Bytes that are unpacked at a time.
_CHUNK = 1 << 16
#: Of archives, so that the same run makes the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)
#: A serial number: the year, and the number in it.
_SERIAL = re.compile(rb"(?<!\d)20\d{9}(?!\d)")
#: Answers of the dashboard that name a program, and the key messages that do.
_NAMING = ("get loaded program", "isProgramSaved", "programState")
_PROGRAM = "PROGRAM_XXX"
_UNNAMED = "<unnamed>"
#: Bytes below which a name is overwritten only where it is known to stand, since others may look like it.
_SHORT = 4
#: Programs of the test itself, which are not secret.
_OWN = re.compile(r"^(urlink|sleeps|goes_on|in_local|broken|accept)")


class Bundle(NamedTuple):
    """A bundle that is open.

    Attributes:
        evidence: to be judged.
        requirements: with the limits of the run.
        site: whose cell it is, by its own requirement file.
        digest: SHA-256 of the manifest, in hexadecimal digits.
        recording: the bytes of all connections, a recording as `urlink.load` takes it.
    """

    evidence: Evidence
    requirements: Mapping[str, Requirement]
    site: Mapping[str, Any]
    digest: str
    recording: Path


def pack(
    logbook: Path,
    to: Path,
    requirements: Mapping[str, Requirement],
    site: Mapping[str, Any],
    secrets: Iterable[str] = (),
) -> None:
    """Make a bundle of a logbook.

    Args:
        logbook: of the run.
        to: the bundle; a file that is there is replaced.
        requirements: with the limits of the run.
        site: whose cell it is.
        secrets: texts to be overwritten, beside what is found: addresses.

    Raises:
        BadRecording: the logbook is damaged, or the bundle cannot be written.
    """
    hidden = sorted({*secrets, *_names(Evidence(logbook))} - {""}, key=len, reverse=True)
    with tempfile.TemporaryDirectory(prefix="urlink-bundle-") as folder:
        clean = Path(folder) / _BYTES
        _overwrite(RecordingFile(logbook), clean, hidden)
        parts = {_BYTES: clean.read_bytes(), _REQUIREMENTS: written(requirements, site).encode()}
    sums = {name: hashlib.sha256(data).hexdigest() for name, data in parts.items()}
    parts[_MANIFEST] = json.dumps({"format": _FORMAT, "files": sums}, sort_keys=True).encode()
    try:
        with zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in parts.items():
                archive.writestr(zipfile.ZipInfo(name, _EPOCH), data, zipfile.ZIP_DEFLATED)
    except OSError as error:
        raise BadRecording(f"cannot write {to}: {error.strerror or error}") from None


@contextmanager
def opened(path: Path) -> Iterator[Bundle]:
    """A bundle, for as long as the block.

    Raises:
        BadRecording: there is none at this path, it was changed since it was made, or a part of it is larger than any
            run makes it.
    """
    with tempfile.TemporaryDirectory(prefix="urlink-bundle-") as folder:
        logbook = Path(folder) / _BYTES
        try:
            with zipfile.ZipFile(path) as archive:
                # The manifest comes first: a file that is no bundle is rejected before its logbook is unpacked.
                manifest = b"".join(_unpacked(archive, _MANIFEST))
                expected = json.loads(manifest)
                if expected["format"] != _FORMAT or set(expected["files"]) != {_BYTES, _REQUIREMENTS}:
                    raise BadRecording(f"{path} is of another version")
                text = b"".join(_unpacked(archive, _REQUIREMENTS))
                digest = hashlib.sha256()
                with logbook.open("wb") as file:
                    for chunk in _unpacked(archive, _BYTES):
                        digest.update(chunk)
                        file.write(chunk)
            if expected["files"] != {_BYTES: digest.hexdigest(), _REQUIREMENTS: hashlib.sha256(text).hexdigest()}:
                raise BadRecording(f"{path} was changed since it was made, or is of another version")
        except (OSError, KeyError, ValueError, TypeError, RecursionError, zipfile.BadZipFile) as error:
            raise BadRecording(f"{path} is no bundle: {error}") from None
        except (NotImplementedError, RuntimeError, zlib.error) as error:  # another compression, or a password
            raise BadRecording(f"{path} cannot be unpacked: {error}") from None
        try:
            requirements, site = read(text.decode(), str(path))
        except (UnicodeDecodeError, BadValue) as error:
            raise BadRecording(f"{path} holds no requirements: {error}") from None
        yield Bundle(Evidence(logbook), requirements, site, hashlib.sha256(manifest).hexdigest(), logbook)


def _unpacked(archive: zipfile.ZipFile, name: str) -> Iterator[bytes]:
    """The bytes of a part, chunk by chunk; never more than its largest size, whatever the archive says of it.

    Raises:
        ValueError: it is larger.
        NotImplementedError: it is not compressed as `pack` does it; other methods can unpack without a bound.
    """
    if archive.getinfo(name).compress_type not in (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED):
        raise NotImplementedError(f"{name} is compressed by a method other than deflate")
    size = 0
    with archive.open(name) as part:
        while chunk := part.read(_CHUNK):
            size += len(chunk)
            if size > _LARGEST[name]:
                raise ValueError(f"{name} is larger than {_LARGEST[name]} bytes once it is unpacked")
            yield chunk


@contextmanager
def recording_in(path: Path) -> Iterator[Path]:
    """The recording of a bundle (`.zip`), for as long as the block; any other file is returned as it is.

    Raises:
        BadRecording: as `opened`.
    """
    if path.suffix.lower() != ".zip":
        yield path
        return
    with opened(path) as bundle:
        yield bundle.recording


def _names(evidence: Evidence) -> Iterator[str]:
    """The names of programs that stand where names do."""
    for note in evidence.said("dashboard"):
        if note.said["asked"] in _NAMING:
            match = COMMANDS[note.said["asked"]].match(note.said["reply"])
            name = None if match is None else match.groups()[-1]
            if name and name != _UNNAMED:
                yield name
                yield name.rpartition("/")[2].partition(".")[0]
    for _, packet in evidence.primary.others:
        if isinstance(packet, KeyMessage) and packet.title.startswith(_PROGRAM) and not _OWN.match(packet.text):
            yield packet.text


def _overwrite(recording: RecordingFile, to: Path, hidden: list[str]) -> None:
    """Copy a logbook; what is hidden may be in two chunks."""
    writer = RecordingWriter(to)
    numbers = {number: writer.add_channel(info) for number, info in recording.channels.items()}
    kept = [record for record in recording if record.kind in (Kind.BYTES, Kind.EVENT)]
    clean: dict[int, Iterator[bytes]] = {}
    for number, info in recording.channels.items():
        chunks = [record.payload for record in kept if record.channel == number and record.kind is Kind.BYTES]
        if info["name"] == NOTES:
            clean[number] = iter([_note(chunk, hidden) for chunk in chunks])
        else:
            clean[number] = iter(_cut(_hide(b"".join(chunks), hidden, info["name"].startswith("dashboard")), chunks))
    for record in kept:
        if record.kind is Kind.BYTES:
            payload = next(clean[record.channel])
        else:
            payload = json.dumps(_in_texts(json.loads(record.payload), hidden)).encode()
        writer.write(record.kind, numbers[record.channel], record.stamp, payload)
    writer.close()


def _cut(data: bytes, like: list[bytes]) -> Iterator[bytes]:
    at = 0
    for chunk in like:
        yield data[at : at + len(chunk)]
        at += len(chunk)


def _hide(data: bytes, hidden: list[str], is_text: bool) -> bytes:
    for text in hidden:
        secret = text.encode()
        if is_text or len(secret) >= _SHORT:
            data = data.replace(secret, b"x" * len(secret))
    return _SERIAL.sub(lambda match: b"x" * len(match[0]), data)


def _note(payload: bytes, hidden: list[str]) -> bytes:
    said = json.loads(payload)
    clean = {key: value if key == "step" else _in_texts(value, hidden) for key, value in said.items()}
    return strict_json(clean).encode()


def _in_texts(value: Any, hidden: list[str]) -> Any:
    if isinstance(value, str):
        return _hide(value.encode("utf-8", "replace"), hidden, is_text=False).decode()
    if isinstance(value, dict):
        return {key: _in_texts(each, hidden) for key, each in value.items()}
    if isinstance(value, list):
        return [_in_texts(each, hidden) for each in value]
    return value
