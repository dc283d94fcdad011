"""Growth of every parser's time with the size of its input: the exponent from 1 to 64 KiB, for the worst known inputs.

Each input is doubled six times, and the processor time of each size is the best of several runs. The exponent is 1 if
the time is proportional to the size, 2 if it is quadratic, and 0 if no more time is needed: most parsers reject inputs
that exceed a limit. The exponent is the smaller of two estimates, because each is wrong in some cases. The first is the
slope from 16 to 64 KiB in logarithms. It is too large for a framer that does nothing until a frame is complete. The
second is calculated from the last two increments, in which the noise of the machine counts twice. The goal is below 1.2
for every parser.

There are three kinds of inputs: strings with which expressions and loops of earlier versions were slow, strings that
are made for the current expressions and loops, and the worst results of a search over repeated fragments (`--search`).

    python benchmarks/growth.py
    python benchmarks/growth.py --quick            # the best of 2 runs
    python benchmarks/growth.py --only http        # names that contain this
    python benchmarks/growth.py --search 200       # try random repeated fragments too, 200 for each parser
    python benchmarks/growth.py --json
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import json
import math
import random
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import rhdlink.address
from linkcore.clock import Stamp
from linkcore.errors import LinkError
from linkcore.recording.file import MAGIC, Kind, pack
from linkcore.wire.http import HttpParser
from rhdlink import Mission
from rhdlink.host.config import parse_config
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.host.scene import Scene
from rhdlink.smrcl.controller import MissionController
from rhdlink.smrcl.robot_conf import VELOMEGA, parse_robot_conf
from rhdlink.smrcl.robot_link import PluginLink
from rhdlink.wire.data import TableLayout
from rhdlink.wire.decoder import ClientDecoder, ServerDecoder
from urlink import decode, load
from urlink.packets import RealtimeState, TextMessage, VersionMessage
from urlink.protocol.dashboard.protocol import (
    DashboardProtocol,
    parse_is_program_saved,
    parse_loaded_program,
    parse_program_state,
)
from urlink.protocol.dashboard.stored_programs import parse_form, parse_programs
from urlink.protocol.firmware import Firmware
from urlink.protocol.gripper.protocol import value_of
from urlink.protocol.interpreter import InterpreterProtocol, parse_reply
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.protocol.realtime.protocol import RealtimeProtocol
from urlink.protocol.rtde.packets import decode_reply, decode_request, split_names
from urlink.session.address import parse_address
from urlink.simulator import Controller, Still
from urlink.simulator.interfaces.interface import ScriptReceiver
from urlink.simulator.programs.loader import obey
from urlink.simulator.state import Counters
from urlink.simulator.urscript import ProgramError, compile_script
from urlink.simulator.urscript.builtins.remote_procedures import parse_answer
from urlink.simulator.urscript.errors import Fault

SIZES = tuple(1024 << step for step in range(7))
FIRMWARE = Firmware(5, 11)
#: Time, in ms, below which an increment is ignored.
_NOTICED = 0.05
#: Errors that a parser may raise.
REFUSALS = (LinkError, ProgramError, Fault)

Parser = Callable[[bytes], object]


class Open:
    """Client of a simulated port whose connection stays open."""

    is_open = True
    pending = 0

    def send(self, packet: bytes) -> None:
        """Discard the packet, because this client reads nothing."""

    def finish(self) -> None:
        """Do nothing, because the connection stays open."""

    def drop(self) -> None:
        """Do nothing, because the connection stays open."""


# -- the parsers -----------------------------------------------------------------------------------------------


def http_in_pieces(data: bytes) -> None:
    parser = HttpParser("request")
    for at in range(len(data)):
        parser.feed(data[at : at + 1])


def dashboard_client(data: bytes) -> None:
    protocol = DashboardProtocol()
    protocol.feed(b"Connected: Universal Robots Dashboard Server\n")
    protocol.ask("programState")
    reply = protocol.feed(data + b"\n")
    for parse in (parse_program_state, parse_is_program_saved, parse_loaded_program):
        try:
            parse(reply or "")
        except LinkError:
            continue


def dashboard_replies(data: bytes) -> None:
    """Use only the expressions, because the protocol rejects long lines before it uses them."""
    text = data.decode("latin-1")
    for parse in (parse_program_state, parse_is_program_saved, parse_loaded_program):
        try:
            parse(text)
        except LinkError:
            continue


def interpreter_client(data: bytes) -> None:
    protocol = InterpreterProtocol()
    protocol.ask("sync()")
    protocol.feed(data + b"\n")


@functools.cache
def simulated() -> Controller:
    """Return a controller without clients, which is made before the measurement."""
    return Controller("UR5e", "5.11", motion=Still())


def served(name: str) -> Parser:
    """Return a parser that feeds a port of a simulated controller."""
    return lambda data: simulated()._interfaces[name].receiver(Open()).feed(data)


def script_lines(data: bytes) -> None:
    ScriptReceiver(Open(), Counters(), lambda line: None, lambda text: True).feed(data)


def script_queue(data: bytes) -> None:
    queue = simulated()._loader.open()
    for line in data.decode("latin-1").split("\n"):
        queue.put(line)
    simulated()._loader.clear()


def command_line(data: bytes) -> None:
    obey(simulated()._state, simulated()._runner, data.decode("latin-1"))


def mission_client(data: bytes) -> None:
    link = PluginLink([Turtle()])
    controller = MissionController(VELOMEGA, link.read, link.write)
    session = controller.serve().connect()
    session.receive(data)


def recording(read: Callable[[Path], object]) -> Parser:
    def parse(data: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.urlog"
            path.write_bytes(data)
            read(path)

    return parse


def framed(protocol: Callable[[], RealtimeProtocol | PrimaryProtocol], first: bytes) -> Parser:
    def feed(data: bytes) -> None:
        framer = protocol().framer
        framer.feed(first)
        framer.feed(data)

    return feed


def pieces(data: bytes) -> Iterator[bytes]:
    """Split the data, as a network may do."""
    return (data[at : at + 61] for at in range(0, len(data), 61))


def rhd_server(data: bytes) -> None:
    decoder = ServerDecoder()
    for piece in pieces(data):
        decoder.feed(piece)
        while decoder.take_handshake() is not None and decoder.take_batch() is not None:
            pass


def rhd_client(data: bytes) -> None:
    decoder = ClientDecoder(TableLayout([1, 1]))
    for piece in pieces(data):
        decoder.feed(piece)
        while decoder.take_access() is not None and decoder.take_request() is not None:
            pass


def scene(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "floor.svg"
        path.write_bytes(data)
        Scene.from_svg(path)


PARSERS: Mapping[str, Parser] = {
    "http request": lambda data: HttpParser("request").feed(data),
    "http request, byte by byte": http_in_pieces,
    "http response": lambda data: HttpParser("response").feed(data),
    "http form": lambda data: parse_form("multipart/form-data; boundary=x", data),
    "list of programs": lambda data: parse_programs(data.decode("latin-1")),
    "XML-RPC": lambda data: parse_answer(data, "h.go", lambda work: None),
    "URScript": lambda data: compile_script(data.decode("latin-1"), FIRMWARE),
    "URScript, lines of a client": script_lines,
    "URScript, programs that wait": script_queue,
    "command lines": command_line,
    "dashboard server": served("dashboard"),
    "dashboard client": dashboard_client,
    "dashboard replies": dashboard_replies,
    "interpreter client": interpreter_client,
    "interpreter replies": lambda data: parse_reply(data.decode("latin-1")),
    "interpreter server": served("interpreter"),
    "gripper server": served("gripper"),
    "gripper replies": lambda data: value_of("POS", data.decode("latin-1")),
    "RTDE server": served("rtde"),
    "RTDE text": lambda data: decode_reply(struct.pack(">HB", min(len(data) + 3, 65535), ord("M")) + data[:65532], 1),
    "RTDE names": lambda data: split_names(data.decode("latin-1")),
    "RTDE request": lambda data: decode_request(struct.pack(">HB", 65535, ord("O")) + data[:65532], 2),
    "primary text": lambda data: decode(bytes(TextMessage("5.11", text="a")) + data, interface="primary"),
    "primary frames": framed(
        PrimaryProtocol, bytes(VersionMessage("5.8", project_name="U", major=5, minor=8, build_date="x" * 20))
    ),
    "real-time frames": framed(RealtimeProtocol, bytes(RealtimeState("5.10", time=5.0))),
    "SMR-CL, check": lambda data: Mission(data.decode("latin-1") + "\n").check(),
    "SMR-CL, lines of a client": mission_client,
    "robot.conf": parse_robot_conf,
    "rhdconfig.xml": parse_config,
    "RHD, of a server": rhd_server,
    "RHD, of a client": rhd_client,
    "drawing of a floor": scene,
    "address of an arm": lambda data: parse_address(data.decode("latin-1")),
    "address of a mobile robot": lambda data: rhdlink.address.parse_address(data.decode("latin-1")),
    "recording, load": recording(lambda path: load(path).missing),
}

# -- the inputs ------------------------------------------------------------------------------------------------


def filled(before: bytes, element: bytes, after: bytes = b"") -> Callable[[int], bytes]:
    """Return a function that makes an input of about a given size by repeating an element."""
    return lambda size: before + element * max((size - len(before) - len(after)) // len(element), 1) + after


def nested(
    begin: bytes, end: bytes, before: bytes = b"", middle: bytes = b"", after: bytes = b""
) -> Callable[[int], bytes]:
    """Return a function that makes an input of about a given size with nested elements."""

    def made(size: int) -> bytes:
        count = max((size - len(before) - len(middle) - len(after)) // len(begin + end), 1)
        return before + begin * count + middle + end * count + after

    return made


_EVENT = pack(Kind.EVENT, 0, Stamp(1.0, 1.0), b'{"state": "lost"}')
_CHANNEL = pack(Kind.CHANNEL, 0, Stamp(1.0, 1.0), b'{"name": "realtime", "firmware": "5.11"}')
_BYTES = pack(Kind.BYTES, 0, Stamp(1.0, 1.0), b"\0" * 5)
_HTTP = b"GET / HTTP/1.1\r\n"
_RPC = b"<?xml version='1.0'?><methodResponse><params><param>"
_RPC_END = b"</param></params></methodResponse>"
_MEMBER = b"<member><name>a</name><value>1</value></member>"
_SVG = b'<svg width="1m" height="1m" viewBox="0 0 1 1"><path d="M '

#: handshake of a server without variables
_HANDSHAKE = b"artw\0\0\0\0tr\0\0\0\0dw\0\0\0\0dr\0\0\0\0ee"

INPUTS: Mapping[str, Sequence[Callable[[int], bytes]]] = {
    "http request": (
        filled(_HTTP + b"a:", b" ", b"\n\r\n\r\n"),
        filled(_HTTP + b"a:", b" \t", b"\0\r\n\r\n"),
        filled(b"GET ", b"/", b" HTTP/1.2\r\n\r\n"),
        filled(_HTTP, b"a:b\r\n", b"\r\n"),
        filled(_HTTP + b"Transfer-Encoding: chunked\r\n\r\n", b"1\r\nx\r\n"),
        filled(_HTTP + b"Transfer-Encoding: chunked\r\n\r\n", b"1 ", b"\r\n"),
    ),
    "http request, byte by byte": (
        filled(_HTTP, b"a:b\r\n", b"\r\n"),
        filled(_HTTP + b"a:", b"\r"),
        filled(_HTTP + b"Transfer-Encoding: chunked\r\n\r\n", b"1\r\nx\r\n"),
        filled(_HTTP + b"Content-Length: 900000\r\n\r\n", b"x"),
    ),
    "http response": (
        filled(b"HTTP/1.1 100 Continue\r\n\r\n", b"HTTP/1.1 100 Continue\r\n\r\n"),
        filled(b"HTTP/1.1 200 ", b" ", b"\n\r\n\r\n"),
        filled(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n", b"1\r\nx\r\n"),
    ),
    "http form": (
        filled(b"--x\r\n", b"content-disposition: ", b"\r\n\r\n\r\n--x--"),
        filled(b"--x\r\ncontent-disposition:", b" ", b"\r\n\r\n\r\n--x--"),
        filled(b"", b"\r\n--x"),
    ),
    "list of programs": (
        filled(b'{"programs": [', b"{},", b"{}]}"),
        filled(b'{"programs": ', b"["),
        filled(b'{"programs": [', b"1", b"]}"),
    ),
    "XML-RPC": (
        nested(b"<value><array><data>", b"</data></array></value>", _RPC, b"<value>1</value>", _RPC_END),
        filled(_RPC + b"<value><array><data>", b"<value><int>1</int></value>", b"</data></array></value>" + _RPC_END),
        filled(_RPC + b"<value><struct>", _MEMBER, b"</struct></value>" + _RPC_END),
        filled(_RPC + b"<value>", b"&amp;", b"</value>" + _RPC_END),
        filled(_RPC + b"<value><int>", b"9", b"</int></value>" + _RPC_END),
        filled(_RPC + b"<value><double>", b"1", b"</double></value>" + _RPC_END),
        filled(_RPC + b"<value><base64>", b"AAAA", b"</base64></value>" + _RPC_END),
    ),
    "URScript": (
        filled(b"def f():\n", b"  x = (1 + 2) * 3 - 4\n", b"end\n"),
        filled(b"x=", b"'\""),
        filled(b"", b"#\n", b"$\n"),
        filled(b"", b" ", b"x=1\n"),
        filled(b"x=[", b"1,", b"1]\n"),
        filled(b"x=", b"9", b"\n"),
        filled(b'x="', b"a", b"\n"),
        filled(b"", b"a", b"=1\n"),
        filled(b"def f():\n", b" def g():\n end\n", b"end\n"),
        filled(b"x=", b"-", b"1\n"),
        filled(b"x=", b"1+", b"1\n"),
        nested(b"(", b")", b"x=", b"1", b"\n"),
        filled(b"while True:\n", b"break\n", b"end\n"),
    ),
    "URScript, lines of a client": (
        filled(b"", b"\n"),
        filled(b"def f():\n", b"\n", b"end\n"),
        filled(b"end", b" ", b"x\n"),
        filled(b"", b"end\n"),
        filled(b"", b" #\n"),
    ),
    "URScript, programs that wait": (filled(b"", b"a\n"), filled(b"", b"sec f():\n")),
    "command lines": (
        filled(b"set speed ", b"1", b"x"),
        filled(b"set speed .", b"1", b"x"),
        filled(b"", b" ", b"x"),
    ),
    "dashboard server": (filled(b"", b"\n"), filled(b"load ", b"x", b"\n"), filled(b"", b"programState\n")),
    "dashboard client": (filled(b"", b"\n"), filled(b"PLAYING ", b" ", b"\t")),
    "dashboard replies": (
        filled(b"PLAYING ", b" ", b"\n"),
        filled(b"Loaded program:", b" "),
        filled(b"true ", b" ", b"\n"),
        filled(b"STOPPED ", b"a ", b"\n"),
    ),
    "interpreter client": (filled(b"", b"\n"), filled(b"ack: 1:", b" ")),
    "interpreter replies": (filled(b"", b"a"), filled(b"ack:", b" "), filled(b"ack: 1:", b" "), filled(b"ack", b":")),
    "interpreter server": (filled(b"", b"\n"), filled(b"", b"a\n"), filled(b"a=", b"1+", b"1\n")),
    "gripper server": (filled(b"", b"\n"), filled(b"SET ", b"POS ", b"\n"), filled(b"", b"GET POS\n")),
    "gripper replies": (filled(b"POS ", b"1"), filled(b"POS", b" ")),
    "RTDE server": (
        filled(b"", struct.pack(">HB", 3, ord("v"))),
        filled(b"", struct.pack(">HB", 3, 0)),
        filled(b"", b"\0"),
        filled(struct.pack(">HBH", 5, ord("V"), 2) + struct.pack(">HBd", 65535, ord("O"), 1.0), b"a,"),
    ),
    "RTDE text": (filled(b"", b"a"), filled(b"", b"\0"), filled(b"", b"\xff")),
    "RTDE names": (filled(b"", b","), filled(b"", b" "), filled(b"", b" ,")),
    "RTDE request": (filled(bytes(8), b","), filled(bytes(8), b"\xff")),
    "primary text": (filled(b"", b"\xff"), filled(b"\0\0\x20\0\x14", b"a")),
    "primary frames": (
        filled(b"\xff", struct.pack(">iB", 8192, 16) + struct.pack(">iB", 10, 16)),
        filled(b"\xff", struct.pack(">iB", 8192, 16)),
        filled(b"\xff", b"\0"),
        filled(b"\xff" * 6, b"\0\0\0\x0a\x63\0\0\x1f\xff\x10"),
    ),
    "real-time frames": (
        filled(b"\xff", struct.pack(">i", 1220)),
        filled(b"\xff", struct.pack(">i", 4092)),
        filled(b"\xff", struct.pack(">id", 1220, 5.5) + bytes(1208)),
    ),
    "SMR-CL, check": (
        filled(b"eval 1", b"+1", b"\n"),
        filled(b"", b"a = 1\n"),
        filled(b"", b"label"),
        filled(b"", b'label "a"\n'),
        filled(b"", b'goto "b"\n'),
        filled(b"", b"eval " + b"1+" * 100 + b"1\n"),
        filled(b"eval ", b"9", b"\n"),
        filled(b"", b'eval "\n'),
    ),
    "SMR-CL, lines of a client": (filled(b"", b"\n"), filled(b"", b"a\n"), filled(b"", b"x" * 255 + b"\n")),
    "robot.conf": (
        filled(b"<robot>", b'<varscale name="a"/>', b"</robot>"),
        nested(b"<robot>", b"</robot>"),
        filled(b'<robot a="', b" ", b'"/>'),
        filled(b"<robot ", b" ", b"/>"),
    ),
    "rhdconfig.xml": (
        filled(b'<rhd><plugins><plugin lib="', b".so", b'x"/></plugins></rhd>'),
        filled(b'<rhd><plugins><plugin lib="a.so.', b"1.", b'x"/></plugins></rhd>'),
        filled(b"<rhd><plugins>", b'<plugin lib="a" enable="0"/>', b"</plugins></rhd>"),
        filled(b'<rhd><sched><period value="', b" ", b'x"/></sched></rhd>'),
        nested(b"<a>", b"</a>"),
    ),
    "RHD, of a server": (
        filled(b"artw\0\0\7\xd0", bytes(3) + b"\1" + b"a".ljust(33, b"\0")),
        filled(_HANDSHAKE, b"ee"),
        filled(_HANDSHAKE, b"dr\0\0\0\0"),
        filled(_HANDSHAKE, b"dr\0\0\0\0ee"),
    ),
    "RHD, of a client": (filled(b"ar", b"rr"), filled(b"ar", b"rree"), filled(b"aw", b"dw\0\0\0\0")),
    "drawing of a floor": (
        filled(_SVG, b"1", b'"/></svg>'),
        filled(_SVG, b".", b'"/></svg>'),
        filled(_SVG, b"1e", b'"/></svg>'),
        filled(_SVG + b"0 0 ", b"L 1 1 ", b'"/></svg>'),
        nested(b"<g>", b"</g>", b'<svg width="1m" height="1m" viewBox="0 0 1 1">', b"", b"</svg>"),
    ),
    "address of an arm": (
        filled(b"sim://", b"a"),
        filled(b"sim://ur5e?", b"a=b&"),
        filled(b"", b" "),
        filled(b"ur://[", b":", b"]"),
        filled(b"a", b":"),
    ),
    "address of a mobile robot": (filled(b"", b"a"), filled(b"[", b":"), filled(b"a:", b"1"), filled(b"", b"@")),
    "recording, load": (
        filled(MAGIC + _CHANNEL, _EVENT),
        filled(MAGIC + _CHANNEL, _BYTES + _EVENT),
        filled(MAGIC, _CHANNEL),
        filled(MAGIC + _CHANNEL, b"\0"),
        filled(MAGIC + _CHANNEL, b"\0\0\0\x12"),
        filled(MAGIC + _CHANNEL, b"\0\0\0\x12\0\0\0\0"),
        filled(MAGIC + _CHANNEL, _BYTES[:-1]),
    ),
}

# -- the measurement -------------------------------------------------------------------------------------------


def milliseconds(parser: Parser, data: bytes, rounds: int) -> float:
    """Return the processor time of one run, the best of several."""
    best = math.inf
    for _ in range(rounds):
        began = time.process_time()
        with contextlib.suppress(*REFUSALS):
            parser(data)
        best = min(best, time.process_time() - began)
    return best * 1e3


def growth(parser: Parser, made: Callable[[int], bytes], rounds: int) -> tuple[float, list[float]]:
    """Return the exponent, and the milliseconds for each size."""
    times = [milliseconds(parser, made(size), rounds) for size in SIZES]
    before, last = times[-2] - times[-3], times[-1] - times[-2]
    if last < max(_NOTICED, 0.1 * times[-1]):
        return 0.0, times
    return min(math.log(times[-1] / times[-3], 4), math.log2(last / max(before, _NOTICED))), times


def searched(name: str, count: int, seed: int) -> list[Callable[[int], bytes]]:
    """Combine fragments of the known inputs at random, and return the slowest of many results."""
    source = random.Random(f"{seed} {name}")
    pieces = [made(256) for made in INPUTS[name]]
    found = []
    for _ in range(count):
        parts = []
        for _ in range(3):
            piece = source.choice(pieces)
            begin = source.randrange(len(piece))
            parts.append(piece[begin : begin + source.choice((1, 1, 2, 3, 5, 8, 20, 60))])
        if parts[1]:
            made = filled(parts[0], parts[1], parts[2])
            found.append((milliseconds(PARSERS[name], made(1 << 14), 1), made))
    found.sort(key=lambda each: -each[0])
    return [made for _, made in found[:2]]


def measure(only: str, rounds: int, search: int) -> dict[str, dict[str, object]]:
    """Return exponent and milliseconds at 64 KiB by name, of the worst inputs.

    The exponent is of the fastest-growing input, and the time is of the slowest input.
    """
    figures: dict[str, dict[str, object]] = {}
    simulated()
    for name, parser in PARSERS.items():
        if only not in name:
            continue
        rows = []
        for made in [*INPUTS[name], *searched(name, search, 1)]:
            exponent, times = growth(parser, made, rounds)
            for _ in range(3):
                if exponent < 1.15:
                    break
                # Other programs on this machine can look like growth, but not every time.
                exponent, times = min((exponent, times), growth(parser, made, 2 * rounds), key=lambda each: each[0])
            rows.append((exponent, times[-1], made(60)))
        worst, slowest = max(rows, key=lambda row: row[0]), max(rows, key=lambda row: row[1])
        figures[name] = {
            "exponent": worst[0],
            "milliseconds": slowest[1],
            "input": repr(worst[2])[2:-1],
        }
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the best of 2 runs instead of 5")
    parser.add_argument("--only", default="", metavar="NAME", help="only parsers whose name contains this")
    parser.add_argument("--search", type=int, default=0, metavar="N", help="try N random inputs for each parser too")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    figures = measure(options.only, 2 if options.quick else 5, options.search)
    if options.json:
        print(json.dumps(figures))
    else:
        print(f"{'parser':32} {'exponent (below 1.2)':>20} {'slowest, ms at 64 KiB':>22}  begins like")
        for name, row in figures.items():
            print(f"{name:32} {row['exponent']:20.2f} {row['milliseconds']:22.2f}  {str(row['input'])[:60]}")
    if any(float(str(row["exponent"])) >= 1.2 for row in figures.values()):
        sys.exit("some parsers grow faster than the goal")


if __name__ == "__main__":
    main()
