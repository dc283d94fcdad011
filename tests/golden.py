"""Golden files: reviewed texts that a test compares with the current output of the code.

``URLINK_WRITE_GOLDEN=1`` writes them. Read the difference before you commit it.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

__all__ = ["check_golden"]

_WRITE = "URLINK_WRITE_GOLDEN"


def check_golden(path: Path, text: str) -> None:
    """Fail if the file does not contain the text; write the file first if ``URLINK_WRITE_GOLDEN`` is set."""
    if os.environ.get(_WRITE):
        path.write_text(text, encoding="utf-8")
    if not path.exists():
        pytest.fail(f"{path} does not exist; write it with {_WRITE}=1, and read it before you commit it")
    assert text == path.read_text(encoding="utf-8"), f"{path} differs; if that is intended, write it with {_WRITE}=1"
