"""Scripts and clients cannot make a mission exceed its bounds."""

from __future__ import annotations

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rhdlink import Mission
from rhdlink.smrcl.commands import COMMANDS
from rhdlink.smrcl.controller import MissionController
from rhdlink.smrcl.interpreter import MissionLimits
from rhdlink.smrcl.profile import MRC, SOUND, Profile
from rhdlink.smrcl.robot_conf import SMR, VELOMEGA
from tests.rhdlink.smrcl.bench import Bench

PROFILES = pytest.mark.parametrize("profile", [SOUND, MRC], ids=lambda profile: profile.name)


@PROFILES
@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ('label "a"\ngoto "a"\n', "endless loop without a wait: 2000 lines in one cycle"),
        ('n=0\nlabel "a"\nn=n+1\nif (1) "a"\n', "endless loop without a wait: 2000 lines in one cycle"),
        ("\n" * 3000, "endless loop without a wait: 2000 lines in one cycle"),
        ('label "a"\ncall "a"\n', "calls are nested too deeply; the maximum is 500"),
        ('array "q" 10000\n', "there is no room for an array of 10000.000000 values; "),
        ('array "q" -1\n', "there is no room for an array of -1.000000 values; "),
        ('label "a"\narray "q" 1000\ngoto "a"\n', "there is no room for an array of 1000.000000 values; "),
        ("return\n", "'return' was executed without a preceding 'call'"),
    ],
)
def test_endless_scripts_are_ended(profile: Profile, source: str, reason: str) -> None:
    bench = Bench("velomega", profile, options={"limits": MissionLimits(lines=2000, calls=500)}).run(source)
    assert bench.reason.startswith(reason)
    assert tuple(bench.written["cmdtransvel"]) == tuple(bench.written["cmdrotvel"]) == (0,)


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("x = 1/0\nfwd x\n", "fwd: parameter 1 has to be a length or an angle of at most 1e+06, not inf"),
        ("turn 1e300\n", f"turn: parameter 1 has to be a length or an angle of at most 1e+06, not {1e300:.6f}"),
        ('set "odowidth" 0', 'set "odowidth" takes a number above 0 of at most 1e+06, not 0.000000'),
        ('x = 0/0\nset "$odoth" x', 'set "$odoth" takes a number of at most 1e+06, not '),
        ('x = 1/0\nsetpar "motioncontrol" "followwall" "gain" x', "setpar of gain takes a number of at most"),
    ],
)
def test_invalid_number_ends_a_sound_mission(source: str, reason: str) -> None:
    assert Bench("differential", SOUND).run(source).reason.startswith(reason)


@pytest.mark.parametrize("x", ["1/0", "0/0", "-1/0"])
@pytest.mark.parametrize(
    "motion",
    [
        *(
            "fwd x",
            "turn x",
            "turnr 0.5 x",
            "turnr x 90",
            "turnc 0.5 x",
            "drive x x x",
            "drivew x 0 0",
            "motorcmds x x",
        ),
        *('followline "bm"', 'followwall "l" x', "drivetopoint 1 0 0 x", "drivetopoint x x x 0.3"),
        *('set "odowidth" 0', 'set "$odoth" x', 'set "odoratio" x', 'set "odoc0" x', 'set "$odocovE2" x'),
    ],
)
def test_invalid_number_raises_no_exception_in_mrc_profile(motion: str, x: str) -> None:
    """Python raises exceptions where C computes nan, for example for the sine of inf or a division by 0."""
    for robot in ("velomega", "differential"):
        bench = Bench(robot, MRC).run(f"x = {x}\nfwd 0.02\n{motion} : ($cmdtime > 0.2)\nfwd 0.05 : ($cmdtime > 0.2)\n")
        assert all(abs(word) <= 2**31 for words in bench.written.values() for word in words)
        assert bench.controller.failure is None or "no way to the goal" in bench.reason


def test_infinite_distance_ends_by_its_condition_in_mrc_profile() -> None:
    bench = Bench("velomega", MRC).run("a = 1\na = 1e308*10\nfwd a : ($drivendist > 0.2)\neval $odox\n")
    assert bench.value == pytest.approx(0.2, abs=0.02)


