"""Tests of the diagnosis of stops: codes, tables of logs, missing columns, and drawn stops."""

import random
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadRecording
from linkcore.streaming.flight_record import Sent
from tests.matrix import trials
from tests.urlink.command import stops_drawn
from urlink.diagnosis.codes import code_of, known_codes
from urlink.diagnosis.stop_causes import explain
from urlink.diagnosis.stop_record import Report, StopRecord
from urlink.diagnosis.stop_table import read_table
from urlink.protocol.enums import SafetyMode
from urlink.script.messages import WAIT_MESSAGE, dated, setpoint

ROOT = Path(__file__).parents[3]


@cache
def drawn(cause: str, firmware: str = "5.11") -> StopRecord:
    """Return the record of one drawn stop."""
    for seed in range(20):
        scene = stops_drawn.Scene(random.Random(seed), firmware)
        if stops_drawn.CAUSES[cause](scene):
            return scene.record(has_codes=True)
    raise AssertionError(f"no stop of {cause}")


# -- codes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "argument", "cause", "joint"),
    [
        (153, 1, "position deviation", 1),
        (157, 5, "contact", 5),
        (173, 8, "joint torque", 2),
        (191, 34, "joint speed", 2),
        (191, 2, "joint speed", None),
        (191, 37, "joint speed", 5),
        (204, 1, "sudden change of target", None),
        (154, -1, "singularity", None),
        (209, 0, "program request", None),
    ],
)
def test_code_names_cause_and_joint(code: int, argument: int, cause: str, joint: int | None) -> None:
    found = code_of(code, argument)
    assert found is not None
    assert (found.cause, found.joint) == (cause, joint)
    assert found.source


@pytest.mark.parametrize(("code", "argument"), [(0, 0), (153, 12), (191, 31), (191, 99), (99999, 1)])
def test_unknown_code_has_no_meaning(code: int, argument: int) -> None:
    assert code_of(code, argument) is None


def test_page_lists_every_code() -> None:
    page = (ROOT / "docs/why-did-it-stop.md").read_text(encoding="utf-8")
    for code, arguments, cause, text, _ in known_codes():
        assert f"| C{code} | {arguments} | {cause} | {text} |" in page


# -- drawn stops -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stops() -> list[stops_drawn.Drawn]:
    """Draw stops once for all tests. In a process that runs only one of these tests, they are drawn for this test."""
    return list(stops_drawn.draw(trials(30, 120), 45))


@pytest.mark.slow
@pytest.mark.matrix
def test_right_cause_is_first_for_95_percent_of_stops(stops: list[stops_drawn.Drawn]) -> None:
    wrong = [(each.cause, each.found) for each in stops if not each.is_right]
    assert len(wrong) <= 0.05 * len(stops), wrong
    assert {each.firmware for each in stops} == set(stops_drawn.FIRMWARES)


@pytest.mark.slow
@pytest.mark.matrix
def test_right_cause_is_first_without_codes(stops: list[stops_drawn.Drawn]) -> None:
    silent = [each.without_codes() for each in stops if each.cause != "another client"]
    # Of 200 stops, 95 % are right (`python -m tests.urlink.command.stops_drawn`); this smaller sample varies more.
    assert sum(each.is_right for each in silent) >= 0.9 * len(silent)


# -- missing columns -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.property
@given(st.data())
def test_explanation_never_raises_when_columns_are_missing(data: st.DataObject) -> None:
    cause = data.draw(st.sampled_from(["contact", "joint speed", "singularity", "wrong payload", "another client"]))
    record = drawn(cause)
    names = data.draw(st.sets(st.sampled_from(sorted(record.columns))))
    columns = {name: column.copy() for name, column in record.columns.items() if name not in names}
    for name in data.draw(st.sets(st.sampled_from(sorted(record.columns)))) & columns.keys():
        columns[name][data.draw(st.integers(0, 300)) :: data.draw(st.integers(1, 5))] = np.nan
    step = data.draw(st.sampled_from([1, 4, 20]))
    less = StopRecord(
        record.time[::step],
        {name: column[::step] for name, column in columns.items()},
        record.reports if data.draw(st.booleans()) else None,
        record.keys if data.draw(st.booleans()) else None,
        model=record.model if data.draw(st.booleans()) else None,
    )
    for each in explain(less):
        assert each.text()
        assert each.svg().endswith("</svg>\n")
        assert each.to_dict()["causes"]


