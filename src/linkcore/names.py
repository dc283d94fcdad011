"""Package members that are imported at first use, and errors that suggest the right name for a misspelt attribute.

- `lazy_names` makes the public names of a package (PEP 562), and `needs` says which extra brings a missing package.
- `plugin` loads what a distribution of its own brings, such as a command or a recorder, and says what installs it.
- `StrictAttributes` is a base class whose objects raise an error with a hint when a program reads or sets an attribute
  that they do not have. A misspelt attribute that is set would otherwise be a new one, and change nothing.
"""

from __future__ import annotations

import contextlib
import functools
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, NoReturn, cast

from . import NAME

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: Package -> its module with the names of other libraries. It has `own_name(name)`, which returns None or the own name.
_foreign_names: dict[str, str] = {}


def lazy_names(
    package: str,
    homes: Mapping[str, str],
    modules: str = "",
    foreign: str | None = None,
    packages: Mapping[str, str] | None = None,
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """What makes the public names of a package, so that a program pays for the modules which it uses and no others.

    A package says the same to type checkers, and a test holds the two equal::

        if TYPE_CHECKING:
            from .robot import Robot as Robot
        else:
            __getattr__, __dir__, __all__ = lazy_names(__name__, {".robot": "Robot"})

    A name must not be that of a module of the package: importing the module would replace the name.

    Args:
        package: its `__name__`.
        homes: module -> its public names, separated by blanks. A module that begins with a dot is the package's own.
        modules: modules of the package, separated by blanks, that are found under their last name without being
            imported: `package.poses` for "arm.poses". They are not in `__all__`.
        foreign: the package's module with the names of other libraries; it has `own_name(name)`.
        packages: subpackage -> the distribution that brings it, by an entry point of the group `<package>.packages`.
            It is imported as if it were here, and is not in `__all__`.

    Returns:
        The package's `__getattr__`, `__dir__` and `__all__`.
    """
    home = {name: module for module, names in homes.items() for name in names.split()}
    public = sorted(home)
    of_package = {module.rpartition(".")[2]: f".{module}" for module in modules.split()}

    brought = {} if packages is None else packages

    if foreign is not None:
        _foreign_names[package] = f"{package}{foreign}"
    for name, distribution in brought.items():
        # Before those of Python, which would import the modules of such a package a second time.
        sys.meta_path.insert(0, _Brought(package, name, distribution))

    def imported(module: str) -> Any:
        try:
            return import_module(module, package)
        except AttributeError as error:
            # Python takes that for a name which is not there, and `from package import name` does not show why.
            raise ImportError(f"{module} of {package} cannot be imported: {error}") from error

    def get(name: str) -> Any:
        if name in brought:
            return import_module(f"{package}.{name}")
        if name not in home and name not in of_package:
            from .text import similar  # a package is imported without it

            own = None if name.startswith("_") else foreign_hint(package, name)
            if own is not None:
                raise AttributeError(f"module {package!r} has no {name!r}; here it is: {own}")
            hint = "" if name.startswith("_") else similar(name, [*public, *of_package])
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint}")
        value = imported(of_package[name]) if name in of_package else getattr(imported(home[name]), name)
        setattr(sys.modules[package], name, value)  # from now on it is found without asking here
        return value

    return get, lambda: sorted([*public, *of_package]), public


def foreign_hint(package: str, name: str) -> str | None:
    """What a name of another library is called in a package; None if no table has it.

    Args:
        package: "linkcore" looks in the tables of all packages.
        name: The name.
    """
    for owner, module in _foreign_names.items():
        if package in (owner, "linkcore"):
            own: str | None = import_module(module).own_name(name)
            if own is not None:
                return own
    return None


@contextlib.contextmanager
def needs(extra: str, purpose: str, distribution: str = NAME) -> Iterator[None]:
    """Around the imports of what an extra of the distribution brings; of what it needs itself if `extra` is empty.

    Raises:
        LocalError: it is not installed; says what installs it.
    """
    try:
        yield
    except ImportError as error:
        package = error.name or extra
        from .errors import LocalError  # a package is imported without it

        install = f"'{distribution}[{extra}]'" if extra else distribution
        raise LocalError(f"{purpose} needs {package}, which is not installed: pip install {install}") from error


