"""Messages of ROS 2 by topic: their definitions, and a message for each row of a table."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .cdr import Message
from .table import Table

__all__ = ["HEADER", "TIME", "Topic", "definition", "table_topic"]

TIME = "builtin_interfaces/Time", "int32 sec\nuint32 nanosec"
HEADER = "std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id"

_NAMES = {"f8": "float64", "i8": "int64", "u8": "uint64", "i4": "int32", "u4": "uint32", "i2": "int16", "u2": "uint16"}
_NAMES |= {"f4": "float32", "i1": "int8", "u1": "uint8", "b1": "bool"}


def definition(text: str, *others: tuple[str, str]) -> str:
    """A definition followed by those of the types in it, in the format of ROS."""
    return "\n".join([text, *(f"{'=' * 80}\nMSG: {name}\n{each}" for name, each in others)])


class Topic(NamedTuple):
    """Messages of one topic.

    Attributes:
        name: of the topic.
        type: of the messages.
        definition: of that type.
        wall: the stamp of each message, (n,) datetime64[ns].
        messages: in CDR.
    """

    name: str
    type: str
    definition: str
    wall: NDArray[np.datetime64]
    messages: list[bytes]


def table_topic(name: str, table: Table, package: str) -> Topic:
    """A message for each row with all fields but text. Names are in lower case, as ROS demands.

    Args:
        name: of the topic; with a capital, of the type.
        package: that the type belongs to.
    """
    message = Message(len(table)).header(table.wall, "")
    lines = ["std_msgs/Header header"]
    for field, array in table.arrays().items():
        if array.dtype == object:
            continue
        count = "" if array.ndim == 1 else f"[{array.shape[1]}]"
        lines.append(f"{_NAMES[array.dtype.str[1:]]}{count} {re.sub('[^a-z0-9]+', '_', field.lower())}")
        message.numbers(array)
    text = definition("\n".join(lines), HEADER, TIME)
    return Topic(f"/{name}", f"{package}/msg/{name.capitalize()}", text, table.wall, message.encoded())
