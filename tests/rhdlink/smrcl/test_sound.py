"""Fixes of the sound profile, compared with the behaviour of the original."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import pytest

import rhdlink.smrcl
from rhdlink.errors import BadMission
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.smrcl.mission import Mission
from rhdlink.smrcl.profile import BOTH, MRC, SOUND, Profile, differences, find_profile
from rhdlink.smrcl.recipients import SaidKind
from rhdlink.smrcl.robot_conf import SMR
from tests.rhdlink.smrcl.bench import Bench

ROBOTS = pytest.mark.parametrize("robot", ["velomega", "differential"])


# -- the table of differences -------------------------------------------------------------------------------


def test_every_difference_is_described_and_used() -> None:
    sources = "".join(
        path.read_text(encoding="utf-8")
        for path in Path(rhdlink.smrcl.__file__).parent.rglob("*.py")
        if path.name != "profile.py"
    )
    assert len(differences()) > 15
    for difference in differences():
        assert re.search(rf"\.{difference.name}\b", sources), f"{difference.name} makes no difference"
        assert difference.mrc
        assert difference.sound
        assert getattr(SOUND, difference.name) is not getattr(MRC, difference.name)
    assert all(mrc and ours for mrc, ours in BOTH)


def test_profiles_are_found_by_name() -> None:
    assert find_profile("mrc") is MRC
    mixed = dataclasses.replace(SOUND, full_turns=False)
    assert find_profile(mixed) is mixed
    with pytest.raises(ValueError, match="expected 'sound', 'mrc'"):
        find_profile("MRC")


# -- motions ------------------------------------------------------------------------------------------------


@ROBOTS
def test_turnr_ends_at_its_angle(robot: str) -> None:
    sound = Bench(robot).run("turnr 0.5 90\nwait 3\n")
    assert sound.pose[2] == pytest.approx(90.0, abs=2.0)
    assert sound.pose[:2] == pytest.approx((0.5, 0.51), abs=0.01)
    assert abs(sound.speeds[-1][0]) == 0.0
    mrc = Bench(robot, "mrc").run("turnr 0.5 90\nwait 3\n")
    assert math.dist(mrc.pose[:2], (0.5, 0.5)) > 0.3
    assert mrc.pose[2] > 180.0


@ROBOTS
def test_turnr_continues_into_the_next_motion_at_full_speed(robot: str) -> None:
    bench = Bench(robot).run("turnr 0.5 90\ndrive : ($drivendist > 0.3)\n")
    moving = [speed for speed, _ in bench.speeds if speed > 0.0]
    fastest = moving.index(max(moving))
    assert min(moving[fastest:-2]) > 0.28


@ROBOTS
def test_stop_command_stops_the_robot_in_sound_profile(robot: str) -> None:
    source = "turnr 0.5 90\nstop\nwait 5\neval $odox\n"
    sound = Bench(robot).run(source)
    assert math.dist(sound.pose[:2], (0.5, 0.5)) < 0.02
    assert sound.pose[2] == pytest.approx(90.0, abs=0.5)
    mrc = Bench(robot, "mrc").run(source)
    drifted = math.dist(mrc.pose[:2], (0.5, 0.5))
    assert (drifted > 1.0) if robot == "velomega" else (drifted < 0.02)


@ROBOTS
def test_sign_of_the_speed_does_not_affect_a_turn(robot: str) -> None:
    """MRC decelerates through 0 to a negative speed, and turns by its absolute value."""
    source = "fwd 1 : ($drivendist > 0.3)\nturn 90 @v -0.3\n"
    slowest = {}
    for profile in ("sound", "mrc"):
        bench = Bench(robot, profile).run(source)
        turning = [rate for _, rate in bench.speeds if rate > 0.0]
        slowest[profile] = min(turning[:60])
        assert bench.pose[2] == pytest.approx(90.0, abs=1.0)
    assert slowest["sound"] > 1.0
    assert slowest["mrc"] < 1.0


@ROBOTS
@pytest.mark.parametrize("angle", [180, 270, -200, 720])
def test_turn_beyond_180_degrees_is_not_shortened(robot: str, angle: int) -> None:
    assert Bench(robot).run(f"turn {angle}\nwait 1\n").pose[2] == pytest.approx(angle, abs=0.3)
    mrc = Bench(robot, "mrc").run(f"turn {angle}\nwait 1\n").pose[2]
    assert mrc == pytest.approx(math.degrees(math.remainder(math.radians(angle), math.tau)), abs=0.3)


@ROBOTS
def test_turn_by_180_degrees_ends_after_a_stall(robot: str) -> None:
    """The stall of ten ticks is just before the end: the heading wraps, and the error of MRC jumps by a full turn."""

    def stalled(profile: str) -> Bench:
        bench = Bench(robot, profile).load("turn 180 @v 0.3\n")
        bench.run_until(lambda: math.radians(bench.pose[2]) > math.pi - 0.06)
        for _ in range(10):
            bench.link.exchange({})
        return bench.run(cycles=2000)

    assert stalled("sound").is_over
    # A velocity-omega robot creeps back across the wrap of the heading; wheels have steps of 1 cm/s and do not.
    assert stalled("mrc").controller.is_finished == (robot == "velomega")


@pytest.mark.slow
@ROBOTS
def test_drivetopoint_works_at_any_initial_speed(robot: str) -> None:
    """The first arc of this path is short and goes backwards."""
    source = 'fwd 1 : ($drivendist > 0.5)\ndrivetopoint 0 0 180 0.3 "abs"\nwait 0.5\neval $odox\n'
    goal = {profile: Bench(robot, profile).run(source).pose for profile in ("sound", "mrc")}
    assert math.hypot(*goal["sound"][:2]) < 0.1
    assert math.cos(math.radians(goal["sound"][2] - 180.0)) > 0.99
    assert math.hypot(*goal["mrc"][:2]) > math.hypot(*goal["sound"][:2])


@ROBOTS
def test_drivetopoint_keeps_the_sign_of_the_speed(robot: str) -> None:
    source = "drivetopoint -0.5 0 0 0.3 @v 0.25\nidle\nwait 0.2\ndrive : ($cmdtime > 1)\n"
    forward = Bench(robot).run(source).speeds[-3][0]
    backward = Bench(robot, "mrc").run(source).speeds[-3][0]
    assert forward > 0.2
    assert backward < -0.2


@pytest.mark.slow
def test_drivetopoint_does_not_depend_on_earlier_motions() -> None:
    source = "fwd 0.4\nidle\nwait 0.3\ndrivetopoint 2 0.5 0 0.3\nidle\nwait 0.1\n"
    sound, mrc = (Bench("differential", profile).run(source).pose for profile in ("sound", "mrc"))
    assert math.dist(sound[:2], (2.4, 0.5)) < 0.1
    assert math.dist(mrc[:2], (2.4, 0.5)) > 0.2


@pytest.mark.parametrize("profile", ["sound", "mrc"])
def test_drivetopoint_honours_the_forward_only_option(profile: str) -> None:
    source = 'setpar "motioncontrol" "drivetopoint" "evalmethod" 1\ndrivetopoint -1 0 0 0.3\n'
    speeds = [speed for speed, _ in Bench("velomega", profile).run(source).speeds]
    assert (min(speeds) >= 0.0) == (profile == "sound")


def test_motorcmds_and_turnc_steer_a_velocity_omega_robot() -> None:
    source = "motorcmds 0.1 0.2\nwait 1\neval $odoth\n"
    assert Bench("velomega").run(source).value == pytest.approx(0.1 / 0.26, abs=0.02)
    assert Bench("velomega", "mrc").run(source).value == 0.0
    arc = "turnc 0.5 90\nidle\nwait 0.1\neval $odoth\n"
    assert Bench("velomega").run(arc).value == pytest.approx(math.pi / 2, abs=0.05)
    assert Bench("velomega", "mrc").run(arc).value == 0.0


def test_outputs_are_rounded_symmetrically_around_zero() -> None:
    sent = {}
    for profile in ("sound", "mrc"):
        bench = Bench("differential", profile).run("motorcmds -0.255 0.255\nwait 0.1\n", cycles=30)
        sent[profile] = tuple(bench.written["speedl"]) + tuple(bench.written["speedr"])
    assert sent["sound"] == (-26, 26)
    assert sent["mrc"] == (-25, 26)
    bench = Bench("velomega").run('setoutput "cmdtransvel" -3\n', cycles=25)
    assert bench.controller.failure is None


def test_robot_without_infrared_sensors_sees_no_obstacle() -> None:
    for profile, moves in (("sound", True), ("mrc", False)):
        bench = Bench("differential", profile)
        vehicle = bench.controller.vehicle
        vehicle._has_ir = vehicle._has_raw_ir = False
        bench.run("fwd 0.2\n", cycles=300)
        assert (bench.pose[0] > 0.1) == moves


def test_robot_does_not_move_before_its_first_motion() -> None:
    source = 'set "$odoth" 1.5\nwait 1\n'
    assert abs(Bench("differential").run(source).pose[2]) == 0.0
    assert abs(Bench("differential", "mrc").run(source).pose[2]) > 10.0


@ROBOTS
def test_speed_is_correct_when_answers_of_the_robot_are_lost(robot: str) -> None:
    """Four of five answers are lost; the robot must not appear to be five times as fast."""
    bench = Bench(robot, conf=dataclasses.replace(SMR, max_tick=130.0) if robot == "differential" else None)
    bench.load("fwd 3\neval $odox\n")
    bench.run_until(lambda: bench.pose[0] > 0.5)
    fastest = 0.0
    for _ in range(100):
        for _ in range(4):
            bench.link.exchange({})
        bench.cycle()
        fastest = max(fastest, bench.controller.vehicle.odometry.velocity)
    bench.run()
    assert fastest == pytest.approx(0.3, abs=0.02)
    assert bench.pose[0] == pytest.approx(3.0, abs=0.02)
    assert bench.value == pytest.approx(bench.pose[0], abs=0.01)
    assert bench.controller.vehicle.odometry.faults == 0


# -- the language -------------------------------------------------------------------------------------------


def test_rem_never_returns_the_divisor_in_sound_profile() -> None:
    assert Bench().run("eval rem(3,3)\n").value == 0.0
    assert Bench("velomega", "mrc").run("eval rem(3,3)\n").value == 3.0


def test_errors_name_the_line_of_the_file() -> None:
    source = 'n=0\nlabel "a"\nn=n+1\nif (n<5) "a"\nx = q[9]\n'.replace("n=0", 'n=0\n\narray "q" 2')
    bench = Bench().run(source)
    assert bench.controller.failure is not None
    assert (bench.controller.failure.line, bench.controller.failure.column) == (7, 5)
    mrc = Bench("velomega", "mrc").run(source.replace("x = q[9]", "x = ("))
    assert mrc.printed.endswith(" syntax error in line : 19 \n")


def test_script_with_errors_does_not_start() -> None:
    turtle = Turtle()
    with pytest.raises(BadMission) as caught:
        Mission('fwd 1\n  turn (\ngoto "x"\nfwd y\neval $odoz\nfwd 1 2\nif (1) "q"\n', turtle).run()
    found = [(mistake.line, mistake.column) for mistake in caught.value.mistakes]
    assert found == [(2, 8), (3, 1), (4, 5), (5, 6), (6, 1), (7, 8)]
    assert turtle.world.odometry.x == 0.0
    mrc = Bench("velomega", "mrc").run("fwd 0.1\nturn (\n")
    assert mrc.pose[0] > 0.09


def test_statements_after_a_new_variable_run_in_sound_profile() -> None:
    assert Bench().run("a = 1 b = 2 eval a ; b\n").values == [[1.0, 2.0]]
    mrc = Bench("velomega", "mrc").run("a = 1 b = 2 eval a ; b\neval b\n")
    assert mrc.values == [[1.0]]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("x = q[3]", "index 3 is beyond q, which has values q[0] to q[2]"),
        ("q[-1] = 3", "index -1 is beyond q, which has values q[0] to q[2]"),
        ("x = $odox[1]", "index 1 is beyond $odox, which has one value"),
        ('set "q[3]" 1', "index 3 is beyond q, which has 3 values"),
        ('log "q[3]"', "index 3 is beyond q, which has 3 values"),
        ('set "nosuch" 1', "there is no variable nosuch"),
        ('set "conditioncounter" 10', "there is no condition counter 10.000000; expected 0 to 9"),
        ('setoutput "lamp" 1', "the robot has no write variable lamp"),
        ('setgain "lamp" 1', "the robot has no variable lamp"),
        ('setoffset "lamp" 1', "the robot has no variable lamp"),
        ('control "nosuch"', 'control has no word "nosuch"'),
        ('log "nosuch"', "there is no variable nosuch"),
        ('stream 1 "nosuch"', "there is no variable nosuch"),
        ('setpar "x" "y" "z" 1', 'there is no module "x"'),
        ('setpar "mrc" "y" "z" 1', 'mrc has no "y"'),
        ('setpar "motioncontrol" "drive" "z" 1', "z of motioncontrol drive is not a parameter"),
        ('routeinput "mrc" "mrccontrol" "stop" "nosuch"', "the robot has no variable nosuch"),
        ('routeoutput "funcgen" "lamp"', "the robot has no write variable lamp"),
        ('routeoutput "nosuch" "cmdrotvel"', 'there is no generator "nosuch"; expected funcgen'),
        ('followline "xx"', 'followline has no line "xx", only bm, bl, br, wm, wl, wr, bmc'),
        ('followwall "x" 1', 'a side is "l" or "r", not "x"'),
        ('vision "x"', 'vision needs hardware; register a function for it with mission.on("vision", function)'),
        ('speak "x"', 'speak needs hardware; register a function for it with mission.on("speak", function)'),
        ("movetoxyz 1 2 3", "movetoxyz needs hardware; register a function for it with "),
        ('get "guidemark"', "get needs hardware; "),
        ('set "usekalmanodo" 1', 'set "usekalmanodo" needs a filter that provides $xkalman, $ykalman and $thkalman'),
        ('set "hakomanual" 1', 'set "hakomanual" needs the write variable hakomanual, which this robot does not have'),
        ("fwd 1 @a z", "@a 0.000000 is not an acceleration; it has to be above 0"),
        ("wait 1 @v n", "@v -nan is not a speed"),
    ],
)
def test_impossible_statement_fails_only_in_sound_profile(line: str, reason: str) -> None:
    source = f'array "q" 3\nz = 0\nn = 0/0\n{line}\neval 1\n'
    bench = Bench().run(source, cycles=300)
    assert bench.reason.startswith(reason)
    assert bench.controller.is_finished
    mrc = Bench("velomega", "mrc").run(source, cycles=300)
    assert mrc.controller.failure is None


def test_mrc_profile_reads_zero_as_true_beyond_an_array() -> None:
    bench = Bench("velomega", "mrc").run('array "q" 3\neval q[9]\nif (q[9]) "x"\neval 5\nlabel "x"\neval q[9] == 0\n')
    assert bench.values == [[0.0], [0.0]]


def test_tick_variable_is_the_robot_tick_in_sound_profile() -> None:
    assert Bench().run("wait 0.1\neval $tick\n").value == 35.0
    assert Bench("velomega", "mrc").run("wait 0.1\neval $tick\n").value == 0.0


def test_watches_do_not_affect_stop_conditions() -> None:
    source = 'addwatch "w" 1 : ($odox > 5)\nfwd 2 : ($drivendist > 5) | ($drivendist > 0.2)\neval $condition\n'
    assert Bench().run(source).value == 2.0
    # MRC stores the first value of a watch in place of the first condition, and finds the second condition after it.
    assert Bench("velomega", "mrc").run(source).value == 2.0
    both = source.replace("$drivendist > 5", "$drivendist > 0.2")
    assert Bench().run(both).value == 1.0
    assert Bench("velomega", "mrc").run(both).value == 2.0


def test_sound_profile_allows_more_than_two_watches() -> None:
    source = "".join(f'addwatch "w{number}" 1 : (1)\n' for number in range(4))
    for profile, fired in (("sound", 4), ("mrc", 2)):
        assert len(Bench("velomega", profile).run(source).texts(SaidKind.EVENT)) == fired


def test_profile_can_combine_rules_of_sound_and_mrc() -> None:
    mixed: Profile = dataclasses.replace(SOUND, turnr_ends=False)
    assert Bench("velomega", mixed).run("turnr 0.5 90\nwait 3\neval rem(3,3)\n").values == [[0.0]]
