"""Parser of `rhdconfig.xml`, the file with the period, port and plugins of the original daemon and of a `Host`.

The elements are described in docs/protocols/rhd.md, Configuration file::

    <rhd>
      <scheduler> <period value="10000"/> <type value="itimer"/> </scheduler>      (or <sheduler>; microseconds)
      <server> <port value="24902"/> <clients number="10" allwriters="0"/> <mode value="synchronized"/>
               <address value="0.0.0.0"/> <width value="2"/> </server>      (the last two exist only in this library)
      <plugins> <turtle enable="true" lib="rhdlink.host.plugins.turtle:Turtle" critical="true" safety="1"/> </plugins>
    </rhd>

The file may come from anywhere, so it is parsed with limits. XML features that can hide or fetch data are not accepted:
document types, entities and external references.
"""

from __future__ import annotations

import importlib
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn, cast, get_args
from xml.parsers import expat

from linkcore.errors import BadValue

from ..wire.decoder import Limits
from ..wire.schema import WIDTHS
from .service import Resend

#: Maximum size of a file in bytes, and maximum number of levels and elements in it.
LARGEST = 1 << 20
DEEPEST = 32
MOST_ELEMENTS = 10_000

#: Scheduler types of the original that mean "at a fixed period".
_PERIODIC = ("usleep", "itimer", "LXRT", "RTAI")
_TYPES = (*_PERIODIC, "freerunning", "synchronized")


class BadConfiguration(BadValue):
    """Configuration that cannot be read or is not possible; the message names the file and the line."""


@dataclass(frozen=True)
class Element:
    """One element of the file, with its contents.

    Attributes:
        tag: Name of the element.
        attributes: Texts of the attributes, by name.
        children: Child elements, in order.
        text: Characters in the element, stripped, without the characters of its children.
        line: Line in the file where the element begins; 0 if the element is not from a file.
        source: Name of the file, used in messages.
    """

    tag: str
    attributes: Mapping[str, str] = field(default_factory=dict)
    children: tuple[Element, ...] = ()
    text: str = ""
    line: int = 0
    source: str = ""

    def find(self, tag: str) -> Element | None:
        """Return the first child of that name, or None."""
        return next(self.find_all(tag), None)

    def find_all(self, tag: str) -> Iterator[Element]:
        """Return the children of that name, in order."""
        return (child for child in self.children if child.tag == tag)

    def get(self, name: str, default: str | None = None) -> str | None:
        """Return a setting: the attribute `name`, or the attribute `value` of the child called `name`.

        The plugins of the original use both styles.
        """
        if name in self.attributes:
            return self.attributes[name]
        child = self.find(name)
        return default if child is None else child.attributes.get("value", default)

    def number(self, name: str, default: float, *, least: float = -math.inf, most: float = math.inf) -> float:
        """Return a setting as a finite number between `least` and `most`; see `get`.

        Raises:
            BadConfiguration: If it is not such a number.
        """
        text = self.get(name)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and least <= value <= most):
            self.reject(f"{name}={text!r} is not a number{_between(least, most)}")
        return value

    def integer(self, name: str, default: int, *, least: int = -(2**31), most: int = 2**31 - 1) -> int:
        """Return a setting as a whole number between `least` and `most`; see `get`.

        Raises:
            BadConfiguration: If it is not such a number.
        """
        text = self.get(name)
        if text is None:
            return default
        # int() alone would also accept underscores, and digits of every writing system.
        if not re.fullmatch(r"\s*[+-]?[0-9]{1,10}\s*", text) or not least <= int(text) <= most:
            self.reject(f"{name}={text!r} is not a whole number{_between(least, most)}")
        return int(text)

    def reject(self, reason: str) -> NoReturn:
        """Raise the error that this element is invalid.

        Raises:
            BadConfiguration: Always.
        """
        raise self._mistake(reason)

    def _mistake(self, reason: str) -> BadConfiguration:
        return BadConfiguration(f"{_place(self.source, self.line)}<{self.tag}>: {reason}")


def _between(least: float, most: float) -> str:
    bounds = (("from", least), ("to", most))
    return "".join(f" {word} {bound:.10g}" for word, bound in bounds if math.isfinite(bound))


def _place(source: str, line: int) -> str:
    if not source:
        return ""
    return f"{source}:{line}: " if line else f"{source}: "


