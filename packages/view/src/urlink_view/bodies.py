"""Bodies of the links of an arm, from URDF: generated cylinders and spheres, or a file with meshes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from urlink import LocalError
from urlink.arm.kinematics import Arm
from urlink.arm.poses import rotvec_to_quaternion, rpy_to_rotvec
from urlink.arm.urdf import LINKS, link_poses, to_urdf
from urlink.tools import FloatArray, needs

#: Link of a URDF -> frame of this library for drawing it. The vendor's base link for bodies is the controller's
#: base.
_FRAMES = {"base_link_inertia": "base_link", **{name: name for name in ("base_link", *LINKS, "tool0")}}
_JOINTS_COLOUR = (93, 138, 168)


class Bodies:
    """Bodies of an arm in a scene of viser, below a node.

    Args:
        scene: Scene of viser.
        node: Name of the node, such as "/actual".
        arm: Arm that determines the positions of the links.
        urdf: File whose links have the vendor's names, and visuals; None for shapes from the kinematics.
        colour: Colour of cylinders, boxes and, if translucent, of meshes.
        opacity: Opacity; 1 is opaque.

    Raises:
        LocalError: If the file, or a mesh in it, cannot be read, or it contains nothing to draw.
    """

    def __init__(
        self, scene: Any, node: str, arm: Arm, urdf: Path | None, colour: tuple[int, int, int], opacity: float = 1.0
    ) -> None:
        self._arm = arm
        self.root = scene.add_frame(node, show_axes=False)
        self._frames: list[Any] = []
        paths = {"base_link": f"{node}/base_link"}
        scene.add_frame(paths["base_link"], show_axes=False)
        for parent, child, _ in link_poses(arm, np.zeros((1, 6))):
            paths[child] = f"{paths[parent]}/{child}"
            self._frames.append(scene.add_frame(paths[child], show_axes=False))
        found = 0
        for link, k, visual in _visuals(urdf, arm):
            if link in _FRAMES:
                _draw(scene, f"{paths[_FRAMES[link]]}/{link}_{k}", visual, urdf, colour, opacity)
                found += 1
        if not found:
            raise LocalError(f"{urdf} has no bodies for the arm; expected <visual> in links such as {LINKS[0]}")

    def show(self, q: FloatArray) -> None:
        """Move the links to their poses at joint positions, shape (6,), in rad."""
        for frame, (_, _, poses) in zip(self._frames, link_poses(self._arm, q[np.newaxis]), strict=True):
            frame.position = poses[0, :3]
            frame.wxyz = wxyz(poses[0, 3:])


def wxyz(rotvec: FloatArray) -> FloatArray:
    """Return the quaternion of a rotation vector, in the order of viser."""
    return np.roll(rotvec_to_quaternion(rotvec), 1)


def _visuals(urdf: Path | None, arm: Arm) -> list[tuple[str, int, ElementTree.Element]]:
    try:
        root = ElementTree.fromstring(to_urdf(arm, shapes=True) if urdf is None else urdf.read_text(encoding="utf-8"))
    except (OSError, ValueError, ElementTree.ParseError) as error:
        raise LocalError(f"cannot read {urdf} as URDF: {error}") from error
    return [
        (link.get("name", ""), k, visual)
        for link in root.iter("link")
        for k, visual in enumerate(link.findall("visual"))
        if visual.find("geometry") is not None
    ]


def _draw(
    scene: Any, node: str, visual: ElementTree.Element, urdf: Path | None, colour: tuple[int, int, int], opacity: float
) -> None:
    with needs("", "a view in a browser", "urlink-view"):
        import trimesh
    origin, shape = visual.find("origin"), visual.find("geometry/*")
    said: Mapping[str, str] = {} if origin is None else origin.attrib
    place = {
        "position": _numbers(said.get("xyz", "0 0 0")),
        "wxyz": wxyz(rpy_to_rotvec(_numbers(said.get("rpy", "0 0 0")))),
    }
    if shape is None:
        return
    if shape.tag == "mesh":
        mesh = _mesh(trimesh, shape.get("filename", ""), urdf)
        mesh.apply_scale(_numbers(shape.get("scale", "1 1 1")))
        if opacity == 1.0:
            scene.add_mesh_trimesh(node, mesh, **place)  # with its own colours
            return
    elif shape.tag == "sphere":
        mesh = trimesh.creation.icosphere(3, float(shape.get("radius", 0.0)))
        colour = _JOINTS_COLOUR if opacity == 1.0 else colour
    elif shape.tag == "cylinder":
        mesh = trimesh.creation.cylinder(float(shape.get("radius", 0.0)), float(shape.get("length", 0.0)))
    else:
        mesh = trimesh.creation.box(_numbers(shape.get("size", "0 0 0")))
    scene.add_mesh_simple(node, mesh.vertices, mesh.faces, color=colour, opacity=opacity, cast_shadow=False, **place)


def _mesh(trimesh: Any, name: str, urdf: Path | None) -> Any:
    """Load a mesh from a path relative to the URDF, or from a package whose folder is next to or above the URDF."""
    assert urdf is not None
    if name.startswith("package://"):
        inside = name.removeprefix("package://")
        package, _, rest = inside.partition("/")
        places = [folder / inside for folder in urdf.resolve().parents]
        places += [folder / rest for folder in urdf.resolve().parents if folder.name == package]
    else:
        places = [urdf.parent / name.removeprefix("file://")]
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        raise LocalError(f"{urdf} refers to the mesh {name}, which does not exist at {places[0]}")
    try:
        return trimesh.load(path, force="mesh")
    except (ImportError, ValueError, OSError, KeyError) as error:  # the format needs another package, or is damaged
        raise LocalError(f"cannot read the mesh {path}: {error}") from error


def _numbers(text: str) -> FloatArray:
    return np.array([float(each) for each in text.split()])
