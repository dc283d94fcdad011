"""`urlink.compat` is `urlink_compat`, for programs from the time before it was a separate package."""

from __future__ import annotations

import importlib
import importlib.metadata
import sys

import pytest

import urlink
import urlink_compat.rtde_control
import urlink_compat.urx


def test_modules_are_identical_under_both_names() -> None:
    # Read these before: an import under the other name would replace the attribute of the package.
    urx, rtde_control = urlink_compat.urx, urlink_compat.rtde_control
    assert importlib.import_module("urlink.compat") is urlink_compat
    assert importlib.import_module("urlink.compat.urx") is urx
    assert importlib.import_module("urlink.compat.rtde_control") is rtde_control


def test_compat_is_attribute_of_urlink() -> None:
    assert urlink.compat is urlink_compat  # type: ignore[attr-defined]
    assert "compat" not in dir(urlink)


def test_missing_module_raises_module_not_found() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'urlink\.compat\.dashboard_client'"):
        importlib.import_module("urlink.compat.dashboard_client")


def test_import_error_names_package_when_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: ())
    for name in [each for each in sys.modules if each.startswith("urlink.compat")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr(urlink, "compat", raising=False)
    with pytest.raises(ImportError, match="pip install urlink-compat"):
        importlib.import_module("urlink.compat.rtde_control")
    with pytest.raises(ImportError, match="pip install urlink-compat"):
        exec("from urlink import compat")
