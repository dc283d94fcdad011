"""Addresses of robots, simulators and recordings."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast, get_args
from urllib.parse import parse_qsl, unquote, urlsplit

from linkcore.errors import BadAddress, BadValue, BadVersion

from ..protocol.firmware import FREQUENCIES, Firmware, existing_firmware
from ..protocol.ports import PORTS

#: Whether a simulated arm rests until a program commands it, or moves slowly around its home posture.
Motion = Literal["still", "demo"]
#: Grippers that the simulator can mount instead of a Robotiq 2F-85.
Mounted = Literal["vacuum", "rg2", "rg6"]


@dataclass(frozen=True)
class RobotAddress:
    """Controller on the network: ``192.168.56.101`` or ``ur://192.168.56.101?primary=40001``.

    ``ur://127.0.0.1?frequency=125`` is a simulated controller that executes 125 cycles per second although a real
    controller with its firmware executes 500. A frequency of None is the one of the firmware.
    """

    host: str
    ports: Mapping[str, int] = field(default_factory=lambda: dict(PORTS))
    frequency: int | None = None

    def __str__(self) -> str:
        """Address in the format of `parse_address`, with the options that differ from the defaults."""
        # A server that listens on all interfaces is reached at the loopback address from this computer.
        host = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}.get(self.host, self.host)
        host = f"[{host}]" if ":" in host else host
        options = [f"{name}={port}" for name, port in self.ports.items() if PORTS.get(name) != port]
        options += [] if self.frequency is None else [f"frequency={self.frequency}"]
        return f"ur://{host}?{'&'.join(options)}" if options else host


@dataclass(frozen=True)
class SimulatorAddress:
    """Built-in simulator: ``sim://``, ``sim://ur10?firmware=3.4&motion=demo``; a motion of None means "still".

    ``sim://ur5e?like=arm.json`` simulates the arm whose identified parameters are in that file.
    ``sim://ur5e?scene=table.xml`` places the arm among the bodies of that file, with an adapter such as urlink-mujoco.
    ``sim://ur5e?gripper=vacuum`` mounts a vacuum gripper, and ``rg2`` or ``rg6`` one of OnRobot, instead of a 2F-85.
    ``sim://ur5e?frequency=125`` executes 125 cycles per second instead of 500, so that tests take less time.
    """

    model: str | None = None
    firmware: Firmware | None = None
    motion: Motion | None = None
    like: Path | None = None
    scene: Path | None = None
    gripper: Mounted | None = None
    frequency: int | None = None


@dataclass(frozen=True)
class RecordingAddress:
    """Recording: ``replay:///path/run.urlog?rate=2``; a rate of 0 plays as fast as possible."""

    path: Path
    rate: float = 1.0


Address = RobotAddress | SimulatorAddress | RecordingAddress


def parse_address(text: str | os.PathLike[str]) -> Address:
    """Parse an address. A path, or a string without a scheme that ends in ``.urlog``, is a recording.

    Raises:
        BadAddress: If the address is invalid. The message describes the error and the expected format.

    >>> parse_address("sim://ur10?motion=demo").motion
    'demo'
    >>> parse_address("ur://10.0.0.7?realtime=40003").ports["realtime"]
    40003
    """
    if isinstance(text, os.PathLike):
        return RecordingAddress(Path(text))
    if not isinstance(text, str):
        raise BadAddress(
            f"{text!r} is not an address; expected a string such as '192.168.56.101' or 'sim://', or the path of a "
            "recording"
        )
    original, text = text, text.strip()
    if "://" not in text and text.lower().endswith(".urlog"):
        return RecordingAddress(Path(text))
    if not text or any(character.isspace() or not character.isprintable() for character in text):
        hint = "; write a space in a file name as %20" if text.startswith("replay:") else ""
        raise BadAddress(
            f"{original!r} is not an address; expected a host, ur://host, sim://model or replay:///file{hint}"
        )
    try:
        parts = urlsplit(text if "://" in text else f"ur://{text}")
    except ValueError as error:  # an unbalanced bracket, or a character that host names must not contain
        raise BadAddress(f"{text!r} is not an address: {error}") from None
    if parts.fragment or text.endswith("#"):
        raise BadAddress(f"{text!r}: unexpected #{parts.fragment}; write # in a file name as %23")
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    if parts.scheme == "ur":
        return _robot(text, parts.hostname, parts.netloc, parts.path, options)
    if parts.scheme == "sim":
        return _simulator(text, parts.netloc or parts.path.strip("/"), options)
    if parts.scheme == "replay":
        return _recording(text, unquote(parts.netloc + parts.path), options)
    raise BadAddress(f"{text!r}: unknown scheme {parts.scheme!r}; expected ur, sim or replay")


