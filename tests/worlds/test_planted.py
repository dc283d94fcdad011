"""The defects of `planted`: each can be injected and shows in its world; without it, the world has no fault."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.worlds.planted import DEFECTS, NAMES, ROOT, SHOWN, Change, planted, worlds
from tests.worlds.running import run

# A killed client does not close its sockets, so ignore the warnings.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.mark.parametrize("name", NAMES)
def test_defect_can_be_injected(name: str) -> None:
    for change in DEFECTS[name]:
        source = (ROOT / change.path).read_text(encoding="utf-8")
        assert change.applied(source) != source


SOURCE = '''
class Door:
    @property
    def is_open(self) -> bool:
        """Whether it is open."""
        return bool(
            self.angle
        )

    def close(self) -> None:
        self.angle = 0
        self.report()
'''


def test_change_replaces_the_body_and_keeps_the_docstring() -> None:
    changed = Change("door", "Door.is_open", "return True").applied(SOURCE)
    assert changed.count('"""Whether it is open."""\n        return True\n\n    def close') == 1


def test_change_replaces_text_across_line_breaks() -> None:
    changed = Change("door", "Door.is_open", "self.angle > 1", before="bool( self.angle )").applied(SOURCE)
    assert "        return self.angle > 1\n" in changed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (Change("door", "Door.open", "pass"), "src/door.py has 0 definitions of Door.open; expected 1. Edit DEFECTS"),
        (
            Change("door", "Door.close", "pass", before="self.angle = 1"),
            "'self.angle = 1' occurs 0 times in Door.close",
        ),
        (Change("door", "Door.close", "pass", before="self."), "'self.' occurs 2 times in Door.close of src/door.py"),
    ],
)
def test_change_names_the_entry_to_edit_when_the_code_differs(change: Change, message: str) -> None:
    with pytest.raises(LookupError) as raised:
        change.applied(SOURCE)
    assert message in str(raised.value)
    assert "tests/worlds/planted.py" in str(raised.value)


@pytest.mark.slow
@pytest.mark.matrix(2)
@pytest.mark.parametrize("name", SHOWN)
@pytest.mark.real_time
def test_defect_shows_in_its_world(name: str) -> None:
    with planted(name) as root:
        found = worlds(root, ["--shown", name])
    assert found.returncode == 1
    assert "FAULT:" in found.stdout


@pytest.mark.slow
@pytest.mark.parametrize("name", SHOWN)
def test_world_has_no_fault_without_the_defect(name: str) -> None:
    world, _ = SHOWN[name]
    outcome = run(replace(world, seed=1))
    assert outcome.faults == [], "\n".join(outcome.log)
