"""Groups of modules to mutate, with the tests that should detect the mutations."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tests.mutants.drawn import MODULES

ROOT = Path(__file__).resolve().parents[2]


class Group(NamedTuple):
    """Modules whose mutations are tried on the same tests.

    Args:
        modules: Patterns of files below src/.
        tests: Folders and files below tests/. Tests that start commands are not included, because a mutation exists
            only in the process that runs the tests, and not in processes that they start.
    """

    modules: tuple[str, ...]
    tests: tuple[str, ...]

    def files(self) -> list[Path]:
        found = sorted(path for pattern in self.modules for path in (ROOT / "src").glob(pattern))
        return [path for path in found if path.name != "__init__.py"]

    def missing(self) -> list[str]:
        """Return the patterns and paths that match nothing."""
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
    # The drawn defects (`--drawn`) are in these modules.
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