def plugins(group: str) -> dict[str, EntryPoint]:
    """The entry points that the installed distributions have in a group, by their names."""
    import importlib.metadata  # a package is imported without it

    return {entry.name: entry for entry in importlib.metadata.entry_points(group=group)}


def plugin(group: str, name: str, distribution: str, purpose: str) -> Any:
    """What a distribution of its own brings.

    Args:
        group: of its entry point.
        name: of its entry point.
        distribution: which brings it, with its extra if that is needed: "urlink-view[foxglove]".
        purpose: what needs it, for the error.

    Raises:
        LocalError: it is not installed; says what installs it.
    """
    entry = plugins(group).get(name)
    if entry is None:
        from .errors import LocalError  # a package is imported without it

        raise LocalError(missing_plugin(distribution, purpose))
    return entry.load()


def missing_plugin(distribution: str, purpose: str) -> str:
    """What an error says of a distribution that is not installed."""
    install = f"'{distribution}'" if "[" in distribution else distribution
    return (
        f"{purpose} needs the package {distribution.partition('[')[0]}, which is not installed: pip install {install}"
    )


class _Brought:
    """Finds a subpackage, and the modules in it, in another distribution: each is one module under both names.

    Args:
        package: that the subpackage belongs to.
        name: of the subpackage.
        distribution: which brings it.
    """

    def __init__(self, package: str, name: str, distribution: str) -> None:
        self._group = f"{package}.packages"
        self._name = name
        self._prefix = f"{package}.{name}"
        self._distribution = distribution
        self._there = ""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """For the import system.

        Raises:
            ModuleNotFoundError: the distribution is not installed; says what installs it.
        """
        if name != self._prefix and not name.startswith(f"{self._prefix}."):
            return None
        entry = plugins(self._group).get(self._name)
        if entry is None:
            raise ModuleNotFoundError(missing_plugin(self._distribution, f"import {name}"), name=name)
        from importlib.util import find_spec  # a package is imported without it

        self._there = entry.value
        return None if find_spec(self._elsewhere(name)) is None else ModuleSpec(name, self)  # type: ignore[arg-type]

    def _elsewhere(self, name: str) -> str:
        return self._there + name.removeprefix(self._prefix)

    def create_module(self, spec: ModuleSpec) -> None:
        """For the import system, which makes a module that `exec_module` replaces."""

    def exec_module(self, module: ModuleType) -> None:
        """For the import system, which goes on with what is in `sys.modules` after it."""
        sys.modules[module.__name__] = import_module(self._elsewhere(module.__name__))


#: argument here -> what other libraries call it
_KEYWORDS = {
    "speed": "v vel velocity max_vel max_velocity",
    "acceleration": "a acc accel max_acc max_acceleration",
    "time": "t duration",
    "blend": "r radius blend_radius",
    "wait": "asynchronous async_ is_async blocking block",
}
_OWN_KEYWORDS = {name: own for own, names in _KEYWORDS.items() for name in names.split()}

#: A method with one of these arguments moves something, so its foreign arguments get a hint.
_OF_MOVES = frozenset({"speed", "acceleration", "wait"})


class StrictAttributes:
    """An object whose users can only read and set attributes that it has.

    Code of the packages that its classes come from can add attributes. Any other code can set one that exists, and can
    replace a method by another function, as tests do. Names that begin with an underscore are not checked when they
    are set.

    A method with an argument `speed`, `acceleration` or `wait` answers an unknown argument with a hint.
    """

    __slots__ = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name, method in list(vars(cls).items()):
            if isinstance(method, FunctionType) and (name == "__init__" or name[0] != "_") and _moves(method):
                setattr(cls, name, _explaining_arguments(method))

    def _hint(self, name: str) -> str | None:
        """The end of the message for a public name that this object does not have; None for the usual hints."""
        return None

    if not TYPE_CHECKING:  # type checkers must not take it for an object with any attribute

        def __getattr__(self, name: str) -> object:
            raise unknown_attribute(self, name)

        def __setattr__(self, name: str, value: object) -> None:
            if name[:1] != "_" and not _is_settable(self, name, value, sys._getframe(1).f_globals.get("__name__")):
                raise unknown_attribute(self, name, is_set=True)
            object.__setattr__(self, name, value)


