"""`urlink.compat` is `urlink_compat`, for programs that were written before it was a package of its own."""

from __future__ import annotations

import importlib
import importlib.metadata
import sys

import pytest

import urlink
import urlink_compat.rtde_control
import urlink_compat.urx


def test_each_module_is_one_under_both_names() -> None:
    # Taken before: an import under the other name would replace the attribute of the package.
    urx, rtde_control = urlink_compat.urx, urlink_compat.rtde_control
    assert importlib.import_module("urlink.compat") is urlink_compat
    assert importlib.import_module("urlink.compat.urx") is urx
    assert importlib.import_module("urlink.compat.rtde_control") is rtde_control


def test_it_is_an_attribute_of_the_library() -> None:
    assert urlink.compat is urlink_compat  # type: ignore[attr-defined]
    assert "compat" not in dir(urlink)


def test_a_module_that_is_not_there_is_not_found() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'urlink\.compat\.dashboard_client'"):
        importlib.import_module("urlink.compat.dashboard_client")


def test_import_says_what_installs_it_when_it_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: ())
    for name in [each for each in sys.modules if each.startswith("urlink.compat")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr(urlink, "compat", raising=False)
    with pytest.raises(ImportError, match="pip install urlink-compat"):
        importlib.import_module("urlink.compat.rtde_control")
    with pytest.raises(ImportError, match="pip install urlink-compat"):
        exec("from urlink import compat")
