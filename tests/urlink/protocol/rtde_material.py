"""Material for RTDE tests: recipes, packages of both sides, and recorded connections of real clients."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from hypothesis import strategies as st

from linkcore.wire.packet import State
from urlink.protocol.rtde.packets import (
    ControllerVersionReply,
    ControllerVersionRequest,
    DataPackage,
    InputsReply,
    InputsRequest,
    OutputsReply,
    OutputsRequest,
    PauseReply,
    PauseRequest,
    ProtocolReply,
    ProtocolRequest,
    RtdeMessage,
    StartReply,
    StartRequest,
)
from urlink.protocol.rtde.variables import OUTPUTS, TYPES

numbers = st.integers(0, 255)
payloads = st.binary(max_size=60)
lists = st.text(alphabet="abc_019, ", max_size=40)
doubles = st.floats(allow_nan=False)
words = st.text(max_size=40)


def packages(draws: dict[type[State], dict[str, Any]], version: str) -> st.SearchStrategy[State]:
    """Packages of these classes for a protocol version, with fields drawn from these strategies."""
    return st.one_of(
        [
            st.fixed_dictionaries(fields).map(lambda drawn, kind=kind: kind(version, **drawn))  # type: ignore[misc]
            for kind, fields in draws.items()
        ]
    )


def requests(protocol: int) -> st.SearchStrategy[State]:
    """Packages that a client can send with protocol version `protocol`."""
    both = packages(
        {
            RtdeMessage: {"message": words, "source": words, "level": numbers},
            DataPackage: {"recipe": numbers, "payload": payloads},
        },
        "2.0",
    )
    frequency = {"frequency": doubles} if protocol == 2 else {}
    return both | packages(
        {
            ProtocolRequest: {"wanted": st.integers(0, 65535)},
            ControllerVersionRequest: {},
            OutputsRequest: {**frequency, "names": lists},
            InputsRequest: {"names": lists},
            StartRequest: {},
            PauseRequest: {},
        },
        f"{protocol}.0",
    )


def replies(protocol: int) -> st.SearchStrategy[State]:
    """Packages that a controller can send with protocol version `protocol`."""
    number: dict[str, Any] = {"recipe": numbers} if protocol == 2 else {}
    source = {"source": words} if protocol == 2 else {}
    versions = dict.fromkeys(("major", "minor", "bugfix", "build"), st.integers(0, 2**32 - 1))
    return packages(
        {
            ProtocolReply: {"accepted": st.booleans()},
            ControllerVersionReply: versions,
            OutputsReply: {**number, "types": lists},
            InputsReply: {"recipe": numbers, "types": lists},
            StartReply: {"accepted": st.booleans()},
            PauseReply: {"accepted": st.booleans()},
            RtdeMessage: {"message": words, **source, "level": numbers},
            DataPackage: {**number, "payload": payloads},
        },
        f"{protocol}.0",
    )


#: Types of some known variables by name, in any order; about a quarter have a type that differs from the table.
recipes = st.lists(
    st.tuples(st.sampled_from(sorted(OUTPUTS)), st.sampled_from([None, None, None, *sorted(TYPES)])),
    unique_by=lambda pair: pair[0],
    max_size=60,
).map(lambda pairs: {name: type or OUTPUTS[name].type for name, type in pairs})


class Recorded(NamedTuple):
    """One recorded connection: bytes that the client sent and received, and its row of the manifest."""

    name: str
    sent: bytes
    received: bytes
    row: dict[str, str]


def recordings(folder: Path) -> Iterator[Recorded]:
    """Yield every recorded connection, in the order of the manifest."""
    with (folder / "MANIFEST.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            stem = folder / row["file"]
            yield Recorded(
                row["file"],
                stem.with_name(stem.name + ".c2s.bin").read_bytes(),
                stem.with_name(stem.name + ".s2c.bin").read_bytes(),
                row,
            )
