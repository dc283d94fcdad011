"""What is mutated, and which tests are to notice."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tests.mutants.drawn import MODULES

ROOT = Path(__file__).resolve().parents[2]


class Group(NamedTuple):
    """Modules whose mutations are tried on the same tests.

    Args:
        modules: patterns of files under src/.
        tests: folders and files under tests/. Those that start commands are not among them: a mutation is made in the
            process that runs the tests, so the processes that they start do not have it.
    """

    modules: tuple[str, ...]
    tests: tuple[str, ...]

    def files(self) -> list[Path]:
        found = sorted(path for pattern in self.modules for path in (ROOT / "src").glob(pattern))
        return [path for path in found if path.name != "__init__.py"]

    def missing(self) -> list[str]:
        """What finds nothing."""
        modules = [pattern for pattern in self.modules if not list((ROOT / "src").glob(pattern))]
        return modules + [path for path in self.tests if not (ROOT / path).exists()]


GROUPS = {
    "framing": Group(("linkcore/wire/framing.py",), ("tests/linkcore/wire", "tests/urlink/protocol")),
    "command": Group(
        ("urlink/command/*.py",),
        (
            "tests/urlink/command",
            "tests/urlink/protocol/test_tool_serial.py",
            "tests/urlink/motion",
            "tests/urlink/rtde",
            "tests/urlink/test_cycles.py",
            "tests/urlink/arm/test_gravity_and_payload.py",
            "tests/urlink/test_robot.py",
            "tests/urlink/test_public_names.py",
            "tests/urlink/test_units.py",
        ),
    ),
    "motion": Group(
        ("urlink/motion/**/*.py", "urlink/command/program_time.py"),
        (
            "tests/urlink/motion",
            "tests/urlink/script",
            "tests/urlink/test_cycles.py",
            "tests/urlink/test_group.py",
            "tests/urlink/test_public_names.py",
        ),
    ),
    # Of these the defects are drawn: `--drawn`.
    "drawn": Group(
        MODULES,
        (
            "tests/urlink/command",
            "tests/urlink/motion",
            "tests/urlink/rtde",
            "tests/urlink/aio",
            "tests/urlink/test_group.py",
            "tests/urlink/test_robot.py",
            "tests/linkcore/streaming",
            "tests/linkcore/aio",
            "tests/linkcore/test_handle.py",
            "tests/rhdlink",
        ),
    ),
    "rhd-wire": Group(("rhdlink/wire/*.py",), ("tests/rhdlink",)),
    "rhd-host": Group(("rhdlink/host/*.py",), ("tests/rhdlink",)),
}
