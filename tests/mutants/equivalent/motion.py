from __future__ import annotations

from tests.mutants.equivalent import Equivalent

EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(
        "urlink/motion/jerk_limited.py",
        None,
        "1e-12",
        "2e-12",
        "a push misses its target by less than a millionth of the resolution of set-points, or by less than two",
    ),
    Equivalent(
        "urlink/motion/jerk_limited.py",
        "_brake",
        "v + 0.5 * a * abs(a) / jerk > 0.0",
        "v + 0.5 * a * abs(a) / jerk >= 0.0",
        "at zero the joint comes to rest while its acceleration dies away; that is one segment of either way to brake",
    ),
    Equivalent(
        "urlink/motion/jerk_limited.py",
        "_brake",
        "peak > most",
        "peak >= most",
        "the largest acceleration is reached, and held for no time",
    ),
    Equivalent(
        "urlink/motion/root_finding.py",
        "root",
        "value < 0.0",
        "value <= 0.0",
        "a value of zero is good enough at either end of the bracket",
    ),
    Equivalent(
        "urlink/motion/taught.py",
        "save",
        "1",
        "2",
        "how far the lines of the file are indented is for the eye: what is read from it is the same",
    ),
)
