"""Functions that add, read and set Modbus signals, and query their errors.

No device is connected to the Modbus signals; see `robot.signals`. The parameters of the functions are from the manual
(cited from memory). In the simulator, `is_secondary_program` has no effect. An argument out of range, or a signal that
was not added, ends the program (assumed).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from linkcore.wire.fields import Since

from ...robot.signals import KINDS, READ_AND_WRITE, ModbusSignal
from ..errors import Fault, type_error
from ..machine import ScriptThread
from .declaration import boolean, declare, integer, is_list, number, number_within, string, vector

_HAS_LISTS = Since("5.14")


def _signal(thread: ScriptThread, name: Any, what: str) -> ModbusSignal:
    wanted = string(name, f"{what}: signal_name")
    found = thread.world.modbus.signal(wanted)
    if found is None:
        raise Fault(f"{what}: there is no Modbus signal '{wanted}'")
    return found


@declare(since="3.0", until="5.14")
def modbus_add_signal(
    thread: ScriptThread,
    IP: Any,
    slave_number: Any,
    signal_address: Any,
    signal_type: Any,
    signal_name: Any,
    sequential_mode: Any = False,
) -> None:
    _add(thread, IP, slave_number, signal_address, signal_type, signal_name, sequential_mode, 1)


@declare(name="modbus_add_signal", since="5.14")
def modbus_add_signals(
    thread: ScriptThread,
    IP: Any,
    slave_number: Any,
    signal_address: Any,
    signal_type: Any,
    signal_name: Any,
    sequential_mode: Any = False,
    register_count: Any = 1,
) -> None:
    """Add a signal. If the count is above 1, its value is a list of bits or registers.

    The vendor's examples for 5.14 contain such lists. Three things are assumed: the name of the parameter, its limits
    (the limits of Modbus), and that the value is not a list if the count is 1.
    """
    _add(thread, IP, slave_number, signal_address, signal_type, signal_name, sequential_mode, register_count)


def _add(
    thread: ScriptThread,
    ip: Any,
    slave_number: Any,
    signal_address: Any,
    signal_type: Any,
    signal_name: Any,
    sequential_mode: Any,
    register_count: Any,
) -> None:
    what = "modbus_add_signal"
    boolean(sequential_mode, f"{what}: sequential_mode")
    signal = ModbusSignal(
        string(ip, f"{what}: IP"),
        integer(slave_number, f"{what}: slave_number", 0, 255),
        integer(signal_address, f"{what}: signal_address", 0, 65535),
        integer(signal_type, f"{what}: signal_type", 0, READ_AND_WRITE - 1),
    )
    count = integer(register_count, f"{what}: register_count", 1, 2000 if signal.is_digital else 125)
    if count > 1:
        signal.value = (0,) * count
    thread.world.modbus.add(string(signal_name, f"{what}: signal_name"), signal)


@declare(since="5.0")
def modbus_add_rw_signal(
    thread: ScriptThread,
    IP: Any,
    slave_number: Any,
    read_register_address: Any,
    read_register_count: Any,
    write_register_address: Any,
    write_register_count: Any,
    signal_name: Any,
    sequential_mode: Any = False,
) -> None:
    """Add a signal that reads some registers and writes other registers in one request (function code 23).

    The values of the signal are lists of numbers. The manual contains the function (17.18). Its parameters, the limits
    of the counts, and the release that introduced it are assumed.
    """
    what = "modbus_add_rw_signal"
    boolean(sequential_mode, f"{what}: sequential_mode")
    read = integer(read_register_count, f"{what}: read_register_count", 1, 125)
    integer(write_register_address, f"{what}: write_register_address", 0, 65535)
    signal = ModbusSignal(
        string(IP, f"{what}: IP"),
        integer(slave_number, f"{what}: slave_number", 0, 255),
        integer(read_register_address, f"{what}: read_register_address", 0, 65535),
        READ_AND_WRITE,
        (0,) * read,
        (0,) * integer(write_register_count, f"{what}: write_register_count", 1, 121),
    )
    thread.world.modbus.add(string(signal_name, f"{what}: signal_name"), signal)


@declare(since="3.0")
def modbus_delete_signal(thread: ScriptThread, signal_name: Any) -> bool:
    """Delete a signal; return False if there is no signal with this name."""
    return thread.world.modbus.delete(string(signal_name, "modbus_delete_signal: signal_name"))


@declare(since="3.0")
def modbus_get_signal_status(thread: ScriptThread, signal_name: Any, is_secondary_program: Any = False) -> Any:
    """Return the value of a signal: True or False for a digital signal, and a number for a register.

    If the signal has several bits or registers, return a list.
    """
    signal = _signal(thread, signal_name, "modbus_get_signal_status")
    if not signal.is_digital:
        return signal.value
    return bool(signal.value) if isinstance(signal.value, int) else tuple(map(bool, signal.value))


def _set(
    thread: ScriptThread, name: Any, value: Any, what: str, argument: str, check: Callable[[Any, str], int]
) -> None:
    """Set a digital output or a register output. If the signal has several values, set all of them.

    `check` is the function that checks a value; it is `boolean` for a digital output.
    """
    signal = _signal(thread, name, what)
    if signal.is_input or signal.is_digital is not (check is boolean):
        raise Fault(f"{what}: '{name}' is a {KINDS[signal.kind]}, which this function cannot set")
    if isinstance(signal.value, int):
        new: int | list[int] = int(check(value, f"{what}: {argument}"))
    elif is_list(value) and len(value) == len(signal.value):
        new = [int(check(item, f"{what}: {argument}")) for item in value]
    else:
        raise type_error(f"{what}: {argument} must be a list of {len(signal.value)} values")
    thread.world.modbus[str(name)] = new


def _register(value: Any, what: str) -> int:
    return integer(value, what, 0, 65535)


@declare(since="3.0")
def modbus_set_output_signal(
    thread: ScriptThread, signal_name: Any, digital_value: Any, is_secondary_program: Any = False
) -> None:
    """Set a digital output. If the signal was added with a count, `digital_value` is a list."""
    _set(thread, signal_name, digital_value, "modbus_set_output_signal", "digital_value", boolean)


@declare(since="3.0")
def modbus_set_output_register(
    thread: ScriptThread, signal_name: Any, register_value: Any, is_secondary_program: Any = False
) -> None:
    """Set a register output. If the signal has several registers, `register_value` is a list.

    If `modbus_add_rw_signal` has added the signal, the list contains all registers to write.
    """
    what = "modbus_set_output_register"
    signal = _signal(thread, signal_name, what)
    if signal.kind != READ_AND_WRITE:
        return _set(thread, signal_name, register_value, what, "register_value", _register)
    numbers = vector(register_value, f"{what}: register_value", len(signal.written))
    signal.written = tuple([_register(number, f"{what}: register_value") for number in numbers])


@declare(since="3.0")
def modbus_set_signal_update_frequency(thread: ScriptThread, signal_name: Any, update_frequency: Any) -> None:
    """Store the frequency in the signal; it has no other effect.

    In one of the vendor's examples for 5.14, a frequency of -1 reads the signal once.
    """
    what = "modbus_set_signal_update_frequency"
    frequency = number_within(update_frequency, f"{what}: update_frequency", -1, 125)
    _signal(thread, signal_name, what).frequency = frequency


@declare(since="3.0")
def modbus_set_signal_watchdog(thread: ScriptThread, signal_name: Any, is_watched: Any) -> None:
    """Store whether the signal is watched. In the simulator, the failure of a signal never stops a program.

    In one of the vendor's examples for 5.14, the argument is a time in seconds.
    """
    what = "modbus_set_signal_watchdog"
    signal = _signal(thread, signal_name, what)
    if is_watched.__class__ is not bool and thread.world.firmware in _HAS_LISTS:
        signal.watchdog = number(is_watched, f"{what}: is_watched") > 0
    else:
        signal.watchdog = boolean(is_watched, f"{what}: is_watched")


@declare(since="3.0")
def modbus_set_runstate_dependent_choice(thread: ScriptThread, signal_name: Any, runstate_choice: Any) -> None:
    """Store the choice in the signal; it has no other effect.

    In the simulator, outputs always keep their values, even if no program runs.
    """
    what = "modbus_set_runstate_dependent_choice"
    _signal(thread, signal_name, what).choice = integer(runstate_choice, f"{what}: runstate_choice", 0, 4)


@declare(since="3.0")
def modbus_get_error(thread: ScriptThread, signal_name: Any) -> int:
    return _signal(thread, signal_name, "modbus_get_error").error


@declare(since="3.0")
def modbus_get_time_since_signal_invalid(thread: ScriptThread, signal_name: Any) -> float:
    """Return the time in s since a signal became invalid; 0 if it is valid."""
    signal = _signal(thread, signal_name, "modbus_get_time_since_signal_invalid")
    return thread.world.modbus.seconds_invalid(signal)


@declare(since="3.0")
def modbus_send_custom_command(thread: ScriptThread, IP: Any, slave_number: Any, function_code: Any, data: Any) -> None:
    """Check the arguments; nothing is sent."""
    what = "modbus_send_custom_command"
    string(IP, f"{what}: IP")
    integer(slave_number, f"{what}: slave_number", 0, 255)
    integer(function_code, f"{what}: function_code", 0, 255)
    if not is_list(data):
        raise type_error(f"{what}: data must be a list of bytes")
