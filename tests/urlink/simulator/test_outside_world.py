"""Access of programs to the outside: XML-RPC servers, Modbus signals, and the tool's serial line and outputs."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue
from linkcore.wire.http import HttpResponse
from tests.fakes.server import OneAfterAnother
from urlink.simulator import Controller, Still
from urlink.simulator.urscript.builtins.remote_procedures import parse_answer
from urlink.simulator.urscript.errors import Fault

pytestmark = pytest.mark.real_time

TIMEOUT = 120.0
Run = Callable[[str], tuple[str, ...]]


@pytest.fixture(scope="module")
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.25", motion=Still()) as controller:
        yield controller


@pytest.fixture
def run(controller: Controller) -> Iterator[Run]:
    """Function that runs a program to its end and returns its text messages."""
    with urlink.connect(controller.address, stale_after=20.0, silence=30.0) as robot:

        def run(text: str) -> tuple[str, ...]:
            return robot.script.run(text, wait=TIMEOUT).texts

        yield run


@pytest.fixture
def server() -> Iterator[SimpleXMLRPCServer]:
    made = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False, allow_none=True)
    made.register_function(lambda *values: list(values), "echo")
    made.register_function(lambda a, b: a + b, "add")
    made.register_function(lambda: {"x": 1, "y": 2.5, "z": 0, "rx": 0, "ry": 0, "rz": 3}, "where")
    made.register_function(lambda: {"name": "part", "count": 3}, "part")
    made.register_function(lambda pose: pose["y"], "y_of")
    made.register_function(lambda: 1 / 0, "fail")
    made.register_function(lambda: b"bytes", "odd")
    thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield made
    made.shutdown()
    made.server_close()
    thread.join()


def test_xmlrpc_methods_are_called(run: Run, server: SimpleXMLRPCServer) -> None:
    url = f"http://127.0.0.1:{server.server_address[1]}/RPC2"
    texts = run(
        f"""rpc = rpc_factory("xmlrpc", "{url}")
textmsg(rpc.echo(1, 2.5))
textmsg(rpc.echo(True)[0])
textmsg(rpc.echo("text")[0])
x = rpc.add(1, 2) + rpc.add(0.5, rpc.add(1, 1))
textmsg(x)
if rpc.add(1, 1) == 2 and rpc.add(1, 1) != 3:
  textmsg("both")
