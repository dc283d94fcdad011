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
    """Scene with a box of 5 cm and 0.3 kg on a table, and a camera."""
    return FOLDER / "table.xml"


@pytest.fixture
def push() -> Path:
    """Scene with a box of 2 kg on a table, a distant ball, and sites for two arms face to face."""
    return FOLDER / "push.xml"
