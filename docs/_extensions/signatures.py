"""Short types in the API reference: `Joints`, `Pose` and `ArrayLike` instead of the unions that they stand for.

Python evaluates an annotation to the union that its alias stands for, and the union of `ArrayLike` fills three lines.
This extension evaluates the annotations itself. It replaces each alias by an empty class with the name that a reader
knows, and `references.py` links this name to its description on the page *API reference*.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import inspect
import sys
from typing import TYPE_CHECKING, Any

from urlink.arm.vectors import Numbers

if TYPE_CHECKING:
    from sphinx.application import Sphinx

#: Heading of the page api.md that describes these types, as the anchor of a link.
ANCHOR = "types-in-signatures"

#: Arguments that are six joint positions, and arguments that are a pose, if their type is `Numbers`.
_JOINTS = frozenset({"q", "near"})
_POSES = frozenset({"pose", "via", "to", "tcp"})


class _Shown(type):
    """Class of the empty classes that stand for a type. `NDArray[np.float64]` is shown as `NDArray`."""

    def __getitem__(cls, item: object) -> _Shown:
        return cls


def _shown(name: str) -> _Shown:
    # Sphinx shows a class of this module without the name of its module.
    return _Shown(name, (), {"__module__": "builtins"})


_JOINTS_TYPE, _POSE_TYPE, _ARRAY_LIKE, _ARRAY = map(_shown, ("Joints", "Pose", "ArrayLike", "NDArray"))
#: Names of the types that are shown.
NAMES = frozenset({"Joints", "Pose", "ArrayLike", "NDArray"})

#: Alias in the source -> type that is shown.
_ALIASES = {"ArrayLike": _ARRAY_LIKE, "NDArray": _ARRAY, "FloatArray": _ARRAY}


def _numbers(argument: str) -> _Shown:
    """Type that is shown for `Numbers`, the alias for a row of numbers, as the type of an argument."""
    return _JOINTS_TYPE if argument in _JOINTS else _POSE_TYPE if argument in _POSES else _ARRAY_LIKE


@functools.cache
def only_for_types(module: str) -> dict[str, Any]:
    """Names that a module imports only for type checkers. Imports that fail are left out."""
    found: dict[str, Any] = {}
    with contextlib.suppress(OSError, TypeError):
        tree = ast.parse(inspect.getsource(sys.modules[module]))
        names = {"__name__": module, "__package__": sys.modules[module].__package__}
        for block in tree.body:
            if isinstance(block, ast.If) and ast.unparse(block.test) == "TYPE_CHECKING":
                for statement in block.body:
                    with contextlib.suppress(ImportError):
                        exec(compile(ast.Module([statement], []), module, "exec"), names, found)
    return found


def types_of(function: Any) -> dict[str, Any]:
    """Annotations of a function, evaluated in its own module, with the types that are shown.

    An annotation that cannot be evaluated is a string.
    """
    module = function.__module__
    names = {**only_for_types(module), **vars(sys.modules[module])}
    aliases = {name: shown for name, shown in _ALIASES.items() if name in names}
    found: dict[str, Any] = {}
    for argument, annotation in function.__annotations__.items():
        found[argument] = annotation
        if isinstance(annotation, str):
            # Another module uses this name for another alias.
            if names.get("Numbers") is Numbers:
                aliases["Numbers"] = _numbers(argument)
            with contextlib.suppress(Exception):
                found[argument] = eval(annotation, {**names, **aliases})
    return found


def resolve(app: Sphinx, function: Any, is_bound: bool) -> None:
    """Evaluate the annotations of a function before Sphinx reads them."""
    # A class method is bound; its annotations are those of its function.
    function = getattr(function, "__func__", function)
    with contextlib.suppress(AttributeError, KeyError, TypeError):
        # Sphinx reads a wrapped function and its wrapper.
        wrapped = inspect.unwrap(function)
        function.__annotations__ = wrapped.__annotations__ = types_of(wrapped)


def hide_constructor(
    app: Sphinx, what: str, name: str, found: Any, options: Any, signature: str, returned: str
) -> tuple[str, str] | None:
    """Hide the arguments of a class that only the library creates: its page has `:exclude-members: __init__`."""
    return ("", "") if what == "class" and "__init__" in (options.exclude_members or ()) else None


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the functions above."""
    # Sphinx evaluates the types of attributes and properties without an event.
    app.config.autodoc_type_aliases = {name: shown.__name__ for name, shown in _ALIASES.items()}
    app.connect("autodoc-before-process-signature", resolve)
    app.connect("autodoc-process-signature", hide_constructor)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
