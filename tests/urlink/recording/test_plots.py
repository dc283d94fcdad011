"""Plots of recordings and of live states, and the HTML for notebooks."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import urlink
import urlink.cli
from linkcore import process
from linkcore.recording.file import Kind, RecordingWriter
from linkcore.streaming import plotting
from linkcore.streaming.history import History
from linkcore.streaming.plotting import Curves, Plot
from tests.waiting import until
from urlink.packets import RealtimeState, Stamp

pytest.importorskip("matplotlib", reason="matplotlib is not installed")

CAPTURE = Path(__file__).resolve().parents[3] / "captures" / "simulator-5.11.urlog"


@pytest.fixture
def run() -> urlink.Recording:
    return urlink.load(CAPTURE)


@pytest.mark.slow
def test_plot_has_panel_per_field_and_line_per_element(run: urlink.Recording) -> None:
    plot = run.plot("q_actual", "tcp_force", "primary.robot_mode_data.robot_mode", start=0.1, end=0.2)
    panels = plot.figure().axes
    assert [panel.get_title("left") for panel in panels] == [
        "realtime.q_actual",
        "realtime.tcp_force",
        "primary.robot_mode_data.robot_mode",
    ]
    assert [len(panel.lines) for panel in panels] == [6, 6, 1]
    assert [line.get_label() for line in panels[1].lines] == ["x, N", "y, N", "z, N", "rx, Nm", "ry, Nm", "rz, Nm"]
    assert [panel.get_ylabel() for panel in panels] == ["rad", "N, Nm", ""]
    assert [panel.get_legend() is not None for panel in panels] == [True, True, False]
    line = panels[0].lines[2]
    part = run.realtime.between(0.1, 0.2)
    assert line.get_xdata().tolist() == part.time.tolist()
    assert line.get_ydata().tolist() == part["q_actual"][:, 2].tolist()


def test_single_elements_are_plotted(run: urlink.Recording) -> None:
    (panel,) = run.plot("q_actual_3").figure().axes
    (line,) = panel.lines
    assert line.get_ydata().tolist() == run.realtime["q_actual"][:, 3].tolist()
    assert panel.get_ylabel() == "rad"


def test_list_of_names_is_rejected_with_a_hint(run: urlink.Recording) -> None:
    fields: list[str] = ["q_actual"]
    with pytest.raises(
        urlink.BadValue, match=r"field \['q_actual'\] is not a string; expected each name as an argument"
    ):
        run.plot(fields)  # type: ignore[arg-type]


def test_column_as_attribute_raises_with_a_hint(run: urlink.Recording) -> None:
    held: Any = run
    with pytest.raises(AttributeError, match=r"write recording.realtime\['q_actual'\]"):
        held.actual_q  # noqa: B018
    with pytest.raises(AttributeError, match=r"it is a column; write table\['q_actual'\]"):
        held.realtime.q_actual  # noqa: B018


def test_plot_line_is_interrupted_at_a_lost_connection(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run.urlog")
    channel = writer.add_channel({"name": "realtime"})
    for number in range(20):
        writer.write(Kind.BYTES, channel, Stamp(number, number), bytes(RealtimeState("5.11", time=number)))
        if number == 11:
            writer.write(Kind.EVENT, channel, Stamp(number, number), b'{"state": "lost"}')
    writer.close()
    run = urlink.load(tmp_path / "run.urlog")
    (line,) = run.plot("time").figure().axes[0].lines
    assert np.flatnonzero(np.isnan(line.get_ydata())).tolist() == run.realtime.begins == [12]


def test_thinned_line_keeps_peaks() -> None:
    time = np.arange(300_000) / 500
    values = np.zeros(300_000)
    values[123_456] = 7.0
    values[234_567] = -3.0
    (line,) = Plot([Curves("x", "N", time, values)]).figure().axes[0].lines
    assert len(line.get_ydata()) < 20_000
    assert (line.get_ydata().max(), line.get_ydata().min()) == (7.0, -3.0)


@pytest.mark.slow
def test_plot_rejects_invalid_requests(run: urlink.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(urlink.BadValue, match="nothing to plot"):
        run.plot()
    with pytest.raises(urlink.BadValue, match="did you mean q_actual"):
        run.plot("q_actuel")
    with pytest.raises(urlink.BadValue, match=r"unsupported type of file; expected one of \.png, \.svg, \.pdf"):
        run.plot("q_actual").save(tmp_path / "q.doc")
    with pytest.raises(urlink.BadRecording, match="cannot write"):
        run.plot("q_actual").save(tmp_path / "nowhere" / "q.png")
    with pytest.raises(urlink.BadValue, match="is not a numeric field"):
        Plot([Curves("text", "", np.zeros(1), np.array(["a"], object))])
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(urlink.LocalError, match=r"pip install 'urlink-robot\[plot\]'"):
        run.plot("q_actual").figure()


@pytest.mark.slow
def test_plot_command_writes_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, begin in (("q.png", b"\x89PNG"), ("q.svg", b"<?xml")):
        path = tmp_path / name
        assert urlink.cli.main(["plot", str(CAPTURE), "q_actual", "-o", str(path)]) == 0
        assert capsys.readouterr().out == f"{path}\n"
        assert path.read_bytes().startswith(begin)
    assert urlink.cli.main(["plot", str(CAPTURE), "nothing", "-o", str(tmp_path / "x.png")]) == 1
    assert "no field 'nothing'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.real_time
def test_live_plot_shows_arriving_states(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Plot] = []
    array = History.array

    def slow(history: History, *fields: str) -> NDArray[np.void]:
        """Simulate a busy computer: wait until another state has arrived."""
        before = len(history)
        if not drawn:
            until(lambda: len(history) > before)
        return array(history, *fields)

    monkeypatch.setattr(plotting.LivePlot, "update", lambda self, plot, pause: drawn.append(plot))
    monkeypatch.setattr(History, "array", slow)
    with urlink.connect(f"replay://{CAPTURE}") as robot:
        robot.realtime.plot("q_actual", "speed_scaling", seconds=0.3, period=0.05)
        monkeypatch.setattr(History, "array", array)  # the recording may end soon
        with pytest.raises(urlink.BadValue, match="no field"):
            robot.realtime.plot("nothing", seconds=0.3)
    assert drawn[0]._curves[0].time[-1] <= 0
    lines = drawn[-1].figure().axes[0].lines
    assert len(lines) == 6
    assert -10 < lines[0].get_xdata()[0] < lines[0].get_xdata()[-1] <= 0


@pytest.mark.simulated_time
def test_live_plot_ends_with_every_state(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[int] = []

    def update(live: plotting.LivePlot, plot: Plot, pause: float) -> None:
        """Simulate a slow first drawing in a notebook, which takes longer than the plot should last."""
        drawn.append(len(plot._curves[0].time))
        time.sleep(1.0)

    monkeypatch.setattr(plotting.LivePlot, "update", update)
    with urlink.connect("sim://") as robot:
        robot.realtime.plot("q_actual", seconds=0.5)
    assert len(drawn) == 2
    assert drawn[-1] >= drawn[0] + 499


@pytest.mark.simulated_time
def test_notebook_plot_shows_every_received_state(monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[RealtimeState] = []
    shown: list[tuple[Plot, int]] = []

    def show(plot: Plot) -> None:
        """Show a plot as a notebook does, which takes longer than half of the time of the live plot."""
        shown.append((plot, len(received)))
        time.sleep(0.3)

    def display(plot: Plot, display_id: bool) -> Any:
        assert display_id
        show(plot)
        return SimpleNamespace(update=show)

    shell = SimpleNamespace(kernel=None, events=SimpleNamespace(register=lambda event, call: None))
    monkeypatch.setattr(process, "_watched", dict.fromkeys(("exit", "SIGTERM", "notebook"), "watched"))
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    with urlink.connect("sim://") as robot:
        robot.realtime.wait()
        robot.realtime.subscribe(received.append, inline=True)
        robot.realtime.plot("q_actual", "tcp_force", seconds=0.5)
    assert len(shown) > 1
    plot, count = shown[-1]
    assert count > 250
    for panel in plot.figure().axes:
        assert len(panel.lines) == 6
        # A state can arrive before the plot begins to collect, and after it has read the states.
        assert all(count - 2 <= len(line.get_xdata()) <= count for line in panel.lines)


@pytest.mark.simulated_time
def test_notebook_html_is_escaped(run: urlink.Recording) -> None:
    with urlink.connect(f"replay://{CAPTURE}?rate=max") as robot:
        robot.realtime.wait()
        assert "<td>realtime</td>" in robot._repr_html_()
        assert "<td>received</td>" in robot.realtime._repr_html_()
    assert "<td>primary</td>" in run._repr_html_()
    for html in (robot._repr_html_(), run._repr_html_(), run.realtime._repr_html_()):
        assert "<Re" not in html
        assert "<Ro" not in html
        assert "<Ta" not in html.replace("<Table", "<Ta")
        assert html.startswith(("<table><caption>&lt;", "<table><caption>replay://"))