end
p1 = rpc.where()
textmsg(p1)
textmsg(rpc.y_of(p1))
textmsg(rpc.part().count)
rpc.closeXMLRPCClientConnection()
"""
    )
    assert texts == ("[1,2.5]", "True", "text", "5.5", "both", "p[1,2.5,0,0,0,3]", "2.5", "3")


@pytest.mark.parametrize(
    ("kept", "found"), [("struct(h={})", "s.h"), ("struct(t=struct(h={}))", "s.t.h"), ("make_list(1, {})", "s[0]")]
)
def test_stored_xmlrpc_handle_keeps_its_methods(run: Run, server: SimpleXMLRPCServer, kept: str, found: str) -> None:
    handle = f'rpc_factory("xmlrpc", "http://127.0.0.1:{server.server_address[1]}/RPC2")'
    assert run(f"s = {kept.format(handle)}\ntextmsg({found}.add(1, 2))\n") == ("3",)


@pytest.mark.parametrize(
    ("call", "error"),
    [
        ("h.fail()", "replied with fault 1: .*division by zero"),
        ("h.nothing()", 'replied with fault 1: .*method "nothing" is not supported'),
        ("h.odd()", "which URScript does not support"),
    ],
)
def test_invalid_xmlrpc_answer_ends_the_program(run: Run, server: SimpleXMLRPCServer, call: str, error: str) -> None:
    url = f"http://127.0.0.1:{server.server_address[1]}/RPC2"
    with pytest.raises(urlink.ScriptFailed, match=error):
        run(f'h = rpc_factory("xmlrpc", "{url}")\nx = {call}\n')


def test_names_of_remote_methods_contain_dots(run: Run, server: SimpleXMLRPCServer) -> None:
    server.register_function(lambda x: x + 1, "server.getTCP")
    server.register_function(lambda: 7, "a.b.c")
    url = f"http://127.0.0.1:{server.server_address[1]}/RPC2"
    begin = f'AAA = rpc_factory("xmlrpc", "{url}")\n'
    assert run(f"{begin}textmsg(AAA.server.getTCP(41))\ntextmsg(AAA.a.b.c())\n") == ("42", "7")
    with pytest.raises(urlink.ScriptFailed, match=r'method "server\.nothing" is not supported'):
        run(f"{begin}AAA.server.nothing()\n")
    with pytest.raises(urlink.ScriptFailed, match="handle of a server has no member 'server'"):
        run(f"{begin}AAA.server = 1\n")
    with pytest.raises(urlink.ScriptFailed, match="the name of a remote method is longer than 255 characters"):
        run(f"{begin}while True:\n  AAA = AAA.server\nend\n")


@pytest.mark.parametrize(
    ("program", "error"),
    [
        (
            'h = rpc_factory("xmlrpc", "http://127.0.0.1:1/RPC2")\nh.method()',
            r"method: http://127\.0\.0\.1:1/.* cannot",
        ),
        # Hosts other than this computer are reachable only if a socket may connect to them, too.
        ('h = rpc_factory("xmlrpc", "http://192.0.2.1/RPC2")\nh.method()', "cannot connect to the server"),
        ('h = rpc_factory("soap", "http://127.0.0.1/")', "type is 'soap'; expected 'xmlrpc'"),
        ('h = rpc_factory("xmlrpc", "127.0.0.1:40404")', "is not an address such as"),
        ("h = 5\nh.method()", "int has no method 'method'"),
        ('h = rpc_factory("xmlrpc", "http://127.0.0.1:29999/")\nh.method()', "is not valid XML-RPC"),
        ("x = tool_pose()", "tool_pose: its result is unknown, and it is not modelled"),
        ('eip_reader_factory("x", 1)', "eip_reader_factory: EtherNet/IP is not modelled"),
    ],
)
def test_invalid_outside_call_ends_the_program(run: Run, program: str, error: str) -> None:
    with pytest.raises(urlink.ScriptFailed, match=error):
        run(program)


def test_modbus_signals_are_named_values(controller: Controller, run: Run) -> None:
    controller.modbus["pressure"] = 420
    add = 'modbus_add_signal("192.168.0.5", 255, 128, {}, "{}", False)\n'
    texts = run(
        add.format(2, "pressure")
        + add.format(0, "door")
        + add.format(1, "lamp")
        + add.format(3, "speed")
        + """modbus_set_signal_update_frequency("pressure", 20)
