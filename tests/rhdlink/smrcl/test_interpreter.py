"""Order and timing of lines: the rules of MRC, which both profiles share, and its special cases in its profile."""

from __future__ import annotations

import pytest

from rhdlink.smrcl.interpreter import MissionLimits
from rhdlink.smrcl.plan import MissionPlan, PlanLine, split_lines
from rhdlink.smrcl.recipients import SaidKind
from tests.rhdlink.smrcl.bench import Bench

PROFILES = pytest.mark.parametrize("profile", ["sound", "mrc"])


def cycles_of(line: str, profile: str) -> int:
    """Return the number of cycles from this line to the next."""
    bench = Bench("velomega", profile).load(f"{line}\neval 1\n")
    began = ended = None
    while bench.cycle() and ended is None:
        for said in bench.said:
            if said.kind is SaidKind.LINE and said.line == 1 and began is None:
                began = bench.controller.cycle
        if bench.values:
            ended = bench.controller.cycle
    assert began is not None
    assert ended is not None
    return ended - began


@PROFILES
@pytest.mark.parametrize(
    ("line", "cycles"),
    [
        *(
            (free, 0)
            for free in ("a = 1", "eval 1", 'label "a"', "", "% x", "targethere", 'putevent "x"', "switch (0)")
        ),
        *((quick, 2) for quick in ("idle", "stop", "wait 0", "wait -1", ": (1)", "drive : (1)", "fwd 0", "turn 0")),
        *(
            (quick, 2)
            for quick in ('array "q" 2', 'print "x"', "trans 1 2 3 4 5 6", "ignoreobstacles", "motorcmds 0 0")
        ),
        *(("wait 0.01", 3), ("wait 0.05", 7), ("wait 0.1", 12), ("drive : ($cmdtime > 0.1)", 13)),
        ("resetmotors", 8),
    ],
)
def test_each_kind_of_line_takes_the_expected_number_of_cycles(line: str, cycles: int, profile: str) -> None:
    found = cycles_of(line, profile)
    assert found == cycles


@PROFILES
def test_wait_line_uses_the_end_of_the_previous_command(profile: str) -> None:
    def waited(before: str) -> float:
        bench = Bench("velomega", profile).run(f"{before}\n: ($cmdtime > 0.5)\nc = $condition\neval c\n", cycles=3000)
        return bench.value if bench.values else -1.0

    assert waited("idle") == 0.0
    assert waited("fwd 0.05") == 0.0
    assert waited("wait 0.2") == 0.0
    assert waited('label "x"') == 1.0
    assert waited("drive : (1)") == 1.0
    assert waited('wait 0.2\nif (0) "x"\nlabel "x"') == 1.0


@PROFILES
def test_condition_number_is_zero_after_it_was_read(profile: str) -> None:
    source = "fwd 1 : ($cmdtime > 9) | ($drivendist > 0.1) | (0)\neval $condition\neval $condition\n"
    assert Bench("velomega", profile).run(source).values == [[2.0], [0.0]]


@PROFILES
def test_distance_and_time_start_at_zero_with_each_line(profile: str) -> None:
    source = "fwd 0.3\nfwd 1 : ($drivendist > 0.1)\nx = $odox\nwait 0.2\ny = $cmdtime\neval x ; y\n"
    bench = Bench("velomega", profile).run(source)
    ((way, time),) = bench.values
    assert way == pytest.approx(0.4, abs=0.02)
    assert time == 0.0


@PROFILES
def test_switch_selects_a_case_and_skips_the_others(profile: str) -> None:
    source = (
        'k = 0\nlabel "again"\nswitch (k)\neval 100+k\ncase 1\neval 1\ncase 2\neval 2\ncase 1\neval 3\nendswitch\n'
        'k = k + 1\nif (k < 4) "again"\n'
    )
    assert Bench("velomega", profile).run(source).values == [[100.0], [1.0], [3.0], [2.0]]
    assert Bench("velomega", "mrc").run("switch (7)\nthis is no statement\ncase 7\neval 7\nendswitch\n").value == 7.0