def test_line_of_a_thousand_operators_is_rejected() -> None:
    (mistake,) = Mission("eval 1" + "+1" * 1000 + "\nfwd 1\n").check()
    assert (mistake.line, mistake.column) == (1, 256)
    assert mistake.message == "the line has 2006 characters; 255 are allowed"


@pytest.mark.slow
def test_number_of_variables_is_limited() -> None:
    bench = Bench("velomega", options={"limits": MissionLimits(lines=30_000)})
    bench.run("".join(f"v{number}x = 1\n" for number in range(10_001)))
    assert bench.reason == "there is no room for more variables"


@pytest.mark.slow
def test_failure_is_marked_as_limit_if_a_bound_ended_the_script() -> None:
    bench = Bench().run('label "a"\ngoto "a"\n')
    assert bench.controller.failure is not None
    assert bench.controller.failure.is_limit


@PROFILES
@pytest.mark.parametrize("speed", ["1e300", "x"])
def test_written_speeds_are_always_valid_numbers(profile: Profile, speed: str) -> None:
    bench = Bench("velomega", profile).run(f"x = 0/0\nmotorcmds {speed} {speed}\nwait 0.1\n", cycles=40)
    assert all(abs(word) <= 2**31 for words in bench.written.values() for word in words)


@PROFILES
def test_line_is_parsed_in_bounded_time(profile: Profile) -> None:
    """The time must not depend on the depth of nesting or on the size of numbers."""
    lines = ["eval " + "-" * 240 + "1", "eval " + "(" * 120 + "1" + ")" * 120, "eval rem(1e300,1) ; sin(1e300)"]
    lines += ["eval normalizeangledeg(1e200) ; 2^2^2^2^2^2^2 ; exp(exp(exp(10)))", "eval " + "1+" * 120 + "1"]
    for line in lines:
        began = time.process_time()
        Bench("velomega", profile).run(f"{line}\n", cycles=30)
        assert time.process_time() - began < 2.0


# -- random programs ------------------------------------------------------------------------------------------

numbers = st.one_of(
    st.sampled_from(["0", "1", "-1", "0.02", "90", "1e9", "-0.5", "x", "$odox", "q"]),
    st.floats(min_value=-2, max_value=2).map(lambda value: f"{value:.3f}"),
)
values = st.sampled_from(
    ["x", "q[x]", "$odox", "1/0", "rem(x,2)", "x+1", "ntrue(1,x)", "$condition", "sqrt(-1)", "q[9]", "(x>1) & (x<9)"]
)
texts = st.sampled_from(
    ['"a"', '"b"', '"x"', '"q[1]"', '"$odox"', '"abs"', '"rad"', '"cmdrotvel"', '"bm"', '"l"', '"r"']
)
conditions = st.one_of(st.just(""), st.just(" : ($cmdtime > 0.05)"), values.map(lambda value: f" : ({value})"))
commands = st.builds(
    lambda name, parameters, condition: f"{name} {' '.join(parameters)}{condition}",
    st.sampled_from(sorted(COMMANDS)),
    st.lists(st.one_of(numbers, texts), max_size=4),
    conditions,
)
free = st.one_of(
    values.map(lambda value: f"x = {value}"),
    st.builds(lambda index, value: f"q[{index}] = {value}", values, values),
    values.map(lambda value: f'if ({value}) "a"'),
    values.map(lambda value: f"eval {value}"),
    values.map(lambda value: f"switch ({value})"),
    st.sampled_from(["case 1", "case 2", "endswitch", 'label "a"', 'label "b"', 'goto "b"', 'call "a"', "return", ""]),
    st.sampled_from([": (x > 3)", ": (1)", "% nothing", "fwd 0.02", "wait 0.02", "turn 3", "idle", "stop"]),
    st.text(st.characters(codec="latin-1"), max_size=20),
)
programs = st.lists(st.one_of(free, commands), max_size=12).map(
    lambda lines: "\n".join(["x = 1", 'array "q" 3', *lines])
)


