"""What tests of RTDE draw from: recipes, packages of both sides, and the recorded connections of real clients."""

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
    """Packages of these classes under a protocol, with such fields."""
    return st.one_of(
        [
            st.fixed_dictionaries(fields).map(lambda drawn, kind=kind: kind(version, **drawn))  # type: ignore[misc]
            for kind, fields in draws.items()
        ]
    )


def requests(protocol: int) -> st.SearchStrategy[State]:
    """What a client can send while `protocol` holds."""
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
    """What a controller can send while `protocol` holds."""
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


#: name -> type of some variables, in any order: known ones, now and then with a type that the table does not have
recipes = st.lists(
    st.tuples(st.sampled_from(sorted(OUTPUTS)), st.sampled_from([None, None, None, *sorted(TYPES)])),
    unique_by=lambda pair: pair[0],
    max_size=60,
).map(lambda pairs: {name: type or OUTPUTS[name].type for name, type in pairs})


class Recorded(NamedTuple):
    """One recorded connection."""

    name: str
    sent: bytes  # by the client
    received: bytes  # by it
    row: dict[str, str]  # of the manifest


def recordings(folder: Path) -> Iterator[Recorded]:
    """Every recorded connection, as the manifest lists them."""
    with (folder / "MANIFEST.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            stem = folder / row["file"]
            yield Recorded(
                row["file"],
                stem.with_name(stem.name + ".c2s.bin").read_bytes(),
                stem.with_name(stem.name + ".s2c.bin").read_bytes(),
                row,
            )