@PROFILES
def test_nested_calls_return_to_the_next_line(profile: str) -> None:
    inner, outer = 'label "b"\neval 2\nreturn\n', 'label "a"\ncall "b"\neval 1\nreturn\n'
    source = f'goto "begin"\n{outer}{inner}label "begin"\ncall "a"\neval 3\n'
    assert Bench("velomega", profile).run(source).values == [[2.0], [1.0], [3.0]]


@PROFILES
def test_stringcat_builds_a_text(profile: str) -> None:
    bench = Bench("velomega", profile).run('stringcat "a" 1.5 "b"\nstringcat "$str" "c"\ntointstring -7.9\n')
    assert [text.strip() for text in bench.texts(SaidKind.MESSAGE)] == [
        "strbuf a1.500000 b",
        "strbuf a1.500000 bc",
        "strbuf -7",
    ]
    assert (
        len(
            Bench("velomega", profile)
            .run(f'stringcat "{"x" * 200}" "{"y" * 30}"\n' + 'stringcat "$str" "$str"\n' * 5)
            .controller.effects.text_buffer
        )
        == 255
    )


@PROFILES
def test_function_generator_drives_an_output(profile: str) -> None:
    bench = Bench("velomega", profile)
    bench.load('setgain "cmdrotvel" 100\nrouteoutput "funcgen" "cmdrotvel"\nfuncgen 0 5 0.05 0.1\n')
    sent = []
    while bench.cycle():
        sent.append(bench.controller.vehicle.symbols.pool[bench.controller.vehicle.symbols.outputs["cmdrotvel"].place])
    assert sent.count(5.0) == 10


@PROFILES
def test_function_generator_keeps_omitted_parameters(profile: str) -> None:
    bench = Bench("velomega", profile)
    bench.load('routeoutput "funcgen" "cmdrotvel"\nfuncgen 1 5 0.5 0.05\nfuncgen 0 7\nfuncgen 0 9 0\n')
    sent = []
    while bench.cycle():
        sent.append(bench.controller.vehicle.symbols.pool[bench.controller.vehicle.symbols.outputs["cmdrotvel"].place])
    # The step of 7 uses the frequency and time of the square wave: it begins after 0.5 s and lasts 0.05 s.
    first = sent.index(7.0)
    assert sent[first - 50 : first].count(0.0) == 50
    assert (sent.count(7.0), sent.count(9.0)) == (5, 5)


def test_followwall_keeps_the_gain_that_was_set_at_its_start() -> None:
    """MRC copies the gain when the motion starts."""

    def end(settings: str) -> tuple[float, float, float]:
        bench = Bench("differential", "mrc")
        bench.run(f'{settings}followwall "l" 0.4 @v 0.25 : ($cmdtime > 0.3)\nx = 1\n: ($cmdtime > 1)\n')
        return bench.pose

    def changed_on_the_way() -> tuple[float, float, float]:
        bench = Bench("differential", "mrc")
        source = 'followwall "l" 0.4 @v 0.25 : ($cmdtime > 0.3)\n{}: ($cmdtime > 1)\n'
        bench.run(source.format('setpar "motioncontrol" "followwall" "gain" 3\n'))
        other = Bench("differential", "mrc").run(source.format('setpar "motioncontrol" "followwall" "gain" 1\n'))
        assert bench.pose == other.pose
        return bench.pose

    assert changed_on_the_way() != end('setpar "motioncontrol" "followwall" "gain" 3\n')


@pytest.mark.parametrize(
    ("line", "printed"), [('wallest "left" 1', "Wrong parameter \n"), ('wallest "lb" 1', ""), ('wallest "rc" 1', "")]
)
def test_mrc_profile_prints_the_messages_of_wallest(line: str, printed: str) -> None:
    assert Bench("velomega", "mrc").run(line).texts(SaidKind.MESSAGE) == ([printed] if printed else [])


@PROFILES
@pytest.mark.parametrize(
    ("source", "place"),
    [
        ('x = 1\n  if (x == 1) "nowhere"\n', (2, 15)),
        ('goto "nowhere"\n', (1, 1)),
        ('  label "a"\n  goto "a"\n', (1, 3)),
        ("\treturn\n", (1, 2)),
        ('array "q" 99999\n', (1, 1)),
        ("x = y\n", (1, 5)),
    ],
)
def test_failure_has_its_line_and_column(profile: str, source: str, place: tuple[int, int]) -> None:
    bench = Bench("velomega", profile, options={"limits": MissionLimits(lines=100)}).run(source)
    failure = bench.controller.failure
    assert failure is not None
    assert (failure.line, failure.column) == place


