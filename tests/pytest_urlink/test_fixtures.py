"""The fixtures as test suites of users see them: each test here runs a small suite."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

# A suite in this process shares its imports with later suites, and numpy cannot be imported twice.
import rhdlink.host.plugins.turtle  # noqa: F401
from tests.waiting import until
from urlink import LocalError
from urlink.simulator import Controller

pytestmark = pytest.mark.real_time

pytest_plugins = ["pytester"]

PAGE = Path(__file__).resolve().parents[2] / "docs" / "testing.md"

#: Load the plugin by name, because it might be installed and loaded by its entry point as well.
OPTIONS = ("-p", "pytest_urlink", "-p", "no:cacheprovider", "--strict-markers", "-W", "error")


@pytest.mark.slow
def test_examples_of_the_documentation_pass(pytester: pytest.Pytester) -> None:
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    pytester.makepyfile(**{f"test_block_{number}": block for number, block in enumerate(blocks)})
    pytester.runpytest_inprocess(*OPTIONS).assert_outcomes(passed=sum(block.count("def test_") for block in blocks) + 1)


def test_marker_selects_an_smr_turtle(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import pytest

        @pytest.mark.rhd_turtle(smr=True)
        class TestSmr:
            def test_kind(self, rhd_turtle):
                assert type(rhd_turtle).__name__ == "SmrTurtle"
        """
    )
    pytester.runpytest_inprocess(*OPTIONS).assert_outcomes(passed=1)


@pytest.mark.slow
def test_invalid_markers_raise_clear_errors(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import pytest

        @pytest.mark.urlink("UR5e")
        def test_place(urlink_controller): ...

        @pytest.mark.urlink(modle="UR5e")
        def test_name(urlink_controller): ...

        @pytest.mark.urlink(faults=["protective_halt"])
        def test_fault(urlink_controller): ...

        @pytest.mark.urlink(faults="protective_stop")
        def test_faults(urlink_controller): ...

        @pytest.mark.rhd_turtle(world={"size": -1})
        def test_world(rhd_turtle): ...
        """
    )
    result = pytester.runpytest_inprocess(*OPTIONS)
    result.assert_outcomes(errors=5)
    for text in ("*pass arguments by name*", "*modle*", "*protective_halt*", "*expected a list*", "*size=-1*"):
        result.stdout.fnmatch_lines([text])


def test_plugin_imports_no_robot_library_until_needed() -> None:
    program = "import sys, pytest_urlink; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True)
    assert {"numpy", "urlink", "linkcore", "rhdlink"}.isdisjoint(done.stdout.split())


def test_stepped_controller_does_not_advance_between_steps() -> None:
    with Controller("UR5e", "5.11", stepped=True) as controller:
        controller.step(250)
        assert (controller.cycle, controller.time) == (250, 0.5)
        with controller.passing(speed=50):
            until(lambda: controller.cycle > 500)
        cycle = controller.cycle
        controller.faults.protective_stop()
        assert controller.cycle == cycle
        controller.step()
        assert (controller.cycle, controller.stopped_since) == (cycle + 1, controller.time)
    with Controller("UR5e", "5.11") as controller:
        with pytest.raises(LocalError, match="stepped=True"):
            controller.step()
        with pytest.raises(LocalError, match="stepped=True"):
            controller.passing()
