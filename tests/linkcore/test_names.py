"""Names that are imported at their first use: the mechanism, and the packages that use it."""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import rhdlink
import urlink
from linkcore.errors import LocalError
from linkcore.names import lazy_names, needs, plugin

PACKAGES = [urlink, rhdlink]
LAZY = [*PACKAGES, urlink.packets, urlink.rtde, rhdlink.host, rhdlink.smrcl, rhdlink.variables]


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    made = ModuleType("made")
    monkeypatch.setitem(sys.modules, "made", made)
    get, names, public = lazy_names("made", {"json": "loads dumps", "fractions": "Fraction"})
    vars(made).update(__getattr__=get, __dir__=names, __all__=public)
    return made


def test_lazy_name_returns_the_object_of_its_module(package: ModuleType) -> None:
    assert package.loads is json.loads
    assert vars(package)["loads"] is json.loads, "after its first use the name is an attribute of the package"
    assert "dumps" not in vars(package)


def test_dir_and_star_import_show_public_names_only(package: ModuleType) -> None:
    assert dir(package) == ["Fraction", "dumps", "loads"]
    found: dict[str, object] = {}
    exec("from made import *", found)
    assert found.keys() >= {"Fraction", "dumps", "loads"}


def test_unknown_name_raises_attribute_error(package: ModuleType) -> None:
    with pytest.raises(AttributeError, match="module 'made' has no attribute 'load'"):
        package.load  # noqa: B018
    assert not hasattr(package, "json")


@pytest.mark.real_time
def test_module_is_imported_at_first_use() -> None:
    program = "import sys, urlink; before = 'urlink.arm.poses' in sys.modules; urlink.poses.compose; print(before)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize("package", LAZY)
def test_names_for_type_checkers_equal_lazy_names(package: ModuleType) -> None:
    assert package.__file__ is not None
    tree = ast.parse(Path(package.__file__).read_text(encoding="utf-8"))
    (branch,) = (node for node in tree.body if isinstance(node, ast.If))
    resolved = {}
    for node in branch.body:
        assert isinstance(node, ast.ImportFrom)
        module = importlib.import_module("." * node.level + (node.module or ""), package.__name__)
        for alias in node.names:
            assert alias.asname == alias.name, "type checkers export a name only if it is imported as itself"
            whole = f"{module.__name__}.{alias.name}"
            is_module = hasattr(module, "__path__") and importlib.util.find_spec(whole) is not None
            resolved[alias.name] = importlib.import_module(whole) if is_module else getattr(module, alias.name)
    assert sorted(resolved) == dir(package)
    for name, value in resolved.items():
        assert getattr(package, name) is value


@pytest.mark.parametrize("package", LAZY)
def test_public_names_differ_from_module_names(package: ModuleType) -> None:
    """Importing a module of the same name would replace the public name."""
    assert package.__file__ is not None
    modules = {path.stem for path in Path(package.__file__).parent.iterdir()}
    assert modules & set(package.__all__) == set()


def test_attribute_error_in_a_module_raises_import_error(
    package: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python would otherwise report that the name does not exist."""
    (tmp_path / "broken_module.py").write_text("import math\nmath.sine(1.0)\nName = 1\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    get, _, _ = lazy_names("made", {"broken_module": "Name"})
    monkeypatch.setattr(package, "__getattr__", get)
    message = "^broken_module of made cannot be imported: module 'math' has no attribute 'sine'$"
    with pytest.raises(ImportError, match=message):
        exec("from made import Name", {})
    with pytest.raises(ImportError, match=message):
        hasattr(package, "Name")


def test_lazy_submodule_is_available_under_its_last_name() -> None:
    get, names, public = lazy_names("email", {"json": "loads"}, modules="mime.text utils")
    assert get("text") is importlib.import_module("email.mime.text")
    assert (names(), public) == (["loads", "text", "utils"], ["loads"])


@pytest.mark.parametrize("package", PACKAGES)
@pytest.mark.real_time
def test_importing_a_package_does_not_import_its_modules(package: ModuleType) -> None:
    program = f"import sys; import {package.__name__}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    ours = {name for name in done.stdout.split() if name.partition(".")[0] in ("linkcore", "urlink", "rhdlink")}
    assert ours == {"linkcore", "linkcore.names", package.__name__}
    assert "numpy" not in done.stdout.split()


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[importlib.metadata.EntryPoint]]:
    """Map of groups to their entry points, which replaces the entry points of installed distributions."""
    found: dict[str, list[importlib.metadata.EntryPoint]] = {}
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: found.get(group, []))
    return found


def test_plugin_loads_the_object_of_an_entry_point(entries: dict[str, list[importlib.metadata.EntryPoint]]) -> None:
    entries["made.parsers"] = [importlib.metadata.EntryPoint("json", "json:loads", "made.parsers")]
    assert plugin("made.parsers", "json", "made-json", "reading") is json.loads


@pytest.mark.parametrize(
    ("distribution", "install"),
    [("made-json", "pip install made-json"), ("made-json[fast]", "pip install 'made-json[fast]'")],
)
@pytest.mark.usefixtures("entries")
def test_missing_plugin_error_names_the_install_command(distribution: str, install: str) -> None:
    with pytest.raises(LocalError) as refused:
        plugin("made.parsers", "json", distribution, "reading")
    assert str(refused.value) == f"reading needs the package made-json, which is not installed: {install}"


@pytest.mark.parametrize(
    ("extra", "distribution", "says"),
    [("fast", "made-json", "pip install 'made-json[fast]'"), ("", "made-json", "pip install made-json")],
)
def test_needs_error_names_the_extra_to_install(extra: str, distribution: str, says: str) -> None:
    with pytest.raises(LocalError, match=f"not installed: {re.escape(says)}$"), needs(extra, "reading", distribution):
        importlib.import_module("made_no_such")


def test_lazy_names_imports_packages_of_other_distributions(
    package: ModuleType, monkeypatch: pytest.MonkeyPatch, entries: dict[str, list[importlib.metadata.EntryPoint]]
) -> None:
    monkeypatch.setattr(sys, "meta_path", sys.meta_path[:])
    get, names, public = lazy_names("made", {"json": "loads"}, packages={"mail": "made-mail"})
    monkeypatch.setattr(package, "__getattr__", get)
    monkeypatch.setattr(package, "__path__", [], raising=False)
    with pytest.raises(ImportError, match=r"^import made\.mail needs the package made-mail.*: pip install made-mail$"):
        importlib.import_module("made.mail.utils")
    entries["made.packages"] = [importlib.metadata.EntryPoint("mail", "email", "made.packages")]
    try:
        assert importlib.import_module("made.mail.utils") is importlib.import_module("email.utils")
        assert package.mail is importlib.import_module("email")
    finally:
        for name in [each for each in sys.modules if each.startswith("made.")]:
            del sys.modules[name]
    assert (names(), public) == (["loads"], ["loads"])
