"""Robots over Zenoh: each test has a router, a server and a client, with separate sessions over TCP."""

from __future__ import annotations

import contextlib
import itertools
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

import urlink
from tests.waiting import until
from urlink.simulator import Controller
from urlink_zenoh import Collector, RemoteRobot, Sample, Server, open_session, robots
from urlink_zenoh.commands import Kind
from urlink_zenoh.expiry import Expiry
from urlink_zenoh.keys import attachment, stamped
from urlink_zenoh.publication import Publication

#: Marks of the simulated arm of these tests. The limits are long because a busy machine causes silence and delays.
pytestmark = pytest.mark.urlink(
    model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
)

HOME = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
FAR = [1.5, -1.5, 1.5, -1.5, -1.5, 0.0]


@pytest.mark.property
@given(st.integers(0, 2**64 - 1), st.integers(0, 2**40), st.integers(0, 2**40))
def test_attachment_keeps_number_and_stamp(sequence: int, monotonic: int, wall: int) -> None:
    stamp = urlink.packets.Stamp(monotonic / 1024, wall / 1024)
    number, read = stamped(attachment(sequence, stamp))
    assert number == sequence
    assert read == pytest.approx(stamp, abs=1e-6)


def test_client_reads_robot(server: Server, session: zenoh.Session, urlink_robot: urlink.Robot) -> None:
    assert robots(session) == ["arm"]
    came: list[Sample] = []
    with RemoteRobot(session, "arm") as remote, remote.watch(came.append) as watch:
        until(lambda: len(came) > 200)
        seen = came[-1].state.to_dict()["time"]
        assert remote.latest.time >= seen
        until(lambda: "q" in remote.status)
        status, info = remote.status, remote.info
    assert {sample.robot for sample in came} == {"arm"}
    # All published packets arrive in order, with the time at which the server received each of them.
    assert [sample.sequence for sample in came] == list(range(came[0].sequence, came[0].sequence + len(came)))
    assert all(before.received <= after.received for before, after in itertools.pairwise(came))
    assert (watch.missed, watch.failed) == (0, 0)
    assert (status["connection"], status["safety_mode"], status["refusal"]) == ("connected", "NORMAL", None)
    assert (info["model"], info["firmware"]) == ("UR5e", "5.11")
    # The description is sufficient to read a packet without the library.
    field = next(field for field in info["realtime"]["fields"] if field["name"] == "q_actual")
    state = came[-1].state
    assert isinstance(state, urlink.packets.RealtimeState)
    read = np.frombuffer(bytes(state), field["type"], field["count"], field["offset"])
    assert read.tolist() == state.q_actual.tolist()


def test_server_publishes_primary_and_limits_realtime_rate(
    router: zenoh.Session, endpoint: str, session: zenoh.Session, urlink_robot: urlink.Robot
) -> None:
    states: list[Sample] = []
    packages: list[Sample] = []
    with (
        open_session([endpoint]) as other,
        Server(other, {"arm": urlink_robot}, prefix="hall/3", rate=50.0),
        RemoteRobot(session, "arm", prefix="hall/3") as remote,
        remote.watch(packages.append, "primary"),
        remote.watch(states.append),
    ):
        until(lambda: len(packages) > 5 and len(states) > 20)
    times = [sample.state.to_dict()["time"] for sample in states]
    assert np.diff(times) == pytest.approx(0.02, abs=1e-6)
    assert any(isinstance(sample.state, urlink.packets.RobotState) for sample in packages)