modbus_set_signal_watchdog("pressure", True)
modbus_set_runstate_dependent_choice("lamp", 3)
textmsg(modbus_get_signal_status("pressure", False))
textmsg(modbus_get_signal_status("door", False))
modbus_set_output_signal("lamp", True, False)
modbus_set_output_register("speed", 77, False)
textmsg(modbus_get_error("door"), modbus_get_time_since_signal_invalid("door"))
modbus_send_custom_command("192.168.0.5", 255, 6, [1, 2])
"""
    )
    assert texts == ("420", "False", "00")
    assert dict(controller.modbus) == {"pressure": 420, "door": 0, "lamp": 1, "speed": 77}
    pressure = controller.modbus.signal("pressure")
    assert pressure is not None
    assert (pressure.frequency, pressure.watchdog, pressure.address) == (20, True, 128)
    controller.modbus["door"] = 1
    controller.modbus.fail("door", 11)
    wait = "while modbus_get_time_since_signal_invalid('door') < 0.02:\n  sync()\nend\n"
    assert run(wait + "textmsg(modbus_get_error('door'), modbus_get_signal_status('door', False))") == ("11True",)
    for name, value, error in (("door", 2, "from 0 to 1"), ("speed", 65536, "from 0 to 65535"), ("speed", -1, "0")):
        with pytest.raises(BadValue, match=error):
            controller.modbus[name] = value
    with pytest.raises(BadValue, match="no program has added"):
        controller.modbus.fail("nothing", 1)
    for program, error in (
        ("modbus_get_signal_status('nothing', False)", "there is no Modbus signal 'nothing'"),
        ("modbus_set_output_signal('door', True, False)", "'door' is a digital input"),
        ("modbus_delete_signal('door')\nmodbus_get_error('door')", "there is no Modbus signal 'door'"),
    ):
        with pytest.raises(urlink.ScriptFailed, match=error):
            run(program)


def test_modbus_rw_registers_are_lists(controller: Controller, run: Run) -> None:
    add = 'modbus_add_rw_signal("192.168.0.5", 255, 100, 3, 200, 2, "axes")\n'
    controller.modbus["axes"] = [1, 2, 3]
    read = "textmsg(modbus_get_signal_status('axes'))"
    assert run(f"{add}modbus_set_output_register('axes', [7, 65535])\n{read}") == ("[1,2,3]",)
    axes = controller.modbus.signal("axes")
    assert axes is not None
    assert axes.written == (7, 65535)
    controller.modbus["axes"] = [4, 5, 6]
    assert run(read) == ("[4,5,6]",)
    for value, error in (([1, 2], "cannot be"), (7, "cannot be"), ([1, 2, 65536], "from 0 to 65535")):
        with pytest.raises(BadValue, match=error):
            controller.modbus["axes"] = value
    with pytest.raises(urlink.ScriptFailed, match="register_value is 65536; expected 0 to 65535"):
        run("modbus_set_output_register('axes', [0, 65536])")


def test_modbus_signals_with_a_count_are_lists(controller: Controller, run: Run) -> None:
    # As in the vendor's examples for 5.14 and later.
    controller.modbus["inputs"] = [1, 0, 1]
    controller.modbus["registers"] = [500, 65535]
    texts = run(
        """modbus_add_signal("192.168.0.5", 255, 0, 0, "inputs", True, 3)