@dataclass(frozen=True)
class PluginEntry:
    """One plugin of the file.

    Attributes:
        name: Name of the element.
        lib: Class to load, ``package.module:Class``.
        is_enabled: Whether the plugin is enabled. Only the exact text "true" enables it, as in the original.
        is_critical: Whether the host ends when the plugin fails.
        safety: Rank among the plugins that run last, or 0.
        config: Element of the plugin, with the settings of the plugin.
    """

    name: str
    lib: str
    is_enabled: bool
    is_critical: bool
    safety: int
    config: Element

    def load(self) -> Any:
        """Return an instance of the class in `lib`, created without arguments.

        This imports and runs code that the file names. The original loads a library in the same way.

        Raises:
            BadConfiguration: If `lib` is a C library, if the module or class does not exist, or if the plugin cannot be
                created.
        """
        lib = self.lib
        if re.search(r"\.so(\.[0-9.]*)?$|\.dll$|\.dylib$", lib) or "/" in lib:
            self.config.reject(
                f"lib={lib!r} is a plugin in C, which this host cannot load; run it in the original rhd, or port it "
                'to Python and write lib="package.module:Class" (see docs/rhd.md, writing a plugin)'
            )
        module_name, colon, class_name = lib.partition(":")
        if not colon or not class_name.isidentifier() or not all(map(str.isidentifier, module_name.split("."))):
            self.config.reject(f'lib={lib!r} is not the name of a plugin; expected lib="package.module:Class"')
        try:
            module = importlib.import_module(module_name)
        except Exception as error:
            # Any exception of an imported module is reported as an error of the plugin, with its line in the file.
            raise self.config._mistake(f"cannot import {module_name}: {error}") from error
        made: Callable[[], object] | None = getattr(module, class_name, None)
        if not isinstance(made, type):
            self.config.reject(f"{module_name} has no class {class_name}")
        try:
            return made()
        except Exception as error:
            raise self.config._mistake(f"cannot create a {class_name}: {error}") from error


@dataclass(frozen=True)
class Configuration:
    """Contents of an `rhdconfig.xml`. Omitted settings have the default given here, not the original's zero.

    Attributes:
        period: Period of the tick, in seconds.
        scheduler: Type of the scheduler, as the file names it.
        realtime_priority: Whether the file requests real-time priority. This host does not use it, and logs a warning.
        port: TCP port.
        address: Address to listen on; ``<server> <address value="0.0.0.0"/>``. The original has no such element and
            listens on all addresses.
        clients: Maximum number of connected clients.
        allwriters: Whether every client may write.
        synchronized: Whether each tick waits for the request of the master, for at most one period.
        width: Number of words of a time stamp, 2 or 4, which must be the same as in the clients; ``<server> <width
            value="4"/>``. The original has no such element: its width depends on the machine for which it was built.
        resend: Variables that are sent to a client, "changed" or "original"; ``<server> <resend value="original"/>``.
        limits: Limits of requests; ``<server> <limits variables="100" length="64" words="1000" batch="4096"/>``.
        client_timeout, inactivity_timeout: Timeouts in seconds, see `Host`; ``<clients timeout="5" inactivity="10"/>``.
        plugins: Plugins in the order of the file, including plugins that are not enabled.
    """

    period: float = 0.01
    scheduler: str = "usleep"
    realtime_priority: bool = False
    port: int = 24902
    address: str = "127.0.0.1"
    clients: int = 10
    allwriters: bool = False
    synchronized: bool = False
    width: int = 2
    resend: Resend = "changed"
    limits: Limits = field(default_factory=Limits)
    client_timeout: float = 5.0
    inactivity_timeout: float = 10.0
    plugins: tuple[PluginEntry, ...] = ()

    @property
    def pacing(self) -> str:
        """Time of the next tick: after the "period", immediately ("free"), or with each request ("lockstep")."""
        if self.scheduler in _PERIODIC:
            return "period"
        return "lockstep" if self.scheduler == "synchronized" and self.synchronized else "free"


def read_config(path: str | os.PathLike[str]) -> Configuration:
    """Read the configuration in a file.

    Raises:
        BadConfiguration: If the file cannot be read, or is not an `rhdconfig.xml`.
    """
    if not isinstance(path, (str, os.PathLike)):  # open() would interpret a number as a descriptor
        raise BadConfiguration(f"cannot read {path!r}: expected the path of an rhdconfig.xml")
    return parse_config(read_file(path), Path(path).name)


def read_file(path: str | os.PathLike[str]) -> bytes:
    """Return the bytes of a file. If the file is too large, return only enough bytes to detect this.

    Raises:
        BadConfiguration: If the file cannot be read.
    """
    try:
        with open(path, "rb") as file:
            return file.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise BadConfiguration(f"cannot read {os.fspath(path)}: {getattr(error, 'strerror', None) or error}") from error