@pytest.mark.parametrize("rate", [None, 100.0])
def test_packets_dropped_by_server_queue_are_numbered(
    router: zenoh.Session,
    endpoint: str,
    session: zenoh.Session,
    urlink_robot: urlink.Robot,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    rate: float | None,
) -> None:
    samples: list[Sample] = []
    goes_on, is_held = threading.Event(), threading.Event()
    goes_on.set()
    put = Publication.put

    def hold(publication: Publication, payload: bytes, *rest: Any) -> None:
        if len(payload) > 1000 and not goes_on.is_set():
            is_held.set()
            goes_on.wait(30)
        put(publication, payload, *rest)

    monkeypatch.setattr(Publication, "put", hold)
    with (
        open_session([endpoint]) as ours,
        Server(ours, {"arm": urlink_robot}, rate=rate, interfaces=("realtime",)),
        Collector(session, tmp_path) as collector,
        RemoteRobot(session, "arm") as remote,
        remote.watch(samples.append) as watch,
    ):
        until(lambda: len(samples) > 20 and "arm" in collector.robots)
        goes_on.clear()
        assert is_held.wait(10)
        held = urlink_robot.realtime.stats.received
        until(lambda: urlink_robot.realtime.stats.received > held + 500)  # the queue holds 256 packets
        goes_on.set()
        until(lambda: watch.missed)
        count = len(samples)
        until(lambda: len(samples) > count + 20 and collector.robots["arm"].packets > count)
        robot = collector.robots["arm"]
    times = [sample.state.to_dict()["time"] for sample in samples]
    # A drop of the queue may be counted at the packet before or after it, but all drops are counted in the end.
    span = round((times[-1] - times[0]) * (rate or 500))
    assert samples[-1].sequence - samples[0].sequence == pytest.approx(span, abs=1)
    assert watch.missed == samples[-1].sequence - samples[0].sequence + 1 - len(samples) > (rate or 500) / 5
    assert robot.missing == pytest.approx(robot.missed, abs=1)
    run = urlink.load(robot.path)
    assert sum(gap.cycles for gap in run.realtime.gaps) >= robot.missing > (rate or 500) / 5


def test_client_moves_robot_and_sets_outputs(
    server: Server, session: zenoh.Session, urlink_robot: urlink.Robot
) -> None:
    with RemoteRobot(session, "arm") as remote:
        done = remote.call("move_joints", q=np.array(HOME), wait=True)
        assert (done["phase"], done["progress"]) == ("done", 1.0)
        assert urlink_robot.realtime.wait().q_actual == pytest.approx(HOME, abs=1e-3)
        remote.call("set_digital_out", number=3, on=True)
        assert urlink_robot.io.digital_out(3)
        begun = remote.call("follow", time=[0, 2], q=[HOME, FAR], watchdog=5.0, wait=False)
        until(lambda: remote.status["motion"] is not None and remote.status["motion"]["progress"] > 0.1)
        remote.call("stop")
        until(lambda: np.abs(urlink_robot.realtime.wait().qd_actual).max() < 1e-3)
        assert begun["phase"] in ("sent", "running")
        assert 0.01 < urlink_robot.realtime.wait().q_actual[0] < 1.4


@pytest.mark.parametrize(
    ("command", "arguments", "says"),
    [
        ("move_joints", {"q": [0, 1]}, "q has the shape"),
        ("move_joints", {"q": HOME, "wait_": 1}, "unexpected keyword argument"),
        ("move_joints", {"q": ["a"] * 6}, "q"),
        ("move_joints", {}, "missing a required argument"),
        ("follow", {"time": [0, 1], "q": [HOME, FAR], "feedback": "x"}, "unexpected argument 'feedback'"),
        ("close", {}, "unknown command 'close'"),
    ],
)
def test_bad_arguments_raise_same_errors_as_local_robot(
    server: Server,
    session: zenoh.Session,
    urlink_robot: urlink.Robot,
    command: str,
    arguments: dict[str, Any],
    says: str,
) -> None:
    with RemoteRobot(session, "arm") as remote, pytest.raises(urlink.BadValue, match=says):
        remote.call(command, **arguments)
    assert urlink_robot.motion.current is None


