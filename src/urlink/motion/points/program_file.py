"""Waypoints of a program file of PolyScope (.urp): XML, compressed with gzip.

The vendor does not document the format. One waypoint that a UR10e has saved is public (notes.md in the repository
pharmbio/robotlab), together with the pose that PolyScope wrote into the script of the same program. The pose that this
module computes from the joint positions and the kinematics of the waypoint agrees with the written pose to 1e-12. The
TCP of this waypoint is zero. The meaning of other TCPs is assumed from the name of the element.

Programs without the element ``JointAngles`` and installations are not read, because no such file with known poses is
public.
"""

from __future__ import annotations

import os
import zlib
from datetime import datetime, timezone
from pathlib import Path
from xml.etree import ElementTree

from linkcore.errors import BadValue
from linkcore.text import printable

from ...arm.bounds import TOOL_LENGTH, check_pose
from ...arm.kinematics import Arm, DhTable
from ...arm.models import Model
from ...arm.vectors import FloatArray, six
from .point import Point
from .point_file import check_name

#: Maximum size of the XML, in bytes. A program of 1000 waypoints has 2 MB.
_LARGEST = 64_000_000
#: Element of the kinematics -> name in a `DhTable`.
_TABLE = {"deltaTheta": "dh_theta", "a": "dh_a", "d": "dh_d", "alpha": "dh_alpha"}


def read_waypoints(path: str | os.PathLike[str], model: Model) -> dict[str, Point]:
    """Return the fixed waypoints of a program by name, in the order of the program.

    The date of the points is the time at which the file was last changed, because the program has no dates.

    Args:
        path: Path of the program.
        model: Model of the arm for which the program was taught. The file does not name it.

    Raises:
        BadValue: If the file is not such a program, if it has no fixed waypoint, or if the kinematics of a waypoint
            belong to another model. The message names the file and the waypoint.
    """
    file = Path(path)
    try:
        packed = file.read_bytes()
        date = datetime.fromtimestamp(int(file.stat().st_mtime), timezone.utc)
    except OSError as error:
        raise BadValue(f"cannot read {file}: {error.strerror or error}") from error
    try:
        return _waypoints(_root(packed), model, date)
    except BadValue as error:
        raise BadValue(f"{file}: {error}") from None


def _root(packed: bytes) -> ElementTree.Element:
    """Return the root element of a program, or raise `BadValue`."""
    unpacking = zlib.decompressobj(16 + zlib.MAX_WBITS)
    try:
        text = unpacking.decompress(packed, _LARGEST)
    except zlib.error as error:
        raise BadValue(f"not compressed with gzip ({error}); expected a .urp file of PolyScope") from None
    if not unpacking.eof:
        raise BadValue(f"the compressed data is cut off, or larger than {_LARGEST // 1_000_000} MB")
    # A document type can define entities that grow without limit. PolyScope writes none.
    if b"<!DOCTYPE" in text:
        raise BadValue("the XML has a document type; expected a .urp file of PolyScope")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise BadValue(f"not a valid XML file: {error}") from None
    if root.tag != "URProgram":
        raise BadValue(f"the first element is {printable(root.tag)!r}; expected the URProgram of a .urp file")
    return root


def _waypoints(root: ElementTree.Element, model: Model, date: datetime) -> dict[str, Point]:
    points: dict[str, Point] = {}
    is_old = False
    for waypoint in root.iter("Waypoint"):
        position = waypoint.find("position")
        if waypoint.get("type") != "Fixed" or position is None:
            continue
        if position.find("JointAngles") is None:
            is_old = True
            continue
        name = (waypoint.get("name") or "").strip()
        try:
            check_name(name)
            point = _point(position, model, date)
        except BadValue as error:
            raise BadValue(f"waypoint {name!r}: {error}") from None
        if points.setdefault(name, point) != point:
            raise BadValue(f"two different waypoints are called {name!r}; rename one of them in PolyScope")
    if is_old:
        raise BadValue("a waypoint has no JointAngles; expected a program that an e-Series controller has saved")
    if not points:
        raise BadValue("the program has no fixed waypoint")
    return points


def _point(position: ElementTree.Element, model: Model, date: datetime) -> Point:
    q = _row(position, "JointAngles", "angles")
    tcp = check_pose(_row(position, "TCPOffset", "pose"), "TCPOffset", TOOL_LENGTH)
    return Point(q, _arm(position, model).forward(q, tcp), tcp, model.name, date)


def _arm(position: ElementTree.Element, model: Model) -> Arm:
    """Return the arm with the kinematics of a waypoint, or with the published ones if the file has none."""
    kinematics = position.find("Kinematics")
    if kinematics is None:
        return Arm(model)
    rows = {name: _row(kinematics, element, "value") for element, name in _TABLE.items()}
    if not any(row.any() for row in rows.values()):
        return Arm(model)  # programs that other tools have written contain zeros
    return Arm.calibrated(model, DhTable(**{name: row.tolist() for name, row in rows.items()}))


def _row(parent: ElementTree.Element, element: str, attribute: str) -> FloatArray:
    """Return the six numbers of an element, or raise `BadValue`."""
    found = parent.find(element)
    text = None if found is None else found.get(attribute)
    if text is None:
        raise BadValue(f"{parent.tag} has no {element} with {attribute!r}")
    try:
        numbers = [float(each) for each in text.split(",")]
    except ValueError:
        raise BadValue(f"{element} is {text!r}; expected six numbers") from None
    return six(numbers, element)
