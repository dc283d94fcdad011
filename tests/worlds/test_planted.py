"""The defects of `planted`: each applies to the code of today."""

from __future__ import annotations

import pytest

from tests.worlds.planted import NAMES, ROOT, planted


@pytest.mark.parametrize("name", NAMES)
def test_a_defect_applies_to_the_code_of_today(name: str) -> None:
    with planted(name) as root:
        changed = [
            path
            for path in (root / "src").rglob("*.py")
            if path.read_bytes() != (ROOT / path.relative_to(root)).read_bytes()
        ]
    assert changed