def test_commands_pass_the_interlock(
    server: Server, session: zenoh.Session, urlink_controller: Controller, urlink_robot: urlink.Robot
) -> None:
    urlink_robot.safety.policy = "always"
    with RemoteRobot(session, "arm") as remote:
        with pytest.raises(urlink.NotEnabled):
            remote.call("move_joints", q=HOME)
        remote.call("enable")
        remote.call("move_joints", q=FAR, speed=0.2)
        until(lambda: np.abs(urlink_robot.realtime.wait().qd_actual).max() > 0.05)
        urlink_controller.faults.protective_stop()
        until(lambda: urlink_robot.motion.current is None)
        with pytest.raises(urlink.SafetyStop) as stop:
            remote.call("move_joints", q=HOME)
        assert stop.value.cause == "protective stop"
        until(lambda: "protective stop" in (remote.status["refusal"] or ""))


def test_client_sets_payload_and_gravity(
    server: Server, session: zenoh.Session, urlink_controller: Controller, urlink_robot: urlink.Robot
) -> None:
    with RemoteRobot(session, "arm") as remote:
        remote.call("set_payload", mass=1.5, cog=[0.0, 0.0, 0.05])
        remote.call("set_gravity", acceleration=[0.0, 9.82, 0.0])
        until(lambda: list(urlink_controller.arm.gravity) == [0.0, 9.82, 0.0])
        assert urlink_controller.arm.payload == 1.5


def test_motion_needs_live_client_and_is_not_preempted(
    server: Server, session: zenoh.Session, urlink_robot: urlink.Robot
) -> None:
    with RemoteRobot(session, "arm") as first, RemoteRobot(session, "arm") as second:
        first.call("move_joints", q=FAR, speed=0.2)
        with pytest.raises(urlink.LocalError, match=first.client):
            second.call("move_joints", q=HOME)
        second.call("cancel")  # any client may stop it
        until(lambda: urlink_robot.motion.current is None)
        second.call("move_joints", q=HOME, speed=0.2)
        second.close()
        until(lambda: urlink_robot.motion.current is None)
        with pytest.raises(urlink.LocalError, match="is not alive"):
            second.call("move_joints", q=HOME)
    replies = list(session.get("urlink/v1/arm/command/move_joints", payload=b'{"q": [0,0,0,0,0,0]}', timeout=2.0))
    assert b"needs a client" in bytes(replies[0].err.payload) if replies[0].err else False
    assert urlink_robot.motion.current is None


_MOVE = """
import sys, time, urlink_zenoh
session = urlink_zenoh.open_session([sys.argv[1]])
robot = urlink_zenoh.RemoteRobot(session, "arm")
robot.call("move_joints", q=[1.5, -1.5, 1.5, -1.5, -1.5, 0.0], speed=0.1)
print("moving", flush=True)
time.sleep(60)
"""


