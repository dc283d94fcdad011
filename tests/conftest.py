"""Fixtures and settings for every test."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("default", deadline=None, derandomize=False, max_examples=50)
# A gate gives the same verdict on the same tree; `fuzz` and every run at home look for what is new.
settings.register_profile("ci", deadline=None, derandomize=True, max_examples=50, print_blob=True)
settings.register_profile("fuzz", deadline=None, derandomize=False, max_examples=2000, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") else "default"))


@pytest.fixture(scope="session")
def captures(pytestconfig: pytest.Config) -> Path:
    """The folder of real packets. It stands beside the repository, and not everybody has it."""
    # Where the package is imported from does not matter: the folder is found from where the tests are.
    for root in (pytestconfig.rootpath, Path(__file__).resolve().parents[1]):
        folder = root.parent / "shared" / "captures" / "ur"
        if (folder / "MANIFEST.csv").is_file():
            return folder
    pytest.skip("the captures of real controllers (../shared/captures/ur beside the repository) are not here")
