"""The programs in examples/ that drive a robot end where they say, and draw the way."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def output(name: str, *arguments: str) -> str:
    command = [sys.executable, "-W", "error", str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=50, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def way(path: Path) -> list[tuple[float, float]]:
    (line,) = ElementTree.parse(path).getroot().iter("{http://www.w3.org/2000/svg}polyline")
    return [(float(x), float(y)) for x, y in (point.split(",") for point in line.attrib["points"].split())]


def test_the_spiral_closes(tmp_path: Path) -> None:
    text = output("rhd_spiral.py", str(tmp_path / "spiral.svg"))
    assert re.search(r"ended 0\.0[0-2] m from the start", text), text
    points = way(tmp_path / "spiral.svg")
    assert points[-1] == pytest.approx(points[0], abs=1.0)
    # The last leg but one is 4.8 m of the 11 m that 480 pixels show.
    assert max(y for _, y in points) - min(y for _, y in points) == pytest.approx(4.8 * 480 / 11, abs=2.0)


@pytest.mark.parametrize(("radius", "angle"), [(2.0, 135.0), (1.0, -270.0), (0.5, 90.0)])
def test_the_arc_ends_where_it_should(tmp_path: Path, radius: float, angle: float) -> None:
    text = output("rhd_arc.py", str(tmp_path / "arc.svg"), "--radius", str(radius), "--angle", str(angle))
    ended, should = ([float(number) for number in re.findall(r"-?\d+\.\d+", line)] for line in text.splitlines())
    assert ended[:2] == pytest.approx(should[:2], abs=0.002)
    assert ended[2] == pytest.approx(should[2], abs=0.02)
    assert len(way(tmp_path / "arc.svg")) > 100
