"""rhdconfig.xml: elements of the original are read, and other features of XML are rejected."""

from __future__ import annotations

import contextlib
import inspect
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import LocalError
from rhdlink import Host
from rhdlink.host.config import (
    BadConfiguration,
    Configuration,
    Element,
    parse_config,
    read_config,
)
from rhdlink.variables import Limits
from tests.rhdlink.raw_client import RawClient
from tests.waiting import until

#: Largest file size in bytes, deepest level and number of elements that the parser accepts.
LARGEST, DEEPEST, MOST_ELEMENTS = 1_048_576, 32, 10_000

WHOLE = """<?xml version="1.0"?>
<rhd>
  <{scheduler}> <period value="25000"/> <type value="LXRT"/> <realtimepriority enable="true"/> </{scheduler}>
  <server> <port value="8001"/> <clients number="3" allwriters="1"/> <mode value="synchronized"/>
    <address value="0.0.0.0"/> </server>
  <whatever><else>is skipped</else></whatever>
  <plugins basepath="/usr/local/smr/lib/rhdplugin/">
    <first enable="true" lib="collections:OrderedDict" critical="true" safety="2"><gain value="0.5"/></first>
    <second enable="yes" lib="libx.so.1" speed="7"/>
  </plugins>
</rhd>
"""


@pytest.mark.parametrize("scheduler", ["scheduler", "sheduler"])
def test_every_element_of_the_original_is_read(scheduler: str) -> None:
    found = parse_config(WHOLE.format(scheduler=scheduler))
    assert (found.period, found.address) == (0.025, "0.0.0.0")
    assert (found.scheduler, found.realtime_priority, found.pacing) == ("LXRT", True, "period")
    assert (found.port, found.clients, found.allwriters, found.synchronized) == (8001, 3, True, True)
    first, second = found.plugins
    assert (first.name, first.is_enabled, first.is_critical, first.safety) == ("first", True, True, 2)
    assert first.config.number("gain", 1.0) == 0.5
    # Only the exact text "true" counts as true (section 9).
    assert (second.name, second.is_enabled, second.is_critical, second.safety) == ("second", False, False, 0)
    assert second.config.integer("speed", 0) == 7


def test_missing_settings_have_the_defaults_of_the_host() -> None:
    found = parse_config("<rhd/>")
    assert found == Configuration()
    assert Host.from_config(found).period == Host().period == 0.01
    arguments = inspect.signature(Host).parameters
    for name in set(arguments) - {"plugins", "limits"}:
        assert getattr(found, name) == arguments[name].default, name
    assert (found.plugins, found.limits, found.realtime_priority) == ((), Limits(), False)


@pytest.mark.parametrize(
    ("kind", "mode", "pacing"),
    [
        ("usleep", "", "period"),
        ("itimer", '<mode value="synchronized"/>', "period"),
        ("freerunning", "", "free"),
        ("synchronized", "", "free"),
        ("synchronized", '<mode value="synchronized"/>', "lockstep"),
    ],
)
def test_scheduler_and_mode_select_the_pacing(kind: str, mode: str, pacing: str) -> None:
    text = f'<rhd><scheduler><type value="{kind}"/></scheduler><server>{mode}</server></rhd>'
    assert parse_config(text).pacing == pacing


BOMB = '<!DOCTYPE rhd [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]><rhd>&b;</rhd>'
EXTERNAL = '<!DOCTYPE rhd [<!ENTITY x SYSTEM "file:///etc/hostname">]><rhd>&x;</rhd>'


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (BOMB, "document type"),
        (EXTERNAL, "document type"),
        ('<!DOCTYPE rhd SYSTEM "http://127.0.0.1/x.dtd"><rhd/>', "document type"),
        ("<rhd>&undeclared;</rhd>", "undefined entity"),
        ("<rhd>" * (DEEPEST + 1) + "</rhd>" * (DEEPEST + 1), "levels"),
        ("<rhd>" + "<a/>" * MOST_ELEMENTS + "</rhd>", "elements"),
        ("<rhd>" + " " * LARGEST + "</rhd>", "too large"),
        ("", "invalid XML"),
        ("<rhd>", "invalid XML"),
        ("<rhd/><rhd/>", "invalid XML"),
        ("<?xml version='1.0' encoding='klingon'?><rhd/>", "encoding"),
        ("<config/>", "<rhd>"),
        ('<rhd><scheduler><type value="cron"/></scheduler></rhd>', "cron"),
        ('<rhd><scheduler><period value="1e4"/></scheduler></rhd>', "whole number"),
        ('<rhd><scheduler><period value="0"/></scheduler></rhd>', "from 100"),
        ('<rhd><server><port value="65536"/></server></rhd>', "65535"),
        ('<rhd><server><port value="１２"/></server></rhd>', "whole number"),
        ('<rhd><server><clients number="0"/></server></rhd>', "from 1"),
        ('<rhd><server><mode value="sync"/></server></rhd>', "synchronized"),
        ('<rhd><plugins><x enable="true"/></plugins></rhd>', "lib"),
        ('<rhd><plugins><x enable="true" lib="a:B" safety="-1"/></plugins></rhd>', "safety"),
    ],
)
def test_rejected_configuration_raises_the_reason(text: str, reason: str) -> None:
    with pytest.raises(BadConfiguration, match=reason) as caught:
        parse_config(text)
    # The message must give only this reason: other errors must not mention an encoding.
    assert ("encoding" in str(caught.value)) == (reason == "encoding")


