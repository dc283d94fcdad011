from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

if sys.platform == "linux" and "DISPLAY" not in os.environ:
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is imported

FOLDER = Path(__file__).parent


@pytest.fixture
def table() -> Path:
    """A box of 5 cm and 0.3 kg on a table, and a camera."""
    return FOLDER / "table.xml"


@pytest.fixture
def push() -> Path:
    """A box of 2 kg on a table, a ball far away, and sites of two arms that face each other."""
    return FOLDER / "push.xml"