def parse_config(data: bytes | str, source: str = "rhdconfig.xml") -> Configuration:
    """Parse the configuration in a text.

    Args:
        data: XML text.
        source: Name used in messages.

    Raises:
        BadConfiguration: If it is not such XML, or exceeds a limit.
    """
    root = parse_xml(data, source)
    if root.tag != "rhd":
        root.reject("the root element must be <rhd>")
    nothing = Element("rhd")
    scheduler = root.find("scheduler") or root.find("sheduler") or nothing
    server = root.find("server") or nothing
    default = Configuration()
    # 2**31 us is 36 minutes; the original uses an int.
    period = scheduler.find("period") or nothing
    kind = scheduler.get("type", default.scheduler)
    if kind not in _TYPES:
        (scheduler.find("type") or scheduler).reject(f"value={kind!r}; expected one of {', '.join(_TYPES)}")
    clients = server.find("clients") or nothing
    mode = server.get("mode")
    if mode not in (None, "normal", "synchronized"):
        server.reject(f"mode {mode!r} is invalid; expected normal or synchronized")
    width = server.find("width") or nothing
    words = width.integer("value", default.width)
    if words not in WIDTHS:
        width.reject("a time stamp must have 2 or 4 words")
    resend = server.get("resend", default.resend)
    if resend not in get_args(Resend):
        (server.find("resend") or server).reject(f"value={resend!r}; expected one of {', '.join(get_args(Resend))}")
    plugins = root.find("plugins") or nothing
    priority = scheduler.find("realtimepriority")
    return Configuration(
        period=period.integer("value", 10000, least=100) / 1e6,
        scheduler=kind,
        realtime_priority=priority is not None and priority.attributes.get("enable") == "true",
        port=(server.find("port") or nothing).integer("value", default.port, least=0, most=65535),
        address=(server.find("address") or nothing).attributes.get("value", default.address),
        clients=clients.integer("number", default.clients, least=1, most=10_000),
        allwriters=clients.integer("allwriters", 0) != 0,
        synchronized=mode == "synchronized",
        width=words,
        resend=cast("Resend", resend),
        limits=_limits(server.find("limits") or nothing),
        client_timeout=clients.number("timeout", default.client_timeout, least=0.001, most=3600.0),
        inactivity_timeout=clients.number("inactivity", default.inactivity_timeout, least=0.0, most=1e9),
        plugins=tuple(map(_entry, plugins.children)),
    )


def parse_xml(data: bytes | str, source: str) -> Element:
    """Parse the outermost element of a text.

    Args:
        data: XML text.
        source: Name used in messages.

    Raises:
        BadConfiguration: If it is not such XML, or exceeds a limit.
    """
    return _Tree(source).parse(data.encode("utf-8", "surrogatepass") if isinstance(data, str) else data)


def _limits(element: Element) -> Limits:
    default = Limits()
    names = [each.name for each in fields(Limits)]
    return Limits(**{name: element.integer(name, getattr(default, name), least=1) for name in names})


def _entry(element: Element) -> PluginEntry:
    is_enabled = element.attributes.get("enable") == "true"
    lib = element.attributes.get("lib", "")
    if is_enabled and not lib:
        element.reject('it is enabled, but has no lib; add lib="package.module:Class"')
    return PluginEntry(
        name=element.tag,
        lib=lib,
        is_enabled=is_enabled,
        is_critical=element.attributes.get("critical") == "true",
        # Read only the attribute, because a plugin may have its own child element with this name.
        safety=replace(element, children=()).integer("safety", 0, least=0, most=127),
        config=element,
    )


class _Open:
    """Element whose end has not been parsed yet."""

    def __init__(self, attributes: dict[str, str], line: int) -> None:
        self.attributes = attributes
        self.line = line
        self.children: list[Element] = []
        self.text: list[str] = []


class _Tree:
    """Builder of the elements of one file, which stops at the first invalid part."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._root: Element
        self._open: list[_Open] = []
        self._elements = 0
        self._parser = parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._data
        # Entities are declared in the document type, so rejecting it prevents entity bombs and external references.
        parser.StartDoctypeDeclHandler = self._refuse

    def parse(self, data: bytes) -> Element:
        if len(data) > LARGEST:
            raise BadConfiguration(f"{self._source} is too large; the maximum is {LARGEST} bytes")
        try:
            self._parser.Parse(data, True)
        except expat.ExpatError as error:
            text = expat.errors.messages.get(error.code, str(error))
            raise BadConfiguration(f"{_place(self._source, error.lineno)}invalid XML: {text}") from None
        except (LookupError, ValueError) as error:
            if isinstance(error, BadConfiguration):
                raise
            self._fail(f"unknown encoding: {error}")
        return self._root

    def _fail(self, reason: str) -> NoReturn:
        raise BadConfiguration(f"{_place(self._source, self._parser.CurrentLineNumber)}{reason}")

    def _refuse(self, *_: object) -> NoReturn:
        self._fail("a document type is not accepted")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._elements += 1
        if self._elements > MOST_ELEMENTS:
            self._fail(f"more than {MOST_ELEMENTS} elements")
        if len(self._open) >= DEEPEST:
            self._fail(f"elements are nested in more than {DEEPEST} levels")
        self._open.append(_Open(attributes, self._parser.CurrentLineNumber))

    def _end(self, tag: str) -> None:
        done = self._open.pop()
        element = Element(
            tag,
            MappingProxyType(done.attributes),
            tuple(done.children),
            "".join(done.text).strip(),
            done.line,
            self._source,
        )
        if self._open:
            self._open[-1].children.append(element)
        else:
            self._root = element

    def _data(self, text: str) -> None:
        self._open[-1].text.append(text)