def test_numbers_are_checked_at_their_bounds() -> None:
    def of(text: str) -> Element:
        return Element("x", {"value": text}, line=3, source="robot.xml")

    assert of("-2147483648").integer("value", 0) == -(2**31)
    assert of("2147483647").integer("value", 0) == 2**31 - 1
    assert [of(text).number("value", 0.0, least=-1.0, most=2.0) for text in ("-1", "2", "0.5")] == [-1.0, 2.0, 0.5]
    for text in ("-2147483649", "2147483648"):
        with pytest.raises(BadConfiguration, match=f"robot.xml:3: <x>: value='{text}' is not a whole number"):
            of(text).integer("value", 0)
    for text in ("-1.1", "2.1", "nan", "inf", "x"):
        with pytest.raises(BadConfiguration, match="is not a number from -1 to 2"):
            of(text).number("value", 0.0, least=-1.0, most=2.0)
    for bounds, said in (({"least": 1.0}, "from 1"), ({"most": -1.0}, "to -1")):
        with pytest.raises(BadConfiguration, match=f"value='0' is not a number {said}$"):
            of("0").number("value", 0.0, **bounds)
    # An element without a line in a file has no line in its message.
    with pytest.raises(BadConfiguration, match=r"^robot\.xml: <x>: no good$"):
        Element("x", source="robot.xml").reject("no good")
    for element in (Element("x"), Element("x", line=3)):
        with pytest.raises(BadConfiguration, match=r"^<x>: no good$"):
            element.reject("no good")


@pytest.mark.parametrize(
    ("text", "least", "most"),
    [
        ("<server><clients number='{}'/></server>", 1, 10_000),
        ("<server><clients timeout='{}'/></server>", 0.001, 3600.0),
        ("<server><clients inactivity='{}'/></server>", 0.0, 1e9),
        ("<server><port value='{}'/></server>", 0, 65535),
        ("<server><limits words='{}'/></server>", 1, 2**31 - 1),
        ("<scheduler><period value='{}'/></scheduler>", 100, 2**31 - 1),
        ("<plugins><x safety='{}'/></plugins>", 0, 127),
    ],
)
def test_settings_are_checked_at_their_bounds(text: str, least: float, most: float) -> None:
    text = f"<rhd>{text}</rhd>"
    step = 1 if isinstance(least, int) else 1e-4
    for within in (least, most):
        parse_config(text.format(within))
    for beyond in (least - step, most + step):
        with pytest.raises(BadConfiguration, match=rf"is not a (whole )?number from {least:.10g} to {most:.10g}$"):
            parse_config(text.format(beyond))


def test_largest_allowed_document_is_accepted() -> None:
    parse_config("<rhd>" * DEEPEST + "</rhd>" * DEEPEST)
    parse_config("<rhd>" + "<a/>" * (MOST_ELEMENTS - 1) + "</rhd>")
    parse_config("<rhd>" + " " * (LARGEST - 11) + "</rhd>")


