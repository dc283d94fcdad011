"""The packages use only the public API of the library, and the library uses no middleware."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted((ROOT / "packages").glob("*/pyproject.toml"))

#: Import names of the middlewares and frameworks that packages and examples connect a robot to.
MIDDLEWARES = {
    "zenoh",
    "RobotRaconteur",
    "RobotRaconteurCompanion",
    "rclpy",
    "rcl_interfaces",
    "sensor_msgs",
    "geometry_msgs",
    "trajectory_msgs",
    "control_msgs",
    "std_msgs",
    "std_srvs",
    "gymnasium",
    "openpi_client",
    "lerobot",
    "mujoco",
    "draccus",
    "prometheus_client",
    "asyncua",
    "asyncssh",
    "torch",
    "fastapi",
    "mcp",
    "mcp_types",
    "pydantic",
    "uvicorn",
}

#: Modules that are public in addition to the names of their package, as listed on the API page.
PUBLIC = {
    # The clock of the library, so that ages and deadlines of a package agree with it.
    "linkcore.clock",
    # Imported before urlink, to warn about another distribution with this name.
    "linkcore",
    "urlink.arm.kinematics",
    "urlink.arm.mjcf",
    "urlink.arm.models",
    "urlink.motion",
    "urlink.packets",
    "urlink.arm.poses",
    "urlink.rtde",
    "urlink.simulator",
    # Additional names for tools; the docstring of the module states its guarantees.
    "urlink.tools",
    "urlink.arm.urdf",
    "rhdlink.host",
    "rhdlink.robots",
    "rhdlink.smrcl",
    "rhdlink.variables",
}


def imported(path: Path) -> Iterator[tuple[str, str]]:
    """Yield (module, name) for each import of a file; the name is empty if the module itself is imported."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield from ((node.module or "", alias.name) for alias in node.names)


def is_public(module: str, name: str) -> bool:
    package = module.partition(".")[0]
    if package not in ("urlink", "rhdlink", "linkcore"):
        return True
    if module in PUBLIC or f"{module}.{name}" in PUBLIC:
        return not name.startswith("_")
    return module in ("urlink", "rhdlink") and (not name or name in dir(importlib.import_module(module)))


def test_is_public_distinguishes_public_names() -> None:
    assert is_public("urlink", "connect")
    assert is_public("urlink", "poses")
    assert is_public("urlink.simulator", "Controller")
    for module, name in (("linkcore.handle", "Handle"), ("urlink.robot", "Robot"), ("urlink", "_no")):
        assert not is_public(module, name)


def test_library_does_not_import_middlewares() -> None:
    found = {
        (str(path.relative_to(ROOT)), module)
        for path in (ROOT / "src").rglob("*.py")
        if any(middleware in path.read_text(encoding="utf-8") for middleware in MIDDLEWARES)
        for module, _ in imported(path)
        if module.partition(".")[0] in MIDDLEWARES
    }
    assert found == set()


def test_library_does_not_import_packages() -> None:
    """The library finds packages through their entry points."""
    packages = {path.name for path in ROOT.glob("packages/*/src/*")}
    assert {"urlink_accept", "urlink_compat", "urlink_view"} <= packages
    found = {
        (str(path.relative_to(ROOT)), module)
        for path in (ROOT / "src").rglob("*.py")
        if any(package in path.read_text(encoding="utf-8") for package in packages)
        for module, _ in imported(path)
        if module.partition(".")[0] in packages
    }
    assert found == set()


#: Abstract members of the base classes of LeRobot 0.4.4 and 0.6.1, copied from its source code. LeRobot needs torch,
#: which is not installed in this environment.
LEROBOT = {
    "ur.py": {
        *("observation_features", "action_features", "is_connected", "is_calibrated"),
        *("connect", "calibrate", "configure", "get_observation", "send_action", "disconnect"),
    },
    "leader.py": {
        *("action_features", "feedback_features", "is_connected", "is_calibrated"),
        *("connect", "calibrate", "configure", "get_action", "send_feedback", "disconnect"),
    },
}


@pytest.mark.parametrize("module", LEROBOT)
def test_lerobot_classes_implement_all_abstract_members(module: str) -> None:
    path = ROOT / "packages/lerobot/src/lerobot_robot_urlink" / module
    classes = [node for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.ClassDef)]
    defined = {node.name for each in classes for node in each.body if isinstance(node, ast.FunctionDef)}
    assert LEROBOT[module] <= defined


@pytest.mark.parametrize("project", PACKAGES, ids=lambda path: path.parent.name)
def test_package_imports_public_names_only(project: Path) -> None:
    sources = list((project.parent / "src").rglob("*.py")) + list(project.parent.glob("examples/*.py"))
    assert sources
    bad = [
        (str(path.relative_to(ROOT)), module, name)
        for path in sources
        for module, name in imported(path)
        if not is_public(module, name)
    ]
    assert bad == []


@pytest.mark.parametrize("project", PACKAGES, ids=lambda path: path.parent.name)
def test_package_uses_no_private_names_of_other_packages(project: Path) -> None:
    """An attribute with an underscore must belong to `self`, or be defined by the same file."""
    for path in (project.parent / "src").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        own = {
            node.attr
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
        } | {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}
        used = {
            node.attr
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and node.attr.startswith("_") and not node.attr.startswith("__")
        }
        assert used <= own, f"{path}: {sorted(used - own)}"