@PROFILES
@pytest.mark.parametrize("robot", ["velomega", "differential"])
@pytest.mark.property
@given(source=programs)
def test_random_programs_stay_within_their_bounds(robot: str, profile: Profile, source: str) -> None:
    bench = Bench(robot, profile, options={"limits": MissionLimits(lines=300, calls=20)})
    began = time.process_time()
    bench.run(source, cycles=120)
    assert time.process_time() - began < 10.0
    for words in bench.written.values():
        assert all(-(2**31) <= word < 2**31 for word in words)
    assert len(bench.controller.vehicle.symbols.pool) == 10_000
    if bench.controller.is_finished:
        assert all(bench.written[name][0] == 0 for name in bench.controller.vehicle.conf.writes)


hostile = st.lists(
    st.one_of(
        free,
        commands,
        st.sampled_from(
            [
                "eval x",
                "eval 1;2",
                "eval",
                "getevent",
                "getevent 1e9",
                "getevent -1",
                "flushcmds",
                "beginplan p",
                "endplan",
            ]
        ),
        st.sampled_from(
            ["plan fwd 1", "runplan p", "deleteplan p", 'set "xmlon" 1', 'setvar "x" 2', "stream 0", "logoff"]
        ),
        st.sampled_from(
            [
                *('set "odowidth" 0', 'set "odoratio" -1', 'set "$odoth" x', 'set "odoc0" q', "x = 1/0", "fwd x"),
                *("drivetopoint 1 0 0 0.3", "drivetopoint -1 0 0 0", 'setpar "motioncontrol" "followwall" "tau" x'),
                *('setpar "motioncontrol" "drivetopoint" "evalmethod" 1', 'addwatch "v" 1 : (q[9])'),
                *('routeinput "mrc" "mrccontrol" "stop" "$odox"', 'control "savelog" "../x"', 'log "$odox"'),
            ]
        ),
        st.sampled_from(['stream 1 "$odox"', "stream -1", "laserscan", "exitx", 'addwatch "w" 1 : (x)', 'goto "a"']),
    ),
    max_size=20,
)


@PROFILES
@pytest.mark.property
@given(
    chunks=st.lists(
        st.one_of(st.binary(max_size=60), hostile.map(lambda lines: "\n".join(lines).encode("latin-1"))), max_size=8
    )
)
def test_random_clients_stay_within_their_bounds(profile: Profile, chunks: list[bytes]) -> None:
    bench = Bench("velomega", profile, options={"limits": MissionLimits(lines=300, calls=20)})
    dialogue = bench.controller.serve()
    bench.run(cycles=23)
    sessions = [dialogue.connect(), dialogue.connect()]
    for number, chunk in enumerate(chunks):
        session = sessions[number % 2]
        session.receive(chunk + b"\n")
        is_ended_by_exit = profile is MRC and b"\nexit" in b"\n" + chunk.replace(b"\r", b"\n")
        if not bench.cycle():
            break
        bench.run(cycles=5)
        assert bench.controller.failure is None
        assert not bench.controller.is_finished or profile is MRC or is_ended_by_exit
        assert isinstance(session.take(), bytes)
        assert len(dialogue.queue) <= 400
    for session in sessions:
        dialogue.disconnect(session)
    bench.run(cycles=5)
    assert dialogue.sessions == []


@pytest.mark.property
@given(
    counters=st.lists(st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(-(2**31), 2**31 - 1)), max_size=30),
    is_smr=st.booleans(),
)
def test_pose_stays_finite_for_any_counters(counters: list[tuple[int, int]], is_smr: bool) -> None:
    conf = SMR if is_smr else VELOMEGA
    names = conf.reads
    controller = MissionController(conf, {"tick": 1, **dict.fromkeys(names, 1)}, {name: [0] for name in conf.writes})
    controller.load("drive\n")
    for tick, pair in enumerate(counters):
        written = controller.step({"tick": [tick], **{name: [count] for name, count in zip(names, pair, strict=True)}})
        assert all(isinstance(word, int) for words in written.values() for word in words)
    pose = controller.vehicle.odometry.pose
    assert all(map(math.isfinite, (pose.x, pose.y, pose.th)))
    assert abs(pose.th) <= math.pi + 1e-9