@PROFILES
def test_input_can_be_routed_from_a_variable(profile: str) -> None:
    bench = Bench("velomega", profile)
    bench.run('routeinput "mrc" "mrccontrol" "stop" "transpos"\nfwd 1\neval 1\n')
    assert bench.controller.is_finished
    assert bench.values == []
    bench = Bench("velomega", profile)
    bench.run(
        'routeinput "motioncontrol" "drive" "refy" "res0"\ntrans 0 0 0 0.5 0 0\ndrive 0 0 0 : ($odoy > 0.3)\n',
        cycles=4000,
    )
    assert bench.controller.is_finished


# -- special cases of MRC -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "printed"),
    [
        # The name after the value of a new variable becomes the name of this variable.
        ("x = 1 y = 2\neval y\n", "1.000000  \n"),
        # A line that begins with a non-ASCII character waits for the previous command; elsewhere it is ignored.
        ("a = 1\nidle\n\xe9 eval 1\nfwd 0.02 \xe9\neval 2\n", "2.000000  \n"),
        ("eval 1 $nosuch\neval 2\n", 'System variable "$nosuch" not found\n syntax error in line : 1 \n'),
        (
            "foo $one $two\n",
            'System variable "$one" not found\nSystem variable "$two" not found\n syntax error in line : 1 \n',
        ),
        ("fwd 1 2 3\n", "Expecting between 1  and 1 parameters\n syntax error in line : 1 \n"),
        ("log\n", "Expecting between 1  and 9 parameters\n syntax error in line : 1 \n"),
        ('setpar "a" "b" "c" 1\n', "module not found\nparameter not found \n"),
        ('setpar "mrc" "b" "c" 1\n', "paramlist not found\nparameter not found \n"),
        ('routeinput "mrc" "mrccontrol" "stop" "x"\n', " input variable not found \n"),
        ('vision "x"\nlaser "x"\n', "Not connected to cameraserver \nNo connection to laserserver \n"),
        ("turnc 0.1 100\n", "Warning angles larger than 90 degrees are not recomendedWarning to sharp turn"),
        ("resetmotors\n", " p0 0.000000 \nreset state1\nreset state2 \n"),
        ('speak "hi"\nopen "wifi"\n', '/usr/local/bin/flite -t "hi"open wifi \n'),
    ],
)
def test_mrc_profile_prints_the_messages_of_invalid_lines(source: str, printed: str) -> None:
    bench = Bench("velomega", "mrc").run(source, cycles=60)
    assert "".join(said.printed for said in bench.said if said.kind is not SaidKind.LINE) == printed


def test_mrc_splits_long_lines() -> None:
    lines = list(split_lines(f"eval 1 %{'x' * 300}\neval 2", cuts=True))
    assert [(len(line.text), line.number) for line in lines] == [(255, 1), (54, 1), (6, 2)]
    assert [line.number for line in split_lines(f"{'x' * 300}\n\nb", cuts=False)] == [1, 2, 3]


def test_labels_are_compared_up_to_the_first_special_character() -> None:
    plan = MissionPlan(
        [PlanLine('label "a b"', 1), PlanLine("label \\x\\", 2), PlanLine('labelled "c"', 3), PlanLine('label "a"', 4)]
    )
    assert plan.labels.get("a") == 0
    assert plan.labels.get("a b") is None
    assert plan.labels.get("c") == 2
    assert plan.labels.get("x") is None


def test_mrc_accesses_variables_beyond_an_array() -> None:
    bench = Bench("velomega", "mrc").run('array "q" 2\nb = 3\nset "q[2]" 9\neval b\nset "q[-1]" 4\neval q\n')
    assert bench.values == [[9.0], [4.0]]


def test_uncalibrated_line_sensors_read_black_in_mrc() -> None:
    source = "wait 0.2\neval $line3 ; $blacklinefound ; $crossingblackline\n"
    assert Bench("differential", "mrc").run(source).values == [[0.0, 1.0, 1.0]]
    assert Bench("differential").run(source).values == [[pytest.approx(128 / 255, abs=1e-6), 0.0, 0.0]]