def _robot(text: str, host: str | None, netloc: str, path: str, options: dict[str, str]) -> RobotAddress:
    if not host or "@" in netloc or path not in ("", "/"):
        raise BadAddress(f"{text!r}: expected a host name or address, as in ur://192.168.56.101")
    if netloc.rpartition("]")[2].count(":") and not netloc.endswith(("]", ":")):
        raise BadAddress(
            f"{text!r}: one port number is not enough, because a robot has a port for each interface; "
            f"expected ur://{host}?realtime=30003&primary=30001"
        )
    host = host.replace("%25", "%")  # URL notation of the % before the network card of a link-local address
    ports = dict(PORTS)
    frequency = _frequency(text, options.pop("frequency", None), None)
    for name, value in options.items():
        if name not in ports:
            raise BadAddress(f"{text!r}: unknown option {name!r}; expected one of {', '.join(ports)}, frequency")
        if not value.isdecimal() or len(value) > 5 or not 0 < int(value) < 65536:
            raise BadAddress(f"{text!r}: {name}={value!r} is not a port; expected 1 to 65535")
        ports[name] = int(value)
    return RobotAddress(host, ports, frequency)


def _frequency(text: str, value: str | None, firmware: Firmware | None) -> int | None:
    """Return the frequency of a simulated controller, in Hz. If the firmware is unknown, its frequency is unknown."""
    if value is None:
        return None
    if value not in map(str, FREQUENCIES):
        raise BadAddress(f"{text!r}: frequency={value!r}; expected one of {', '.join(map(str, FREQUENCIES))} Hz")
    if firmware is not None:
        try:
            firmware.at(int(value))
        except BadValue as error:
            raise BadAddress(f"{text!r}: {error}") from None
    return int(value)


def _simulator(text: str, model: str, options: dict[str, str]) -> SimulatorAddress:
    names = ("firmware", "motion", "like", "scene", "gripper", "frequency")
    firmware, motion, like, scene, gripper, frequency = (options.pop(name, None) for name in names)
    if options:
        raise BadAddress(
            f"{text!r}: unknown option {next(iter(options))!r}; "
            "expected firmware, motion, like, scene, gripper or frequency"
        )
    if like == "":
        raise BadAddress(f"{text!r}: like= names no file; expected like=arm.json, written by urlink identify")
    if scene == "":
        raise BadAddress(f"{text!r}: scene= names no file; expected scene=table.xml, with the bodies around the arm")
    if motion not in (None, "still", "demo"):
        raise BadAddress(f"{text!r}: motion={motion!r}; expected {' or '.join(get_args(Motion))}")
    if gripper not in (None, *get_args(Mounted)):
        raise BadAddress(f"{text!r}: gripper={gripper!r}; expected {' or '.join(get_args(Mounted))}")
    try:
        version = None if firmware is None else existing_firmware(firmware)
    except BadVersion as error:
        raise BadAddress(f"{text!r}: {error}") from None
    arm, bodies = (None if each is None else Path(each) for each in (like, scene))
    mounted = cast("Mounted | None", gripper)
    rate = _frequency(text, frequency, version)
    return SimulatorAddress(model or None, version, cast("Motion | None", motion), arm, bodies, mounted, rate)


def _recording(text: str, path: str, options: dict[str, str]) -> RecordingAddress:
    rate = options.pop("rate", "1")
    if options:
        raise BadAddress(f"{text!r}: unknown option {next(iter(options))!r}; expected rate")
    if not path:
        raise BadAddress(f"{text!r} names no file; expected replay:///path/run.urlog")
    try:
        speed = 0.0 if rate == "max" else float(rate)
    except ValueError:
        speed = -1.0
    if not 0 <= speed < float("inf"):
        raise BadAddress(f"{text!r}: rate={rate!r}; expected a positive number, or max")
    return RecordingAddress(Path(path), speed)
