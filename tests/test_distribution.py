"""The distribution is called urlink-robot, because urlink is another project on PyPI. The packages agree with it."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]

#: Folders that are not part of the repository.
_SKIPPED = {"_build", "build", "dist", "node_modules", "__pycache__"}
_SUFFIXES = {
    "",
    ".cff",
    ".cfg",
    ".ipynb",
    ".json",
    ".md",
    ".py",
    ".rst",
    ".sh",
    ".toml",
    ".txt",
    ".xml",
    ".yaml",
    ".yml",
}

#: Texts that use urlink as the name of a distribution, in any file.
_WRONG = re.compile(
    r"""
    \binstall\s+(?:[^\s`&;|]+\s+)*['"]?urlink(?![\w./-])                  # pip install urlink
    | (?<![\w.-])urlink\\?\[[a-z{]                                       # urlink[plot]
    | \b(?:version|distribution|metadata|requires|files)\(["']urlink["']  # importlib.metadata
    """,
    re.VERBOSE,
)


def texts() -> Iterator[Path]:
    """Yield every text file of the repository."""
    for folder, folders, names in os.walk(ROOT):
        folders[:] = [
            each for each in folders if each not in _SKIPPED and (each[0] != "." or each in (".ci", ".github"))
        ]
        yield from (Path(folder, name) for name in names if Path(name).suffix in _SUFFIXES)


def wrong_lines(text: str) -> list[int]:
    """Return the numbers of the lines that use urlink as the name of a distribution."""
    return [number for number, line in enumerate(text.splitlines(), 1) if _WRONG.search(line)]


def test_no_file_calls_the_distribution_urlink() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in texts()
        if path != Path(__file__).resolve()
        for number in wrong_lines(path.read_text(encoding="utf-8", errors="replace"))
    ]
    assert not found, "'urlink' on PyPI is another project; write 'urlink-robot' in " + ", ".join(found)


@pytest.mark.parametrize(
    "line",
    [
        "pip install urlink",
        "pip install 'urlink[plot]'",
        "`pip install -U urlink`, then",
        "uv pip install rich urlink==1.0.2",
        'match=r"urlink\\[mcap\\]"',
        'f"{package}: urlink[{extra}]"',
        'version("urlink")',
    ],
)
def test_wrong_lines_finds_the_distribution_urlink(line: str) -> None:
    assert wrong_lines(line) == [1]


@pytest.mark.parametrize(
    "line",
    [
        "pip install 'urlink-robot[plot]'",
        "pip install urlink-mqtt && urlink serve mqtt",
        "pip install -q '.[cli]' && .venv/bin/urlink monitor sim://",
        "import urlink",
        "pip install urlink_robot-0.1.0-py3-none-any.whl",
    ],
)
def test_wrong_lines_ignores_the_package_urlink(line: str) -> None:
    assert wrong_lines(line) == []


def test_no_pyproject_requires_urlink() -> None:
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 cannot read TOML")
    found = []
    for path in texts():
        if path.name != "pyproject.toml":
            continue
        text = path.read_text(encoding="utf-8")
        project = tomllib.loads(text)["project"]
        extras = project.get("optional-dependencies", {}).values()
        required = [*project.get("dependencies", ()), *(each for extra in extras for each in extra)]
        for requirement in [project["name"], *required]:
            if re.match(r"urlink(?![\w.-])", requirement):
                line = next(n for n, each in enumerate(text.splitlines(), 1) if f'"{requirement}"' in each)
                found.append(f"{path.relative_to(ROOT)}:{line}")
    assert not found, "'urlink' on PyPI is another project; write 'urlink-robot' in " + ", ".join(found)


#: Versions of Python that the tests of a package were run on, as docs/support.md states; the others on 3.11 only.
PYTHONS = {
    **dict.fromkeys(("", "accept", "compat", "view"), ("3.10", "3.11", "3.12", "3.13", "3.14")),
    "lerobot": ("3.11", "3.12"),
}
FOLDERS = {"": ROOT, **{path.parent.name: path.parent for path in sorted(ROOT.glob("packages/*/pyproject.toml"))}}


def project(name: str) -> dict[str, Any]:
    tomllib = pytest.importorskip("tomllib", reason="Python 3.10 cannot read TOML")
    found: dict[str, Any] = tomllib.loads((FOLDERS[name] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return found


def released() -> str:
    """Return the newest version of the changelog."""
    heading = re.search(r"(?m)^## \[(\d+\.\d+\.\d+)\] - ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert heading is not None
    return heading[1]


@pytest.mark.parametrize("name", FOLDERS)
def test_classifiers_claim_what_was_run(name: str) -> None:
    claim = "Programming Language :: Python :: 3."
    given, library = project(name)["classifiers"], project("")["classifiers"]
    assert [each for each in given if claim not in each] == [each for each in library if claim not in each]
    versions = [each.rpartition(" ")[2] for each in given if claim in each]
    assert versions == list(PYTHONS.get(name, ("3.11",)))
    for source in (FOLDERS[name] / "src").iterdir():
        assert source.name.startswith(".") or (source / "py.typed").exists(), "the classifier Typed is wrong"


@pytest.mark.parametrize("name", [each for each in FOLDERS if each])
def test_packages_are_released_with_the_library(name: str) -> None:
    given, library = project(name), project("")
    for key in ("license", "license-files", "authors", "requires-python"):
        assert given[key] == library[key], key
    assert (FOLDERS[name] / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    assert given["version"] == released()
    (required,) = (each for each in given["dependencies"] if each.startswith("urlink-robot"))
    major, minor, _ = map(int, released().split("."))
    assert required == f"urlink-robot>={major}.{minor}.dev0,<{major}.{minor + 1}"


def test_release_workflow_publishes_every_distribution() -> None:
    workflow = (ROOT / ".github/workflows/release.yml").read_text(encoding="utf-8")
    listed = re.search(r"package: \[(.*)\]", workflow)
    assert listed is not None
    assert listed[1].split(", ") == [each for each in FOLDERS if each]
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert [name for name in map(project, FOLDERS) if f"`{name['name']}`" not in page] == []


@pytest.mark.parametrize("name", [each for each in FOLDERS if each])
def test_first_example_of_each_package_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / ".ci")
    found = importlib.import_module("first_example").commands((FOLDERS[name] / "README.md").read_text(encoding="utf-8"))
    assert found
    assert not [each for each in found if "192.168" in " ".join(each) or "pip" in each]


@pytest.fixture
def other(tmp_path: Path) -> Path:
    """Folder with the files of urlink 1.0.2 from PyPI, as pip installs them."""
    site = tmp_path / "site"
    metadata = site / "urlink-1.0.2.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.4\nName: urlink\nVersion: 1.0.2\n", encoding="utf-8")
    owned = ["tests/__init__.py", "urlink/__init__.py", "urlink/client.py", "urlink-1.0.2.dist-info/METADATA"]
    (metadata / "RECORD").write_text("".join(f"{each},,\n" for each in owned), encoding="utf-8")
    (site / "urlink").mkdir()
    (site / "urlink" / "__init__.py").write_text('__version__ = "1.0.2"\n', encoding="utf-8")
    return site


def run(program: str, *first: Path) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(map(str, [*first, ROOT / "src", *ROOT.glob("*/mqtt/src")]))
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(program)],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )


@pytest.mark.real_time
@pytest.mark.parametrize("module", ["rhdlink", "linkcore.clock", "urlink_mqtt"])
def test_import_warns_when_another_urlink_shadows_it(other: Path, module: str) -> None:
    done = run(f"import {module}", other)
    assert "the distribution 'urlink' 1.0.2 is installed" in done.stderr
    assert "'import urlink' finds the package of the other project" in done.stderr
    assert "pip uninstall -y urlink" in done.stderr
    # The packages need urlink, so their import fails after the warning; rhdlink does not.
    assert (done.returncode != 0) == (module == "urlink_mqtt"), done.stderr


@pytest.mark.real_time
def test_import_warns_when_another_urlink_is_shadowed(other: Path) -> None:
    done = run(f"import sys; sys.path.append({str(other)!r}); import urlink; urlink.BadValue")
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("the distribution 'urlink' 1.0.2 is installed") == 1
    assert "'import urlink' finds the package of urlink-robot" in done.stderr


@pytest.mark.real_time
def test_import_is_silent_when_the_distribution_has_no_package(other: Path) -> None:
    """A checkout that was installed while this project's distribution was called urlink looks like this."""
    (other / "urlink-1.0.2.dist-info" / "RECORD").write_text("_editable_impl_urlink.pth,,\n", encoding="utf-8")
    done = run(f"import sys; sys.path.append({str(other)!r}); import rhdlink, urlink")
    assert (done.returncode, done.stderr) == (0, "")
