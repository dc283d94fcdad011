"""The reference tables in docs/tables/ equal the output of docs/make_tables.py."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("sphinx", reason="sphinx is not installed; `nox -s docs` compares the tables too")

SCRIPT = Path(__file__).resolve().parents[1] / "docs" / "make_tables.py"


@pytest.mark.slow
@pytest.mark.real_time
def test_committed_tables_are_up_to_date() -> None:
    done = subprocess.run([sys.executable, str(SCRIPT), "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
