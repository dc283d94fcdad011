"""Golden files: texts that somebody has read once, and that a test compares with what the code produces today.

``URLINK_WRITE_GOLDEN=1`` writes them: read the difference before you commit it.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

__all__ = ["check_golden"]

_WRITE = "URLINK_WRITE_GOLDEN"


def check_golden(path: Path, text: str) -> None:
    """Fail if the file does not contain the text; write it first if the environment asks for that."""
    if os.environ.get(_WRITE):
        path.write_text(text, encoding="utf-8")
    if not path.exists():
        pytest.fail(f"{path} does not exist; write it with {_WRITE}=1, and read it before you commit it")
    assert text == path.read_text(encoding="utf-8"), f"{path} differs; if that is intended, write it with {_WRITE}=1"
