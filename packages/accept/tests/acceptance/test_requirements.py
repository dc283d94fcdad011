from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

import urlink_accept.acceptance.requirements as module
from linkcore.errors import BadValue
from urlink_accept.acceptance.report import CHECKS
from urlink_accept.acceptance.requirements import from_file, requirements
from urlink_accept.acceptance.stages import STAGES

ROOT = Path(__file__).resolve().parents[4]
TABLE = Path(module.__file__).with_name("requirements.toml")


def test_each_requirement_has_one_check() -> None:
    assert requirements().keys() == CHECKS.keys()
    assert {each.stage for each in requirements().values()} == set(STAGES)


def test_requirements_are_sorted_by_stage() -> None:
    numbers = [each.stage for each in requirements().values()]
    assert numbers == sorted(numbers)


@pytest.mark.skipif(sys.version_info < (3, 11), reason="tomllib came with Python 3.11")
def test_tomllib_reads_same_requirements() -> None:
    import tomllib

    told = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    keys = ("stage", "what", "limit", "unit", "why", "source")
    assert {name: {key: getattr(each, key) for key in keys} for name, each in requirements().items()} == told


@pytest.mark.parametrize("name", requirements())
def test_source_files_of_requirements_exist(name: str) -> None:
    """Each source file exists, and each requirement has a reason."""
    each = requirements()[name]
    assert each.why
    for file in re.findall(r"(?:docs|src)/[\w./-]+\w", each.source):
        assert (ROOT / file).is_file(), file


def test_requirements_file_of_user_changes_limits_and_site(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(
        '# ours\n[site]\nowner = "A. Nother"\n\n[clock-drift]\nlimit = 50\nwhy = "a camera is synchronised"\n',
        encoding="utf-8",
    )
    found, site = from_file(path)
    assert site == {"owner": "A. Nother"}
    assert (found["clock-drift"].limit, found["clock-drift"].why) == (50, "a camera is synchronised")
    assert found["clock-drift"].source == requirements()["clock-drift"].source
    assert {name for name in found if found[name] != requirements()[name]} == {"clock-drift"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[clock-drive]\nlimit = 1", "'clock-drive'"),
        ("[clock-drift]\nstage = 1", "sets stage; your own file can set only limit, why, source"),
        ("[clock-drift]\nlimit = -1", "limit = -1"),
        ("[clock-drift]\nlimit = true", "limit = True"),
        ("[clock-drift]\nlimit = NaN", "limit = nan"),
        ("[clock-drift]\nlimit = 1 # ours", "line 2"),
        ("limit = 1", "line 1"),
        ("[site]\nowner = 'x'", "line 2"),
        ("[site]\n[site]", "line 2"),
    ],
)
def test_errors_name_line_or_value(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadValue, match=re.escape(said)):
        from_file(path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match=r"none\.toml"):
        from_file(tmp_path / "none.toml")