modbus_add_signal("192.168.0.5", 255, 0, 1, "outputs", True, 2)
modbus_add_signal("192.168.0.5", 255, 5000, 2, "registers", True, 2)
modbus_add_signal("192.168.0.5", 255, 6000, 3, "speeds", True, 2)
modbus_add_signal("192.168.0.5", 255, 12000, 3, "modules", True, 1)
modbus_set_signal_update_frequency("modules", -1)
modbus_set_signal_watchdog("registers", 30)
outputs = modbus_get_signal_status("outputs", False)
outputs[1] = True
modbus_set_output_signal("outputs", outputs, False)
modbus_set_output_register("speeds", [7, 8], False)
textmsg(modbus_get_signal_status("inputs", False))
textmsg(modbus_get_signal_status("registers", False))
textmsg(modbus_get_signal_status("modules"))
"""
    )
    assert texts == ("[True,False,True]", "[500,65535]", "0")
    assert controller.modbus["outputs"] == (0, 1)
    assert controller.modbus["speeds"] == (7, 8)
    registers = controller.modbus.signal("registers")
    assert registers is not None
    assert registers.watchdog
    for program, error in (
        ('modbus_set_output_signal("outputs", True)', "digital_value must be a list of 2 values"),
        ('modbus_set_output_signal("outputs", [True])', "digital_value must be a list of 2 values"),
        ('modbus_set_output_signal("outputs", [True, 1])', "digital_value has the type int; expected True or False"),
        ('modbus_set_output_register("speeds", [1, 65536])', "register_value is 65536; expected 0 to 65535"),
        ('modbus_set_output_signal("inputs", [True, True, True])', "'inputs' is a digital input"),
        ('modbus_add_signal("192.168.0.5", 255, 0, 2, "many", True, 126)', "register_count is 126; expected 1 to 125"),
    ):
        with pytest.raises(urlink.ScriptFailed, match=error):
            run(program)
    with pytest.raises(BadValue, match="from 0 to 1"):
        controller.modbus["inputs"] = [1, 2, 0]


def test_modbus_value_set_earlier_is_converted_to_its_kind(controller: Controller, run: Run) -> None:
    controller.modbus["late"] = [7, 0]
    run('modbus_add_signal("192.168.0.5", 255, 0, 0, "late", True, 2)')
    assert controller.modbus["late"] == (1, 0)


def test_modbus_add_signal_accepts_a_count_since_5_14() -> None:
    line = 'modbus_add_signal("192.168.0.5", 255, 0, 0, "inputs", True, 2)'
    for firmware, is_taken in (("5.13", False), ("5.14", True), ("10.7", True)):
        controller = Controller(firmware=firmware)
        controller.take(f"def f():\n  {line}\nend\n")
        controller.step(2)
        assert ("inputs" in controller.modbus) is is_taken


def test_program_configures_the_tool(controller: Controller, run: Run) -> None:
    run(
        "set_tool_communication(True, 115200, 2, 1, 1.5, 3.5)\nset_tool_voltage(24)\nset_tool_output_mode(0)\n"
        "set_tool_digital_output_mode(0, 2)\nset_tool_digital_output_mode(1, 3)\nset_tool_digital_out(1, True)\n"
        "m = inv([[2, 0], [0, 4]])\nset_standard_analog_out(0, m[1, 1])\n"
    )
    signals = controller.signals
    assert signals.tool_communication == (True, 115200, 2, 1, 1.5, 3.5)
    assert (signals.tool_output_voltage, signals.tool_digital_output_modes) == (24, [2, 3])
    assert signals.digital_outputs >> 17 & 1
    assert signals.analog_outputs[0] == pytest.approx(0.008)
    with pytest.raises(urlink.ScriptFailed, match="inv: m has no inverse"):
        run("m = inv([[1, 1], [1, 1]])")


# -- malicious answers -----------------------------------------------------------------------------------


def answer(value: str) -> bytes:
    return f"<?xml version='1.0'?><methodResponse><params><param>{value}</param></params></methodResponse>".encode()


def nested(depth: int) -> bytes:
    return answer("<value><array><data>" * depth + "<value><int>1</int></value>" + "</data></array></value>" * depth)


xml_values = st.recursive(
    st.sampled_from(
        [
            "<value><int>1</int></value>",
            "<value><i8>99999999999999999999</i8></value>",
            "<value><double>nan</double></value>",
            "<value><double>1e999</double></value>",
            "<value><double></double></value>",
            "<value><boolean>2</boolean></value>",
            "<value><base64>!</base64></value>",
            "<value><dateTime.iso8601>x</dateTime.iso8601></value>",
            "<value><nil/></value>",
            "<value>&amp;\u4e2d</value>",
            "<value><bigdecimal>1e999999999</bigdecimal></value>",
            "<value><unknown>1</unknown></value>",
            "<value>",
            "<data/>",
            "<struct><member><name>a</name></member></struct>",
            f"<value><int>{'9' * 5000}</int></value>",
            f"<value><int>{'9' * 400}</int></value>",
            f"<value>{'a' * 20_000}</value>",
        ]
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4).map(lambda each: f"<value><array><data>{''.join(each)}</data></array></value>"),
        st.lists(inner, max_size=6).map(
            lambda each: (
                "<value><struct>"
                + "".join(
                    f"<member><name>{name}</name>{item}</member>"
                    for name, item in zip(("x", "y", "z", "rx", "ry", "rz"), each, strict=False)
                )
                + "</struct></value>"
            )
        ),
    ),
    max_leaves=12,
)


@pytest.mark.property
@given(st.one_of(xml_values.map(answer), st.integers(1, 5000).map(nested), st.binary(max_size=100)))
def test_any_xmlrpc_answer_is_a_value_or_a_fault(body: bytes) -> None:
    with contextlib.suppress(Fault):
        parse_answer(body, "h.go", lambda work: None)


def test_too_deep_xmlrpc_answer_ends_only_the_program(controller: Controller, run: Run) -> None:
    class Deep(OneAfterAnother):
        def _talk(self, connection: socket.socket) -> None:
            connection.recv(65536)
            connection.sendall(HttpResponse(200, "OK", {}, nested(3000)).encode())

    server = Deep(TIMEOUT)
    try:
        with pytest.raises(urlink.ScriptFailed, match="nested too deeply; the limit is 64"):
            run(f'h = rpc_factory("xmlrpc", "http://127.0.0.1:{server.port}/")\nx = h.go()\n')
    finally:
        server.close()
    assert run('textmsg("next")\n') == ("next",)
    assert controller.is_up
