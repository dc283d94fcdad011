"""Bundle: the result of a run in one file, from which other people can compute the verdicts again.

A bundle is a ZIP archive of the logbook, the requirements with the limits of this run, and a manifest with the SHA-256
of these two files. The SHA-256 of the manifest is the digest of the bundle. Serial numbers, names of programs and
network addresses identify the owner of the robot. Known occurrences of these texts are overwritten, with one x for each
byte. The calibration of the arm is kept, because positions cannot be judged without it.
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
#: Maximum size of each unpacked part, in bytes. The logbook of a run of five minutes takes about 300 MB.
_LARGEST = {_MANIFEST: 1 << 16, _REQUIREMENTS: 1 << 20, _BYTES: 1 << 30}
#: Size of the chunks that are unpacked, in bytes.
_CHUNK = 1 << 16
#: Constant time stamp in archives, so that the same run results in the same bytes.
_EPOCH = (1980, 1, 1, 0, 0, 0)
#: Pattern of a serial number: the year, and the number within the year.
_SERIAL = re.compile(rb"(?<!\d)20\d{9}(?!\d)")
#: Dashboard commands with the name of a program in the reply, title of key messages with such a name, and name of a new
#: program.
_NAMING = ("get loaded program", "isProgramSaved", "programState")
_PROGRAM = "PROGRAM_XXX"
_UNNAMED = "<unnamed>"
#: Length in bytes below which a name is overwritten only at known places, because other bytes might be equal to it by
#: chance.
_SHORT = 4
#: Names of the programs of the test itself, which are not secret.
_OWN = re.compile(r"^(urlink|sleeps|goes_on|in_local|broken|accept)")


class Bundle(NamedTuple):
    """Open bundle.

    Attributes:
        evidence: Evidence of the run.
        requirements: Requirements with the limits of the run.
        site: Description of the cell, from the user's requirement file.
        digest: SHA-256 of the manifest, in hexadecimal digits.
        recording: Recording with the bytes of all connections, for `urlink.load`.
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
    """Make a bundle from a logbook.

    Args:
        logbook: Path of the logbook of the run.
        to: Path of the bundle. An existing file is replaced.
        requirements: Requirements with the limits of the run.
        site: Description of the cell.
        secrets: Texts to overwrite in addition to texts that are found in the logbook, for example addresses.

    Raises:
        BadRecording: If the logbook is damaged, or the bundle cannot be written.
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
    """Open a bundle for the duration of the block.

    Raises:
        BadRecording: If the file is not a bundle, was changed after it was made, or contains a part that is larger than
            in any run.
    """
    with tempfile.TemporaryDirectory(prefix="urlink-bundle-") as folder:
        logbook = Path(folder) / _BYTES
        try:
            with zipfile.ZipFile(path) as archive:
                # Read the manifest first, so that other files are rejected before a logbook is unpacked.
                manifest = b"".join(_unpacked(archive, _MANIFEST))
                expected = json.loads(manifest)
                if expected["format"] != _FORMAT or set(expected["files"]) != {_BYTES, _REQUIREMENTS}:
                    raise BadRecording(f"the bundle {path} has an unsupported version")
                text = b"".join(_unpacked(archive, _REQUIREMENTS))
                digest = hashlib.sha256()
                with logbook.open("wb") as file:
                    for chunk in _unpacked(archive, _BYTES):
                        digest.update(chunk)
                        file.write(chunk)
            if expected["files"] != {_BYTES: digest.hexdigest(), _REQUIREMENTS: hashlib.sha256(text).hexdigest()}:
                raise BadRecording(f"the bundle {path} was changed after it was made, or has an unsupported version")
        except (OSError, KeyError, ValueError, TypeError, RecursionError, zipfile.BadZipFile) as error:
            raise BadRecording(f"{path} is not a bundle: {error}") from None
        except (NotImplementedError, RuntimeError, zlib.error) as error:  # another compression, or a password
            raise BadRecording(f"{path} cannot be unpacked: {error}") from None
        try:
            requirements, site = read(text.decode(), str(path))
        except (UnicodeDecodeError, BadValue) as error:
            raise BadRecording(f"{path} contains no valid requirements: {error}") from None
        yield Bundle(Evidence(logbook), requirements, site, hashlib.sha256(manifest).hexdigest(), logbook)


def _unpacked(archive: zipfile.ZipFile, name: str) -> Iterator[bytes]:
    """Yield the bytes of a part in chunks, up to its maximum size, even if the archive declares another size.

    Raises:
        ValueError: If the part is larger.
        NotImplementedError: If the part is not compressed with the method of `pack`. With other methods, the size of
            the unpacked data cannot be limited.
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
    """Yield the path of the recording in a bundle (`.zip`) while the block is open. Other paths are yielded unchanged.

    Raises:
        BadRecording: See `opened`.
    """
    if path.suffix.lower() != ".zip":
        yield path
        return
    with opened(path) as bundle:
        yield bundle.recording


def _names(evidence: Evidence) -> Iterator[str]:
    """Yield the names of programs, from the places where names are known to occur."""
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
    """Copy a logbook and overwrite secrets, even if they are split between two chunks."""
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