def test_missing_columns_are_listed() -> None:
    record = drawn("contact")
    (found,) = explain(StopRecord(record.time, {"safety_mode": record.columns["safety_mode"]}))
    assert {"target positions", "the force at the tool", "the model of the arm"} <= set(found.missing)
    assert found.cause.name == "unknown"


def test_empty_record_has_no_stops() -> None:
    assert explain(StopRecord(np.empty(0), {})) == []


def test_record_that_begins_stopped_knows_only_the_kind() -> None:
    modes = np.full(50, float(SafetyMode.PROTECTIVE_STOP))
    (found,) = explain(StopRecord(np.arange(50) / 125, {"safety_mode": modes}, reports=[Report(0.1, 157, 3, "")]))
    assert (found.kind, found.code, found.cause.name, found.cause.joint) == (
        "protective stop",
        "C157A3",
        "contact",
        "wrist 1",
    )
    assert any("before the stop" in each for each in found.missing)


def test_safety_bits_show_the_kind_of_stop() -> None:
    bits = np.array([1.0] * 20 + [float(1 << 4 | 1 << 10)] * 20)
    (found,) = explain(StopRecord(np.arange(40) / 125, {"safety_status_bits": bits}))
    assert (found.kind, found.cause.name) == ("safeguard stop", "safeguard")


def test_stop_is_inferred_when_no_column_has_the_safety_mode() -> None:
    record = drawn("position deviation")
    columns = {name: record.columns[name] for name in ("q_target", "q_actual", "qd_target", "program_state")}
    (found,) = explain(StopRecord(record.time, columns, model=record.model))
    assert "inferred" in found.kind
    assert found.cause.name == "position deviation"


def test_message_that_only_keeps_the_link_is_no_jump() -> None:
    record = drawn("contact")
    (at,) = (each.at for each in explain(record))
    assert at is not None
    q = record.columns["q_target"][0].tolist()
    messages = (setpoint(q, [0.0] * 6), WAIT_MESSAGE, setpoint(q, [0.0] * 6))
    sent = [Sent(at - 0.3 + 0.01 * number, "program", dated(each, number)) for number, each in enumerate(messages)]
    (found,) = explain(replace(record, sent=sent))
    assert "sudden change of target" not in [each.name for each in found.causes]
    far = [each + 1.0 for each in q]
    sent.append(Sent(at - 0.2, "program", dated(setpoint(far, [0.0] * 6), 3)))
    (found,) = explain(replace(record, sent=sent))
    assert "sudden change of target" in [each.name for each in found.causes]


# -- tables ------------------------------------------------------------------------------------------------------


def write_log(path: Path, record: StopRecord, names: dict[str, str], step: int = 4) -> None:
    head, cells = ["timestamp"], [record.time]
    for name, there in names.items():
        column = record.columns[name]
        head += [there] if column.ndim == 1 else [f"{there}_{i}" for i in range(column.shape[1])]
        cells += [column] if column.ndim == 1 else list(column.T)
    rows = np.column_stack(cells)[::step]
    path.write_text("\n".join([",".join(head), *(",".join(f"{x:.9g}" for x in row) for row in rows)]), encoding="utf-8")


def test_table_with_rtde_names_is_explained(tmp_path: Path) -> None:
    record = drawn("contact")
    names = {
        "q_actual": "actual_q",
        "q_target": "target_q",
        "tcp_force": "actual_TCP_force",
        "safety_mode": "safety_mode",
    }
    write_log(tmp_path / "log.csv", record, names)
    (found,) = explain(read_table(tmp_path / "log.csv"))
    assert found.cause.name == "contact"
    assert found.code is None


def test_text_cells_count_as_unknown(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("safety_mode,note\n1,a\n1,b\n1,\n3,c\n3,d\n", encoding="utf-8")
    (found,) = explain(read_table(tmp_path / "log.csv"))
    assert found.kind == "protective stop"
    assert any("rows per second are assumed" in each for each in found.missing)


def test_file_that_is_not_a_table_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BadRecording, match="not a table"):
        read_table(tmp_path / "log.csv")


# -- pictures ----------------------------------------------------------------------------------------------------


def test_picture_has_units_legend_and_the_stop(tmp_path: Path) -> None:
    (found,) = explain(drawn("joint speed"))
    text = found.save(tmp_path / "stop.svg").read_text(encoding="utf-8")
    for part in ("[rad/s]", "[N]", "wrist 3", 'stroke="red"', "stroke-dasharray", "the stop is at 0"):
        assert part in text
    assert "joint speed" in found.text()