def test_motion_is_cancelled_when_client_process_dies(
    server: Server, endpoint: str, urlink_robot: urlink.Robot
) -> None:
    process = subprocess.Popen([sys.executable, "-c", _MOVE, endpoint], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "moving\n"
        until(lambda: np.abs(urlink_robot.realtime.wait().qd_actual).max() > 0.05)
        motion = urlink_robot.motion.current
        assert motion is not None
        process.kill()
        until(lambda: motion.done, 5.0)
        assert isinstance(motion.error, urlink.Cancelled)
        until(lambda: np.abs(urlink_robot.realtime.wait().qd_actual).max() < 1e-3)
        assert urlink_robot.realtime.wait().q_actual[0] < 1.4
    finally:
        process.kill()
        process.communicate()


_ROUTER = """
import sys, urlink_zenoh
with urlink_zenoh.open_session(listen=[sys.argv[1]], mode="router"):
    print("up", flush=True)
    sys.stdin.read()
"""

_SERVER = """
import sys, urlink, urlink_zenoh
from urlink.simulator import Controller, Still
with (
    Controller("UR5e", "5.11", motion=Still()) as controller,
    urlink.connect(controller.address) as robot,
    urlink_zenoh.open_session([sys.argv[1]]) as session,
    urlink_zenoh.Server(session, {"arm": robot}),
):
    print("up", flush=True)
    sys.stdin.read()
"""


@contextlib.contextmanager
def running(program: str, endpoint: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-c", program, endpoint]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("who", "when", "wait"),
    [
        ("router", "before clock query", False),
        ("router", "before command", True),
        ("server", "before command", False),
    ],
)
def test_abandoned_command_is_not_executed_later(
    endpoint: str, monkeypatch: pytest.MonkeyPatch, who: str, when: str, wait: bool
) -> None:
    seen: list[Sample] = []
    with (
        running(_ROUTER, endpoint) as router,
        running(_SERVER, endpoint) as server,
        open_session([endpoint]) as ours,
        RemoteRobot(ours, "arm", timeout=1.5) as remote,
        remote.watch(seen.append),
    ):
        suspended = router if who == "router" else server
        until(lambda: seen, 30.0)
        remote.call("set_digital_out", number=1, on=True)
        start = remote.latest.q_actual
        target = [float(start[0] + 0.8), *start[1:].tolist()]
        asked = remote._asked

        def asked_and_suspended(what: str) -> dict[str, Any]:
            answer = asked(what)
            if what == "clock" and when == "before command":
                suspended.send_signal(signal.SIGSTOP)
            return answer

        monkeypatch.setattr(remote, "_asked", asked_and_suspended)
        if when != "before command":
            suspended.send_signal(signal.SIGSTOP)
        began = time.monotonic()
        with pytest.raises(urlink.LinkTimeout):
            remote.call("move_joints", q=target, wait=1.5 if wait else False)
        while time.monotonic() < began + 4.0:
            time.sleep(0.05)
        monkeypatch.setattr(remote, "_asked", asked)
        suspended.send_signal(signal.SIGCONT)
        # Delayed commands are executed or rejected before later ones.
        until(lambda: answers(remote), 20.0)
        received = len(seen)
        until(lambda: len(seen) > received + 500, 20.0)
        assert remote.status["motion"] is None
        assert remote.latest.q_actual == pytest.approx(start, abs=1e-3)
        assert max(abs(sample.state.to_dict()["q_actual"][0] - start[0]) for sample in seen) < 1e-3
        # The rejection does not last: a new command is executed.
        assert remote.call("move_joints", q=target, wait=30.0)["phase"] == "done"
        assert remote.latest.q_actual == pytest.approx(target, abs=1e-2)


def answers(remote: RemoteRobot) -> bool:
    """Whether the robot answers and accepts commands."""
    try:
        remote.call("set_digital_out", number=1, on=False)
    except urlink.LinkError:
        return False
    return True


def test_motion_is_cancelled_when_wait_times_out(
    server: Server, session: zenoh.Session, urlink_robot: urlink.Robot
) -> None:
    with RemoteRobot(session, "arm") as remote:
        with pytest.raises(urlink.LinkTimeout, match=r"did not finish within 0\.5 s"):
            remote.call("move_joints", q=FAR, speed=0.1, wait=0.5)
        until(lambda: urlink_robot.motion.current is None)
        assert remote.call("move_joints", q=HOME, wait=True)["phase"] == "done"


def test_expiry_rejects_late_unknown_and_abandoned_commands() -> None:
    now = 100.0
    expiry = Expiry(lambda: now)
    told = expiry.described()
    good = {"server": str(told["server"]), "time": repr(told["time"]), "age": "5", "command": "a"}
    expiry.check(good)
    now = 105.0
    expiry.check(good)
    now = 105.1
    with pytest.raises(urlink.LinkTimeout, match=r"5\.1 s after .* was not executed"):
        expiry.check(good)
    now = 101.0
    with pytest.raises(urlink.LocalError, match="for an earlier server"):
        Expiry(lambda: now).check(good)
    expiry.give_up("a")
    with pytest.raises(urlink.LocalError, match="client abandoned the command"):
        expiry.check(good)
    expiry.check({**good, "command": "b"})
    with pytest.raises(urlink.LinkTimeout):
        expiry.check({**good, "command": "b", "time": "101.5"})


@pytest.mark.parametrize(
    "parameters",
    [
        {"command": None},
        {"server": None},
        {"time": "soon"},
        {"time": "nan"},
        {"time": None},
        {"age": "0"},
        {"age": "61"},
        {"age": "inf"},
    ],
)
def test_expiry_rejects_missing_or_invalid_parameters(parameters: dict[str, str | None]) -> None:
    expiry = Expiry(lambda: 1.0)
    good = {"server": str(expiry.described()["server"]), "time": "1.0", "age": "5", "command": "a"}
    expiry.check(good)
    with pytest.raises(urlink.BadValue, match=r"expected|needs"):
        expiry.check({**good, **parameters})


def test_cancel_with_an_id_cancels_only_that_command(
    server: Server, session: zenoh.Session, urlink_robot: urlink.Robot
) -> None:
    with RemoteRobot(session, "arm") as remote:
        remote.call("move_joints", q=FAR, speed=0.1)
        remote.call("cancel", command="another")
        motion = urlink_robot.motion.current
        assert motion is not None
        assert not motion.done
        with pytest.raises(urlink.BadValue, match="cancel got"):
            remote.call("cancel", command=3)
        remote.call("cancel")
        until(lambda: motion.done)


def test_motion_ends_and_recording_resumes_when_router_restarts(
    endpoint: str, urlink_robot: urlink.Robot, tmp_path: Path
) -> None:
    router = open_session(listen=[endpoint], mode="router")
    with (
        open_session([endpoint]) as ours,
        open_session([endpoint]) as theirs,
        Server(ours, {"arm": urlink_robot}),
        Collector(theirs, tmp_path) as collector,
        RemoteRobot(theirs, "arm") as remote,
    ):
        until(lambda: "arm" in collector.robots)
        remote.call("move_joints", q=FAR, speed=0.1)
        motion = urlink_robot.motion.current
        assert motion is not None
        router.close()
        # No client can reach the robot now, so no client could stop it.
        until(lambda: motion.done, 5.0)
        assert isinstance(motion.error, urlink.Cancelled)
        with open_session(listen=[endpoint], mode="router"):
            until(lambda: robots(theirs) == ["arm"], 15.0)
            before = collector.robots["arm"].packets
            until(lambda: collector.robots["arm"].packets > before + 100, 15.0)
            assert remote.call("move_joints", q=HOME, wait=True)["phase"] == "done"
        found = collector.robots["arm"]
    # Packets that were published in the meantime are lost, and are counted.
    assert found.missed > 0
    assert found.restarts == 0
    with urlink.connect(f"replay://{found.path}?rate=0") as recording:
        states = recording.realtime.iterate(urlink.block)
        assert sum(1 for _ in states) == found.packets
        assert (recording.model, str(recording.firmware)) == ("UR5e", "5.11")


@pytest.mark.urlink(connect={})
def test_packets_resume_when_robot_reconnects(
    server: Server, session: zenoh.Session, urlink_controller: Controller, urlink_robot: urlink.Robot
) -> None:
    events: list[str] = []
    came: list[Sample] = []
    listener = session.declare_subscriber("urlink/v1/arm/connection", lambda sample: events.append(str(sample.payload)))
    with RemoteRobot(session, "arm") as remote, remote.watch(came.append):
        until(lambda: came)
        urlink_controller.faults.reboot()
        until(lambda: any('"lost"' in event and "realtime" in event for event in events))
        seen = len(came)
        until(lambda: len(came) > seen + 50, 30.0)
        until(lambda: remote.status["age"] < 0.5)
    listener.undeclare()
    assert any('"connected"' in event for event in events)


def test_server_rejects_name_in_use_and_invalid_name(
    server: Server, session: zenoh.Session, urlink_robot: urlink.Robot
) -> None:
    with pytest.raises(urlink.LocalError, match="already served"):
        Server(session, {"arm": urlink_robot})
    with pytest.raises(urlink.BadValue, match="part of a key"):
        Server(session, {"a/b": urlink_robot})


def test_read_only_robot_accepts_no_commands(
    router: zenoh.Session, endpoint: str, session: zenoh.Session, urlink_controller: Controller
) -> None:
    with (
        urlink.connect(urlink_controller.address, read_only=True) as robot,
        open_session([endpoint]) as ours,
        Server(ours, {"arm": robot}),
        RemoteRobot(session, "arm", timeout=1.0) as remote,
    ):
        assert remote.info["commands"] == []
        with pytest.raises(urlink.LinkTimeout):
            remote.call("move_joints", q=HOME)


def test_command_line_serves_robots_until_terminated(
    router: zenoh.Session, endpoint: str, session: zenoh.Session
) -> None:
    command = ["serve", "zenoh", "left=sim://ur5e", "right=sim://ur10", "--connect", endpoint, "--rate", "20"]
    process = subprocess.Popen(
        [sys.executable, "-c", "import sys, urlink.cli; sys.exit(urlink.cli.main())", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "serving left, right over zenoh; Ctrl-C ends it\n"
        assert robots(session) == ["left", "right"]
        with RemoteRobot(session, "right") as remote:
            assert remote.info["model"] == "UR10"
        there, gone = threading.Event(), threading.Event()

        def note(sample: zenoh.Sample) -> None:
            (there if sample.kind == zenoh.SampleKind.PUT else gone).set()

        session.liveliness().declare_subscriber("urlink/v1/left/alive", note, history=True)
        # The router knows the subscriber now, and will notify it.
        assert there.wait(20.0)
        process.send_signal(signal.SIGTERM)
        assert process.wait(10.0) == 128 + signal.SIGTERM
        assert gone.wait(20.0)
    finally:
        process.kill()
        process.communicate()


def test_calls_time_out_without_server(session: zenoh.Session) -> None:
    began = time.monotonic()
    with RemoteRobot(session, "nobody", timeout=0.5) as remote:
        for ask in (lambda: remote.info, lambda: remote.latest, lambda: remote.call("stop")):
            with pytest.raises(urlink.LinkTimeout):
                ask()
    assert time.monotonic() - began < 5.0


@pytest.mark.parametrize("name", ["stop", "cancel"])
def test_motion_does_not_start_after_later_stop(
    server: Server, session: zenoh.Session, urlink_robot: urlink.Robot, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_asked, may_go_on = threading.Event(), threading.Event()
    errors: list[Exception] = []
    with RemoteRobot(session, "arm") as remote:
        asked = remote._asked

        def held(what: str) -> dict[str, Any]:
            is_asked.set()
            assert may_go_on.wait(30.0)
            return asked(what)

        def move() -> None:
            try:
                remote.call("move_joints", q=FAR)
            except urlink.LinkError as error:
                errors.append(error)

        monkeypatch.setattr(remote, "_asked", held)
        mover = threading.Thread(target=move)
        mover.start()
        assert is_asked.wait(30.0)
        remote.call(name)
        may_go_on.set()
        mover.join(30.0)
    assert [type(error) for error in errors] == [urlink.Cancelled]
    assert urlink_robot.motion.current is None or urlink_robot.motion.current.name == "stop"


@pytest.mark.parametrize("name", ["stop", "cancel"])
def test_queued_motion_does_not_start_after_later_stop(
    server: Server, session: zenoh.Session, urlink_robot: urlink.Robot, name: str
) -> None:
    served = server._served[0]
    is_busy, may_go_on = threading.Event(), threading.Event()

    def occupy() -> None:
        is_busy.set()
        may_go_on.wait(30.0)

    served._lanes[Kind.MOTION].submit(occupy)
    assert is_busy.wait(30.0)
    errors: list[Exception] = []

    def move(remote: RemoteRobot) -> None:
        try:
            remote.call("move_joints", q=FAR)
        except urlink.LinkError as error:
            errors.append(error)

    with RemoteRobot(session, "arm") as one, RemoteRobot(session, "arm") as another:
        mover = threading.Thread(target=move, args=(one,))
        mover.start()
        until(lambda: served._requested)
        another.call(name)
        may_go_on.set()
        mover.join(30.0)
    assert [type(error) for error in errors] == [urlink.Cancelled]
