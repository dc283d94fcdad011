"""The commands vars, get and set."""

from __future__ import annotations

import pytest

import rhdlink
from rhdlink import Bool, Float64, Host, Plugin, Read
from tests.fakes.rhd import Peer, Robot, ScriptedServer, serving
from tests.harm import HOSTILE, assert_harmless, strict
from tests.spawning import interrupt
from tests.waiting import until

from .conftest import Run, Spawn

pytestmark = pytest.mark.real_time


def test_vars_prints_a_table(run: Run, address: str) -> None:
    status, out, err = run("vars", address)
    assert (status, err) == (0, "")
    head, *lines = out.splitlines()
    assert head == f"{address}: 10 variables, time stamps of 2 words"
    rows = [line.split() for line in lines]
    assert [row[:3] for row in rows[:3]] == [["read", "0", "tick"], ["read", "1", "transpos"], ["read", "2", "rotpos"]]
    assert [row[2] for row in rows if row[0] == "write"] == ["cmdtransvel", "cmdrotvel", "arm"]
    (line,) = (line for line in lines if " rotpos " in line)
    assert "= 0 rad" in line
    (line,) = (line for line in lines if " never " in line)
    assert line.split()[-4:] == ["0", "0", "0", "0.000000"]
    (line,) = (line for line in lines if " big " in line)
    assert "… 24 more" in line


@pytest.mark.parametrize("option", [(), ("--json",)])
def test_vars_prints_count_zero_for_a_robot_without_variables(run: Run, option: tuple[str, ...]) -> None:
    with ScriptedServer(serving(Robot(read=(), write=()))) as server:
        status, out, err = run("vars", server.address, *option)
    assert (status, err) == (0, "")
    assert out == ("" if option else f"{server.address}: 0 variables, time stamps of 2 words\n")


def test_vars_prints_json(run: Run, address: str) -> None:
    status, out, _ = run("vars", address, "--json")
    assert status == 0
    found = {each["name"]: each for each in map(strict, out.splitlines())}
    assert len(found) == 10
    assert found["linesensor"]["words"] == list(range(8))
    assert found["linesensor"]["meaning"] is None
    assert found["cmdtransvel"] | {"stamp": None} == {
        "name": "cmdtransvel",
        "direction": "w",
        "id": 0,
        "length": 1,
        "words": [0],
        "stamp": None,
        "meaning": "0 m/s",
    }
    assert len(found["big"]["words"]) == 40


def test_get_prints_values_with_units(run: Run, address: str) -> None:
    status, out, err = run("get", address, "linesensor", "rotpos", "linesensor")
    assert (status, err) == (0, "")
    assert out == "linesensor 0 1 2 3 4 5 6 7\nrotpos 0 = 0 rad\nlinesensor 0 1 2 3 4 5 6 7\n"


def test_get_accepts_names_after_the_json_option(run: Run, address: str) -> None:
    until(lambda: strict(run("get", address, "counter", "--json")[1])["words"] != [0])  # 0 at the first tick
    status, out, _ = run("get", address, "counter", "--json", "never")
    assert status == 0
    counter, never = map(strict, out.splitlines())
    assert counter["words"][0] < 0
    assert never["words"] == [0, 0, 0]


def test_get_converts_values_to_a_type(run: Run) -> None:
    class Typed(Plugin):
        bearing = Read(Float64, 2)
        flags = Read(Bool, 3)

        def periodic(self, tick: int) -> None:
            self.bearing, self.flags = [0.25, -1e-7], [True, False, True]

    with Host([Typed()], period=0.002, port=0) as host:
        assert run("get", host.address, "bearing", "--as", "float64") == (0, "bearing 0.25 -1e-07\n", "")
        assert run("get", host.address, "flags", "--as", "bool")[1] == "flags True False True\n"
        assert strict(run("get", host.address, "bearing", "--as", "float64", "--json")[1])["values"] == [0.25, -1e-7]
        # With the other byte order, the words are combined differently.
        assert run("get", host.address, "bearing", "--as", "float64", "--order", "big")[1] != "bearing 0.25 -1e-07\n"
        status, out, err = run("get", host.address, "flags", "--as", "float64")
        assert (status, out) == (1, "")
        assert "flags has 3 words; a value of float64 needs 2" in err


def test_get_reports_missing_variables(run: Run, address: str) -> None:
    status, out, err = run("get", address, "tick", "nope", "neither")
    assert (status, out) == (1, "")
    assert "has no variable 'nope', 'neither'" in err


def test_set_writes_and_prints_the_words(run: Run, address: str) -> None:
    status, out, err = run("set", address, "arm", "--", "1", "-2", "3", "-2147483648")
    assert (status, out) == (0, "")
    assert err == "rhdlink: arm is 1 -2 3 -2147483648\n"
    assert run("get", address, "arm")[1] == "arm 1 -2 3 -2147483648\n"


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("arm", "1", "2"), "arm: expected 4 words"),
        (("arm", "1"), "arm: expected 4 words"),
        (("cmdrotvel", "1", "2"), "cmdrotvel: expected 1 words"),
        (("tick", "1"), "it is a read variable"),
        (("nope", "1"), "no write variable 'nope'"),
    ],
)
def test_set_reports_invalid_values_and_names(run: Run, address: str, argv: tuple[str, ...], said: str) -> None:
    status, out, err = run("set", address, *argv)
    assert (status, out) == (1, "")
    assert said in err
    assert err.count("\n") == 1


def test_set_fails_while_another_master_is_connected(run: Run, address: str) -> None:
    with rhdlink.connect(address, access="w"):
        status, _, err = run("set", address, "cmdrotvel", "1")
    assert status == 1
    assert "it already has a master" in err


@pytest.mark.slow
def test_set_with_hold_ends_when_interrupted(spawn: Spawn, host: Host, address: str) -> None:
    process = spawn("set", address, "cmdtransvel", "30000", "--hold", "1000")
    assert process.stderr is not None
    assert process.stderr.readline() == "rhdlink: cmdtransvel is 30000 = 0.3 m/s\n"
    with rhdlink.connect(address, rhdlink.robots.VelocityOmega) as robot:

        def drives() -> bool:
            robot.sync()
            return robot.transpos > 100

        until(drives)
    assert host.writers == 1
    interrupt(process)
    assert process.wait(20) == 130
    until(lambda: host.writers == 0)


def test_set_with_hold_ends_after_its_duration(run: Run, address: str) -> None:
    assert run("set", address, "cmdtransvel", "30000", "--hold", "0.5")[0] == 0
    transpos = int(run("get", address, "transpos")[1].split()[1])
    assert transpos >= 2000  # 7 ticks, out of 50 if none is missed


def greet(peer: Peer) -> None:
    """Send a handshake with a malicious name of a variable."""
    database = rhdlink.variables.Database()
    database.read.add("tick")
    database.read.add("\x1b[2J\x9b31m\u00ad")
    peer.expect(b"ar")
    peer.send(database.encode_handshake("r"))
    assert peer.is_left()


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_control_characters_in_names_are_escaped(run: Run, options: tuple[str, ...]) -> None:
    assert "\x1b" in HOSTILE
    with ScriptedServer(greet) as server:
        status, out, err = run("vars", server.address, *options)
    assert status == 0
    assert_harmless(out, err)
    assert "[2J" in out