def test_largest_allowed_file_is_accepted(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text("<rhd>" + " " * (LARGEST - 11) + "</rhd>")
    assert read_config(path) == Configuration()
    path.write_text(path.read_text() + " ")
    with pytest.raises(BadConfiguration, match=r"^robot\.xml is too large; the maximum is 1048576 bytes$"):
        read_config(path)


def test_error_names_file_and_line(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    path.write_text('<rhd>\n<server>\n<port value="x"/>\n</server></rhd>')
    with pytest.raises(BadConfiguration, match=r"robot\.xml:3: <port>"):
        read_config(path)
    with pytest.raises(BadConfiguration, match="cannot read"):
        read_config(tmp_path / "missing.xml")
    with pytest.raises(BadConfiguration, match="cannot read"):
        read_config(tmp_path)
    with pytest.raises(BadConfiguration, match="cannot read 0: expected the path"):
        read_config(0)  # type: ignore[arg-type]
    # The error names the child element if there is one, otherwise the element with the attribute.
    for text, place in (
        ("<scheduler>\n<type value='cron'/>\n</scheduler>", "2: <type>"),
        ("<scheduler type='cron'>\n</scheduler>", "1: <scheduler>"),
        ("<server>\n<resend value='never'/>\n</server>", "2: <resend>"),
        ("<server resend='never'>\n</server>", "1: <server>"),
    ):
        with pytest.raises(BadConfiguration, match=f"rhdconfig.xml:{place}: value='(cron|never)'; expected one of"):
            parse_config(f"<rhd>{text}</rhd>")


def test_client_settings_and_limits_are_read() -> None:
    text = """<rhd><server><clients number='3' timeout='0.5' inactivity='60'/><resend value='original'/>
      <limits length='16' batch='4096'/></server></rhd>"""
    found = parse_config(text)
    assert (found.clients, found.client_timeout, found.inactivity_timeout) == (3, 0.5, 60.0)
    assert (found.resend, found.limits) == ("original", Limits(length=16, batch=4096))
    default = parse_config("<rhd/>")
    assert (default.resend, default.limits, default.client_timeout) == ("changed", Limits(), 5.0)
    for wrong in ("<resend value='x'/>", "<limits words='0'/>", "<clients timeout='0'/>"):
        with pytest.raises(BadConfiguration, match=r"rhdconfig\.xml:1: <"):
            parse_config(f"<rhd><server>{wrong}</server></rhd>")


@pytest.mark.simulated_time
def test_host_applies_the_limits_of_the_file() -> None:
    """A client that sends a larger batch than the file allows loses its connection."""
    text = """<rhd><server><port value='0'/><limits batch='64'/></server>
      <plugins><smr enable='true' lib='rhdlink.host.plugins.turtle:SmrTurtle'/></plugins></rhd>"""
    with Host.from_config(parse_config(text)) as host, RawClient(host.port, b"aw") as client:
        client.greeting()
        client.sync({"speedl": 1})
        assert host.stats.bad_clients == 0
        with contextlib.suppress(OSError, EOFError):
            client.sync(dict.fromkeys(("speedl", "speedr", "resetmotorl", "resetmotorr"), 1))
        until(lambda: host.stats.bad_clients == 1)


def test_width_of_time_stamps_is_read_and_checked() -> None:
    text = "<rhd><server><width value='{}'/></server></rhd>"
    assert parse_config(text.format(4)).width == 4
    assert parse_config("<rhd/>").width == 2
    for wrong in (3, 0, -2, "wide"):
        with pytest.raises(BadConfiguration, match="<width>: "):
            parse_config(text.format(wrong))


def entry(lib: str) -> object:
    (found,) = parse_config(f'<rhd>\n<plugins>\n<x enable="true" lib="{lib}"/></plugins></rhd>').plugins
    return found.load()


def test_python_plugin_is_loaded() -> None:
    from collections import OrderedDict

    assert type(entry("collections:OrderedDict")) is OrderedDict


@pytest.mark.parametrize("lib", ["libsmrd.so.1", "libx.so", "/opt/rhd/libx", "x.dll"])
def test_c_library_is_rejected_with_an_instruction(lib: str) -> None:
    with pytest.raises(BadConfiguration, match=r"rhdconfig.xml:3: .*in C.*package.module:Class"):
        entry(lib)


@pytest.mark.parametrize(
    ("lib", "reason"),
    [
        ("collections", "is not the name of a plugin"),
        ("collections:", "is not the name of a plugin"),
        (":OrderedDict", "is not the name of a plugin"),
        ("collections:OrderedDict.fromkeys", "is not the name of a plugin"),
        ("no_such_module_at_all:X", "cannot import"),
        ("collections:Missing", "no class"),
        ("collections:abc", "no class"),
        ("numbers:Rational", "cannot create"),
    ],
)
def test_plugin_that_cannot_be_loaded_raises_the_reason(lib: str, reason: str) -> None:
    with pytest.raises(BadConfiguration, match=reason):
        entry(lib)


def test_plugin_settings_may_be_attributes_or_elements() -> None:
    element = Element("x", {"port": "/dev/ttyS0"}, (Element("rate", {"value": " 9600 "}), Element("bare")))
    assert element.get("port") == "/dev/ttyS0"
    assert element.integer("rate", 0) == 9600
    assert element.integer("bare", 5) == 5
    assert element.number("missing", 2.5) == 2.5
    for name, text in (("a", "nan"), ("a", "inf"), ("a", "1,5"), ("a", "")):
        with pytest.raises(BadConfiguration, match="not a number"):
            Element("x", {name: text}).number("a", 0.0)
    with pytest.raises(BadConfiguration, match="from 0 to 1"):
        Element("x", {"a": "1.5"}).number("a", 0.0, least=0.0, most=1.0)


def test_text_of_an_element_excludes_its_children() -> None:
    (entry,) = parse_config("<rhd><plugins><x> a <y>\nb &amp; c</y> d </x></plugins></rhd>").plugins
    (child,) = entry.config.children
    assert (entry.config.text, child.text) == ("a  d", "b & c")


@pytest.mark.property
@given(
    st.one_of(st.binary(max_size=200), st.text(max_size=200), st.from_regex(r"(<[a-c]( b='[0-9&;]*')?/?>|</[a-c]>)*"))
)
def test_any_input_is_a_configuration_or_a_documented_error(data: bytes | str) -> None:
    with contextlib.suppress(LocalError):
        assert isinstance(parse_config(data), Configuration)
