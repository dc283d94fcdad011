"""Published values and answers match `keys.json`, and a router grants each certificate the rights of its name."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

import urlink
import urlink_zenoh
from tests.waiting import until
from urlink.simulator import Controller
from urlink_zenoh import RemoteRobot, Sample, Server, keys, open_session, robots

jsonschema = pytest.importorskip("jsonschema")

#: Marks of the simulated arm of these tests. The limits are long because a busy machine causes silence and delays.
pytestmark = pytest.mark.urlink(
    model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
)

HOME = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
EXAMPLES = Path(__file__).parents[1] / "examples"
SCHEMA: dict[str, Any] = json.loads(Path(keys.__file__).with_name("keys.json").read_text(encoding="utf-8"))


def check(key: str, value: Any, what: str = "payload") -> None:
    """Check a value against the schema of a key."""
    schema = {"$schema": SCHEMA["$schema"], "$defs": SCHEMA["$defs"], **SCHEMA["keys"][key][what]}
    jsonschema.Draft202012Validator(schema).validate(value)


def test_schema_matches_version_and_keys_of_module() -> None:
    assert SCHEMA["version"] == keys.VERSION
    assert keys.key_of("hall/3", "arm") == f"hall/3/v{keys.VERSION}/arm"
    named = re.findall(r"``([\w/]+)``", (keys.__doc__ or "").partition("Clients can subscribe")[0])
    assert set(named) - {f"urlink/v{keys.VERSION}/NAME"} == SCHEMA["keys"].keys()
    jsonschema.Draft202012Validator.check_schema({**SCHEMA, "keys": {}})


def test_json_payloads_match_schema(server: Server, session: zenoh.Session, urlink_controller: Controller) -> None:
    heard: dict[str, list[Any]] = {}
    listener = session.declare_subscriber(
        "urlink/v1/arm/*",
        lambda sample: heard.setdefault(str(sample.key_expr).rpartition("/")[2], []).append(bytes(sample.payload)),
    )
    with RemoteRobot(session, "arm") as remote:
        check("info", remote.info)
        check("status", remote.status)
        (reply,) = session.get("urlink/v1/arm/clock", timeout=5.0)
        assert reply.ok is not None
        check("clock", json.loads(bytes(reply.ok.payload)), "reply")
        check("command/COMMAND", remote.call("move_joints", q=HOME, wait=True), "reply")
        check("command/COMMAND", remote.call("set_speed_slider", fraction=1.0, confirm=20.0), "reply")
        (refused,) = session.get("urlink/v1/arm/command/dance", timeout=5.0)
        assert refused.err is not None
        check("command/COMMAND", json.loads(bytes(refused.err.payload)), "error")
        urlink_controller.faults.protective_stop()
        until(lambda: remote.status["refusal"])
        (stopped,) = session.get(
            f"urlink/v1/arm/command/move_joints?client={remote.client}", payload=b"{}", timeout=5.0
        )
        assert stopped.err is not None
        check("command/COMMAND", json.loads(bytes(stopped.err.payload)), "error")
        urlink_controller.faults.clear()
        urlink_controller.faults.cut("realtime")
        until(lambda: len(heard.get("connection", [])) > 1)
        until(lambda: len(heard.get("status", [])) > 20)
    listener.undeclare()
    assert len(heard["motion"]) == 2
    for key in ("status", "motion", "connection"):
        for payload in heard[key]:
            check(key, json.loads(payload))


@pytest.mark.parametrize("wrong", [{"connection": "connected"}, {"q": [0.0]}, {"speed": 1.0}])
def test_schema_rejects_invalid_status(wrong: dict[str, Any]) -> None:
    with pytest.raises(jsonschema.ValidationError):
        check(
            "status", {"age": 0.0, "refusal": None, **({} if "connection" in wrong else {"connection": "x"}), **wrong}
        )


# -- access control --------------------------------------------------------------------------------

Opened = Callable[[str], zenoh.Session]


@contextlib.contextmanager
def zenohd(config: Path, endpoint: str) -> Iterator[None]:
    """Run the router of the Zenoh project with this configuration."""
    program = shutil.which("zenohd")
    if program is None:
        pytest.skip("zenohd of the Zenoh project is not installed; the Python package has the same router")
    host, _, port = endpoint.rpartition("/")[2].rpartition(":")
    process = subprocess.Popen([program, "--config", str(config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def answers() -> bool:
        assert process.poll() is None, "zenohd has ended"
        with contextlib.suppress(OSError), socket.create_connection((host, int(port)), timeout=1.0):
            return True
        return False

    try:
        until(answers)
        yield
    finally:
        process.kill()
        process.wait()


@pytest.fixture(params=["package", "zenohd"])
def opened(
    request: pytest.FixtureRequest, tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Opened]:
    """Run the router of the example; yield a function that opens a session as a named client."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    made = ["sh", str(EXAMPLES / "certificates.sh"), "127.0.0.1"]
    subprocess.run(made, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    monkeypatch.chdir(tmp_path)
    where = endpoint.replace("tcp/", "tls/")

    def config(example: str, name: str = "reader") -> Path:
        text = (EXAMPLES / example).read_text(encoding="utf-8")
        path = tmp_path / f"{name}-{example}"
        text = re.sub(r"tls/[\w.]+:7447", where, text).replace("certificates/reader.", f"certificates/{name}.")
        path.write_text(text, encoding="utf-8")
        return path

    with contextlib.ExitStack() as stack:
        router = config("router.json5")
        stack.enter_context(zenohd(router, where) if request.param == "zenohd" else open_session(config=router))
        yield lambda name: stack.enter_context(open_session(config=config("client.json5", name), timeout=3.0))


def test_certificate_name_decides_permissions(opened: Opened, urlink_robot: urlink.Robot) -> None:
    with Server(opened("server"), {"arm": urlink_robot}):
        reader, operator = opened("reader"), opened("operator")
        came: list[Sample] = []
        until(lambda: robots(reader) == ["arm"])
        with RemoteRobot(reader, "arm", timeout=2.0) as remote, remote.watch(came.append):
            until(lambda: len(came) > 20)
            until(lambda: "q" in remote.status)
            for command in ("move_joints", "stop"):
                with pytest.raises(urlink.LinkTimeout):
                    remote.call(command, q=HOME)
            assert list(reader.get("urlink/v1/arm/command/stop", timeout=2.0)) == []
        assert urlink_robot.motion.current is None
        with RemoteRobot(operator, "arm") as remote:
            assert remote.call("move_joints", q=HOME, wait=True)["phase"] == "done"
        # An operator is not a server: no client receives a state that it publishes.
        heard: list[bytes] = []
        listener = reader.declare_subscriber("urlink/v1/arm/status", lambda sample: heard.append(bytes(sample.payload)))
        until(lambda: heard)
        operator.put("urlink/v1/arm/status", b"forged")
        count = len(heard)
        until(lambda: len(heard) > count + 10)
        assert b"forged" not in heard
        listener.undeclare()


def test_router_refuses_certificate_of_other_authority(opened: Opened, tmp_path: Path) -> None:
    strange = tmp_path / "strange"
    strange.mkdir()
    made = ["sh", str(EXAMPLES / "certificates.sh"), "127.0.0.1"]
    subprocess.run(made, cwd=strange, check=True, capture_output=True, timeout=60)
    for end in ("pem", "key"):
        shutil.copy(strange / "certificates" / f"reader.{end}", tmp_path / "certificates" / f"stranger.{end}")
    with pytest.raises(urlink.ConnectFailed):
        opened("stranger")


def test_certificate_with_unknown_name_receives_no_data(opened: Opened, urlink_robot: urlink.Robot) -> None:
    with Server(opened("server"), {"arm": urlink_robot}):
        until(lambda: robots(opened("reader")) == ["arm"])
        # The router's own certificate is valid, but no rule contains its name.
        other = opened("router")
        assert robots(other) == []
        assert list(other.get("urlink/v1/arm/status", timeout=2.0)) == []


def test_package_contains_schema() -> None:
    assert Path(urlink_zenoh.__file__).with_name("keys.json").is_file()
