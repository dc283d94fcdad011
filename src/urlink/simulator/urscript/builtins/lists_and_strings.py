"""Functions of lists and strings, and conversions."""

from __future__ import annotations

import re
from typing import Any

from ..errors import Fault, type_error
from ..limits import MAX_ELEMENTS, MAX_STRING
from ..machine import ScriptThread
from ..values import checked, list_of, to_str, type_name
from .declaration import Family, boolean, integer, is_list, string

__all__ = ["FAMILY"]

FAMILY = Family()

_NUMBER = re.compile(r"\s*[+-]?(?:[0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?\s*")


def made(thread: ScriptThread, text: str) -> str:
    """A new string of at most `MAX_STRING` characters."""
    if len(text) > MAX_STRING:
        raise Fault(f"String too long: {len(text)} characters")
    thread.machine.charge(len(text))
    return text


@FAMILY.declare("get_list_length", "size")
def length(thread: ScriptThread, v: Any) -> int:
    """The length of a list or string."""
    if is_list(v) or isinstance(v, (str, tuple)):
        return len(v)
    raise type_error(f"length of {type_name(v)}")


# `to_str` is the function of `values` here.
@FAMILY.declare(name="to_str")
def to_string(thread: ScriptThread, val: Any) -> str:
    return made(thread, to_str(val))


@FAMILY.declare()
def to_num(thread: ScriptThread, str_to_convert: Any) -> float | int:
    text = string(str_to_convert, "to_num: str_to_convert")
    match = _NUMBER.fullmatch(text) if len(text) < 400 else None
    if match is None:
        raise Fault(f"to_num: '{text[:40]}' is no number")
    is_float = "." in text or match.group(2) is not None
    return checked(float(text) if is_float or len(text) > 20 else int(text))


@FAMILY.declare()
def str_cat(thread: ScriptThread, op1: Any, op2: Any) -> str:
    """Two values, converted by `to_str`, in one string."""
    return made(thread, to_str(op1) + to_str(op2))


@FAMILY.declare()
def str_len(thread: ScriptThread, str: Any) -> int:
    return len(string(str, "str_len: str"))


@FAMILY.declare()
def str_empty(thread: ScriptThread, str: Any) -> bool:
    return not string(str, "str_empty: str")


@FAMILY.declare()
def str_at(thread: ScriptThread, src: Any, index: Any) -> str:
    text = string(src, "str_at: src")
    at = integer(index, "str_at: index")
    if not 0 <= at < len(text):
        raise Fault(f"str_at: index out of range: {at} of {len(text)}")
    return text[at]


@FAMILY.declare()
def str_sub(thread: ScriptThread, src: Any, index: Any, len: Any = 2**31 - 1) -> str:
    """At most `len` characters from `index` on."""
    text = string(src, "str_sub: src")
    at, count = integer(index, "str_sub: index", 0), integer(len, "str_sub: len", 0)
    if at > text.__len__():
        raise Fault(f"str_sub: index out of range: {at} of {text.__len__()}")
    return made(thread, text[at : at + count])


@FAMILY.declare()
def str_find(thread: ScriptThread, src: Any, target: Any, start_from: Any = 0) -> int:
    """The index of `target`, or -1."""
    text, wanted = string(src, "str_find: src"), string(target, "str_find: target")
    thread.machine.charge(len(text) // 16 + len(wanted) // 16)
    return text.find(wanted, integer(start_from, "str_find: start_from", 0))


@FAMILY.declare()
def integer_to_binary_list(thread: ScriptThread, x: Any) -> tuple[bool, ...]:
    """32 truth values, the lowest bit first."""
    value = integer(x, "integer_to_binary_list: x") & 0xFFFFFFFF
    return tuple([bool(value >> bit & 1) for bit in range(32)])


@FAMILY.declare()
def binary_list_to_integer(thread: ScriptThread, l: Any) -> int:  # noqa: E741
    """From up to 32 truth values, the lowest bit first; bit 31 is the sign."""
    if not is_list(l) or len(l) > 32:
        raise type_error("binary_list_to_integer takes a list of up to 32 truth values")
    value = sum(boolean(bit, "binary_list_to_integer: l") << at for at, bit in enumerate(l))
    return value - (1 << 32) if value >> 31 else value


@FAMILY.declare(since="3.15/5.10")
def make_list(thread: ScriptThread, length: Any, initial_value: Any, capacity: Any = 0) -> tuple[Any, ...]:
    """A list of `length` equal values. That `capacity` has no effect is a simplification."""
    count = integer(length, "make_list: length", 0, MAX_ELEMENTS)
    return list_of([initial_value] * count, thread.machine.charge)