class Elsewhere:
    """A name that a class has not, with the hint what to use: it behaves as a missing attribute, and `dir` omits it.

    For classes of packets, which have no `__getattr__`: it would slow down each access to a field.

    Args:
        name: The name.
        own: What it is called here.
    """

    def __init__(self, name: str, own: str) -> None:
        self._name = name
        self.own = own

    def __get__(self, held: object, kind: type) -> NoReturn:
        message = f"{kind.__name__} has no {self._name!r}; here it is: {self.own}"
        raise AttributeError(message, name=self._name, obj=None)


def unknown_attribute(held: StrictAttributes, name: str, *, is_set: bool = False) -> AttributeError:
    """The error for a name that an object does not have, or that cannot be set."""
    kind = type(held)
    what, hint = f"attribute {name!r}", "" if name.startswith("_") else None
    if is_set and hasattr(kind, name):
        what += " that can be set"
        instead = f"; {name}() is a method" if _is_method(kind, name) else ""
        hint = f"; use set_{name}()" if hasattr(kind, f"set_{name}") else instead
    if hint is None:
        hint = held._hint(name)
    if hint is None:
        own = foreign_hint(kind.__module__.partition(".")[0], name)
        if own is not None:
            what, hint = repr(name), f"; here it is: {own}"
    if hint is None:
        from .text import similar  # imported here: importing the library stays cheap

        hint = similar(name, (each for each in dir(held) if each[0] != "_" and each != name))
    # Of no object, or Python adds a suggestion of its own to a traceback.
    return AttributeError(f"{kind.__name__} has no {what}{hint}", name=name, obj=None)


def _is_method(kind: type, name: str) -> bool:
    return callable(getattr(kind, name))


@functools.cache
def _packages(kind: Hashable) -> frozenset[str]:
    """The packages that the classes of an object come from."""
    return frozenset(each.__module__.partition(".")[0] for each in cast("type", kind).__mro__)


def _is_settable(held: object, name: str, value: object, module: str | None) -> bool:
    """Whether code of a module may set an attribute."""
    kind = type(held)
    if module is not None and module.partition(".")[0] in _packages(cast("Hashable", kind)):
        return True
    found = next((vars(each)[name] for each in kind.__mro__ if name in vars(each)), None)
    if isinstance(found, property):
        return found.fset is not None
    if found is not None:
        return callable(value) or not _is_method(kind, name)
    return bool(kind.__dictoffset__) and name in vars(held)


# -- arguments -------------------------------------------------------------------------------------


def _arguments(method: Callable[..., Any]) -> list[str]:
    """The names of the arguments of a method, without `self`."""
    while hasattr(method, "__wrapped__"):
        method = method.__wrapped__
    code = method.__code__
    return list(code.co_varnames[1 : code.co_argcount + code.co_kwonlyargcount])


def _moves(method: FunctionType) -> bool:
    # A coroutine raises later, when it calls the method that does it.
    is_coroutine = method.__code__.co_flags & 0x80
    return not is_coroutine and not _OF_MOVES.isdisjoint(_arguments(method))


def _explaining_arguments(method: Callable[..., Any]) -> Callable[..., Any]:
    """The same method, whose error for an unknown argument has a hint."""

    @functools.wraps(method)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return method(*args, **kwargs)
        except TypeError:
            known = _arguments(method)
            unknown = next((name for name in kwargs if name not in known), None)
            if unknown is None:
                raise
            hint = _argument_hint(unknown, known)
        raise TypeError(f"{method.__qualname__.removesuffix('.__init__')}() has no argument {unknown!r}{hint}")

    return call


def _argument_hint(unknown: str, known: list[str]) -> str:
    from .text import similar

    own = _OWN_KEYWORDS.get(unknown)
    if own in known:
        how = " (wait=True returns when it has ended, wait=False at once)" if own == "wait" else ""
        return f"; use {own!r}{how}"
    return similar(unknown, known) or f"; it has {', '.join(known)}"
