"""Places of files on a controller, by name.

The vendor documents ``/programs`` as the folder for programs and user data. The other paths are from public backup
scripts and notes of users of CB3 and e-Series controllers. None of the paths was verified on a robot.
"""

from __future__ import annotations

import posixpath
from collections.abc import Mapping
from typing import NamedTuple

from urlink import BadValue
from urlink.tools import printable, similar


class Place(NamedTuple):
    """Folder of a controller.

    Attributes:
        folder: Path of the folder.
        patterns: Patterns of the files that belong to the place.
        content: What the files are.
    """

    folder: str
    patterns: tuple[str, ...]
    content: str


#: Name of a place -> its folder.
PLACES: Mapping[str, Place] = {
    "programs": Place("/programs", ("*",), "programs (.urp, .script), installations and variables"),
    "logs": Place("/root", ("log_history*", "polyscope.log*"), "logs of the controller and of PolyScope"),
    "flightreports": Place("/root/flightreports", ("*",), "flight reports, which the controller makes after faults"),
}


def patterns_of(name: str) -> list[str]:
    """Return the paths or patterns on the controller for a name from a user.

    ``programs`` gives the patterns of this place, ``programs/*.urp`` a pattern in its folder, and a name that begins
    with a slash itself.

    Raises:
        BadValue: If the name does not begin with a place or a slash, or if it leads out of the folder of the place.
    """
    if not isinstance(name, str) or not name.isprintable():
        raise BadValue(f"{name!r} is not a path on the controller")
    if name.startswith("/"):
        return [posixpath.normpath(name)]
    place, _, rest = name.partition("/")
    if place not in PLACES:
        hint = similar(place, PLACES) or f"; expected {', '.join(PLACES)}, or a path that begins with /"
        raise BadValue(f"{printable(place)!r} is not a place on the controller{hint}")
    folder, patterns, _ = PLACES[place]
    if not rest:
        return [posixpath.join(folder, pattern) for pattern in patterns]
    return [_below(folder, rest)]


def target_of(name: str, file: str) -> str:
    """Return the path for a new file on the controller.

    Args:
        name: ``programs``, or a folder below it, such as ``programs/cell``.
        file: Name of the file.

    Raises:
        BadValue: If the name is not in ``programs``.
    """
    place, _, rest = name.partition("/")
    if place != "programs":
        raise BadValue(f"{name!r} cannot be written; files can be put only into programs, or a folder below it")
    return _below(PLACES["programs"].folder, posixpath.join(rest, file))


def _below(folder: str, rest: str) -> str:
    path = posixpath.normpath(posixpath.join(folder, rest))
    if not path.startswith(f"{folder}/") or not path.isprintable():
        raise BadValue(f"{printable(rest)!r} is not below {folder}")
    return path
