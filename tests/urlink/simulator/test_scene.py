"""Scene of bodies around a simulated arm: its calls, its effects, and the choice of the adapter for a scene file."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Sequence
from pathlib import Path

import pytest

import urlink
from urlink.protocol.enums import SafetyMode
from urlink.simulator import Controller, Reaction, Setpoint
from urlink.simulator.controller import Controller as Made

REST = (0.0,) * 6


class Bodies:
    """Scene that returns a set reaction and records its calls."""

    def __init__(self) -> None:
        self.reaction = Reaction(REST)
        self.asked: list[tuple[Setpoint, Sequence[float], float]] = []

    def advance(self, setpoint: Setpoint, pose: Sequence[float], seconds: float) -> Reaction:
        self.asked.append((setpoint, pose, seconds))
        return self.reaction


def mounted() -> tuple[Controller, Bodies]:
    controller, bodies = Controller("UR5e", noise=False), Bodies()
    controller.world.scene = bodies
    return controller, bodies


def test_scene_is_called_once_per_cycle_with_its_targets() -> None:
    controller, bodies = mounted()
    controller.arm.tcp = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    controller.step(3)
    assert len(bodies.asked) == 3
    setpoint, pose, seconds = bodies.asked[-1]
    assert setpoint == controller.arm.setpoint
    assert seconds == 0.002
    assert list(pose) == pytest.approx(controller.arm.sample.pose_target)


def test_wrench_is_measured_in_the_same_cycle_without_torque() -> None:
    controller, bodies = mounted()
    bodies.reaction = Reaction((1.0, -2.0, 3.0, 0.1, 0.2, 0.3), (0.0, 5.0, 0.0, 0.0, 0.0, 0.0))
    controller.step()
    assert controller.arm.sample.force == [1.0, -2.0, 3.0, 0.1, 0.2, 0.3]
    assert controller.arm.pushed_joints == [0.0, 5.0, 0.0, 0.0, 0.0, 0.0]
    controller.world.clear()
    controller.step()
    assert controller.arm.sample.force == list(REST)
    assert not any(controller.arm.pushed_joints)


@pytest.mark.parametrize(
    ("reaction", "stops"),
    [
        (Reaction((0.0, 0.0, 149.0, 0.0, 0.0, 0.0)), False),
        (Reaction((0.0, 0.0, 151.0, 0.0, 0.0, 0.0)), True),
        (Reaction(REST, (0.0, 59.0, 0.0, 0.0, 0.0, 0.0)), False),
        (Reaction(REST, (0.0, -61.0, 0.0, 0.0, 0.0, 0.0)), True),
    ],
)
def test_excessive_force_on_tool_or_links_stops_the_arm(reaction: Reaction, stops: bool) -> None:
    controller, bodies = mounted()
    controller.step()
    bodies.reaction = reaction
    controller.step(2)
    assert (controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP) is stops


def test_arm_recovers_while_the_link_is_still_touched() -> None:
    controller, bodies = mounted()
    bodies.reaction = Reaction(REST, (0.0, 0.0, 70.0, 0.0, 0.0, 0.0))
    controller.step(2)
    controller.faults.clear()
    controller.step(2)
    assert controller.modes.safety_mode is SafetyMode.NORMAL


def test_arm_yields_to_the_scene_in_freedrive() -> None:
    controller, bodies = mounted()
    controller.take("def drift():\n  freedrive_mode()\n  sleep(10)\nend\n")
    controller.step(50)
    before = controller.arm.setpoint.q
    bodies.reaction = Reaction(REST, (0.0, 0.0, 0.0, 4.0, 0.0, 0.0))
    controller.step(100)
    assert controller.arm.setpoint.q[3] > before[3] + 0.01


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "table.xml"
    path.write_text("<mujoco/>")
    return path


def entry_points(monkeypatch: pytest.MonkeyPatch, *entries: importlib.metadata.EntryPoint) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: entries if group == "urlink.scenes" else ())


def mount(path: Path, controller: Made) -> Bodies:
    bodies = Bodies()
    bodies.reaction = Reaction((float(len(path.name)), 0.0, 0.0, 0.0, 0.0, 0.0))
    assert not any(controller.arm.tcp)
    return bodies


def test_scene_file_is_opened_by_the_adapter_of_its_suffix(monkeypatch: pytest.MonkeyPatch, table: Path) -> None:
    monkeypatch.setattr(importlib.metadata.EntryPoint, "load", lambda self: mount)
    entry_points(monkeypatch, importlib.metadata.EntryPoint("xml", "adapter:mount", "urlink.scenes"))
    controller = Controller(noise=False, scene=table)
    assert isinstance(controller.world.scene, Bodies)
    controller.step()
    assert controller.arm.sample.force[0] == 9.0


def test_missing_adapter_raises_the_package_to_install(monkeypatch: pytest.MonkeyPatch, table: Path) -> None:
    entry_points(monkeypatch)
    with pytest.raises(urlink.LocalError, match=r"table\.xml is installed; use pip install urlink-mujoco"):
        Controller(scene=table)
    with pytest.raises(urlink.LocalError, match="pip install urlink-mujoco"):
        urlink.connect(f"sim://ur5e?scene={table}")
    usd = table.rename(table.with_suffix(".usd"))
    with pytest.raises(urlink.LocalError, match=r"table\.usd is installed; expected one of \.xml"):
        Controller(scene=usd)


def test_missing_scene_file_is_named_in_the_error(tmp_path: Path) -> None:
    with pytest.raises(urlink.BadValue, match=r"nowhere\.xml' is not a file"):
        Controller(scene=tmp_path / "nowhere.xml")
