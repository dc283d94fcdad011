"""Defects as people make them: a different order, a forgotten call, a missing expiry or a missing lock.

`operators` changes one expression or drops one statement. The operators in this module change details that concurrent
programs depend on:

    swap      two statements in a row are swapped
    late      a flag is set after the actions that follow it instead of before them
    expiry    a timeout or a deadline is removed
    lock      a lock is held for one statement too many or too few
    forget    a notification, cancel, release, close or removal is forgotten
    branch    the branch for one frame, link or other named case is executed for another one
"""

from __future__ import annotations

import ast
import random
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from tests.mutants.operators import WORDS, Function, Mutation, _is_logging, _text

__all__ = ["KINDS", "Drawn", "defects", "draw", "with_defect"]

KINDS = ("swap", "late", "expiry", "lock", "forget", "branch")

#: Calls that end, wake or undo something.
_ENDING = re.compile(
    r"_?(notify|notify_all|set|cancel\w*|release\w*|close\w*|clear|unsubscribe|remove\w*|discard\w*|stop\w*|wake\w*|"
    r"join|shutdown\w*|end\w*|fail\w*|finish\w*|forget\w*|undo\w*|disconnect\w*|abort\w*|withdraw\w*|give_up\w*|expire\w*|"
    r"unregister\w*|undo\w*|fire|tell\w*|call_soon_threadsafe|set_result|set_exception|drop\w*|leave\w*|free\w*)"
)
_TIME = re.compile(r"timeout|deadline|until|expir|watchdog|lifespan|patience|_age\b|\bage\b|overdue|\bleft\b|_since\b")
_LOCK = re.compile(r"lock|mutex|condition|changed|turn|guard|critical", re.IGNORECASE)
#: Names of flags that distinguish frames or links.
_KIND = re.compile(r"is_(linked|reverse|rtde|tool|base)")
_SIMPLE = (ast.Expr, ast.Assign, ast.AugAssign, ast.AnnAssign, ast.Delete)
#: Names of frames and links, each with the name that replaces it.
_NAMES = {
    "base": "tool",
    "tool": "base",
    "joints": "base",
    "rtde": "reverse",
    "reverse": "rtde",
    "primary": "secondary",
    "secondary": "primary",
    "realtime": "primary",
}

#: Description of a defect, and a function that applies it to the tree that was searched.
_Found = tuple[Mutation, Callable[[], None]]


def defects(source: str) -> list[Mutation]:
    """Return all defects of a module, in the order of its text."""
    return [mutation for mutation, _ in _found(ast.parse(source))]


def with_defect(source: str, number: int) -> ast.Module:
    """Return the module with the defect of this number."""
    tree = ast.parse(source)
    _found(tree)[number][1]()
    return ast.fix_missing_locations(tree)


class Drawn(NamedTuple):
    """Defect of a module."""

    path: Path
    mutation: Mutation


def draw(files: Iterable[Path], seed: int, count: int) -> list[Drawn]:
    """Draw `count` defects: one of each kind in turn, each from a random module."""
    chance = random.Random(seed)
    of_kind: dict[str, list[Drawn]] = {kind: [] for kind in KINDS}
    for path in files:
        for mutation in defects(path.read_text(encoding="utf-8")):
            of_kind[mutation.kind].append(Drawn(path, mutation))
    for each in of_kind.values():
        chance.shuffle(each)
    drawn: list[Drawn] = []
    while len(drawn) < count and any(of_kind.values()):
        drawn += [each.pop() for each in of_kind.values() if each]
    return drawn[:count]


def _found(tree: ast.Module) -> list[_Found]:
    found: list[_Found] = []
    for function in _functions(tree.body):
        first = function.decorator_list[0].lineno if function.decorator_list else function.lineno
        name = Function(function.name, first)
        for kind, node, before, after, apply in _of_function(function):
            line, end = node.lineno, node.end_lineno or node.lineno
            if isinstance(node, (ast.With, ast.If)):
                end = node.body[0].lineno
            found.append((Mutation(len(found), line, end, name, before, after, kind), apply))
    return found


def _functions(body: list[ast.stmt]) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Yield the functions of a module and of its classes, without nested functions."""
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield from _functions(node.body)
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and node.name not in WORDS:
            yield node


_Change = tuple[str, ast.stmt, str, str, Callable[[], None]]


def _of_function(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[_Change]:
    for block in _blocks(function):
        for at, node in enumerate(block):
            if function.name != "__init__":
                yield from _swap(block, at)
                yield from _late(block, at)
            yield from _forget(block, at)
            yield from _lock(block, at)
            yield from _expiry(node)
            yield from _branch(node)


def _blocks(node: ast.AST) -> Iterator[list[ast.stmt]]:
    for child in ast.walk(node):
        for name in ("body", "orelse", "finalbody"):
            block = getattr(child, name, None)
            if isinstance(block, list) and block and isinstance(block[0], ast.stmt):
                yield block


def _replace(block: list[ast.stmt], first: int, last: int, *others: ast.stmt) -> Callable[[], None]:
    def apply() -> None:
        block[first:last] = others

    return apply


# -- order -----------------------------------------------------------------------------------


def _swap(block: list[ast.stmt], at: int) -> Iterator[_Change]:
    if at + 1 == len(block):
        return
    one, other = block[at], block[at + 1]
    if not (_is_action(one) and _is_action(other)) or not (_calls(one) or _calls(other)):
        return
    if _bound(one) & _used(other) or _bound(other) & _used(one) or _bound(one) & _bound(other):
        return
    if _changes(one) or _changes(other):
        yield "swap", one, f"{_text(one)}; {_text(other)}", "swapped", _replace(block, at, at + 2, other, one)


def _late(block: list[ast.stmt], at: int) -> Iterator[_Change]:
    node, rest = block[at], block[at + 1 :]
    is_flag = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Attribute) and not _calls(node)
    if not is_flag or not rest:
        return
    stays = rest[-1:] if isinstance(rest[-1], (ast.Return, ast.Raise, ast.Continue, ast.Break)) else []
    passed = rest[: len(rest) - len(stays)]
    if any(_calls(each) for each in passed):
        yield (
            "late",
            node,
            _text(node),
            f"after {_text(passed[-1])}",
            _replace(block, at, len(block), *passed, node, *stays),
        )


# -- forgotten calls -------------------------------------------------------------------------


def _forget(block: list[ast.stmt], at: int) -> Iterator[_Change]:
    node = block[at]
    call = node.value if isinstance(node, ast.Expr) else None
    if isinstance(call, ast.Await):
        call = call.value
    if isinstance(call, ast.Call) and not _is_logging(call) and _ENDING.fullmatch(_name(call.func)):
        yield "forget", node, _text(node), "pass", _replace(block, at, at + 1, ast.Pass())


def _lock(block: list[ast.stmt], at: int) -> Iterator[_Change]:
    node = block[at]
    if not isinstance(node, ast.With) or len(node.items) != 1 or not _LOCK.search(ast.unparse(node.items[0])):
        return
    body, lock = node.body, ast.unparse(node.items[0])
    if not isinstance(body[-1], (ast.Return, ast.Raise, ast.Pass)):
        rest = body[:-1] or [ast.Pass()]

        def shorter(rest: list[ast.stmt] = rest) -> None:
            block[at : at + 1] = [ast.With(node.items, rest), body[-1]]

        yield "lock", node, f"with {lock}", f"without its last: {_text(body[-1])}", shorter
    if len(body) > 1:

        def later() -> None:
            block[at : at + 1] = [body[0], ast.With(node.items, body[1:])]

        yield "lock", node, f"with {lock}", f"without its first: {_text(body[0])}", later
    if at + 1 < len(block) and _calls(block[at + 1]):

        def longer() -> None:
            block[at : at + 2] = [ast.With(node.items, [*body, block[at + 1]])]

        yield "lock", node, f"with {lock}", f"and also {_text(block[at + 1])}", longer


# -- expressions -----------------------------------------------------------------------------


def _expiry(node: ast.stmt) -> Iterator[_Change]:
    for each in _expressions(node):
        is_order = isinstance(each, ast.Compare) and isinstance(each.ops[0], (ast.Lt, ast.LtE, ast.Gt, ast.GtE))
        if is_order and _TIME.search(ast.unparse(each)):
            yield "expiry", node, _text(each), "False", _in_place(each, ast.Constant(False))
        if isinstance(each, ast.Call):
            yield from _without_timeout(node, each)


def _without_timeout(node: ast.stmt, call: ast.Call) -> Iterator[_Change]:
    for keyword in call.keywords:
        name = keyword.arg or ""
        if _TIME.search(name) and not name.startswith("on_") and not isinstance(keyword.value, ast.Constant):

            def longer(keyword: ast.keyword = keyword) -> None:
                keyword.value = ast.Constant(1e6)

            yield "expiry", node, f"{_text(call.func)}({name}={_text(keyword.value)})", "1e6", longer
    if _name(call.func) in ("wait", "wait_for", "acquire", "join", "get", "call_later", "timed_wait"):
        for at, argument in enumerate(call.args):
            if _TIME.search(ast.unparse(argument)):

                def for_ever(at: int = at) -> None:
                    call.args[at] = ast.Constant(1e6)

                yield "expiry", node, _text(call), f"argument {at} is 1e6", for_ever


def _branch(node: ast.stmt) -> Iterator[_Change]:
    tests = [node.test] if isinstance(node, ast.If) else []
    tests += [each.test for each in _expressions(node) if isinstance(each, ast.IfExp)]
    for each in (each for test in tests for each in ast.walk(test)):
        is_case = isinstance(each, ast.Compare) and _is_named(each)
        is_kind = isinstance(each, (ast.Name, ast.Attribute)) and _KIND.match(_name(each))
        if isinstance(each, ast.expr) and (is_case or is_kind):
            yield "branch", node, _text(each), "False", _in_place(each, ast.Constant(False))
    for one in _expressions(node):
        if isinstance(one, ast.Dict):
            yield from _crossed(node, one)
        if isinstance(one, ast.Call):
            for held in (*one.args, *(keyword.value for keyword in one.keywords)):
                if isinstance(held, ast.Constant) and held.value in _NAMES:
                    other = ast.Constant(_NAMES[str(held.value)])
                    yield "branch", node, _text(one), f"{held.value!r} is {other.value!r}", _in_place(held, other)
    if isinstance(node, ast.Match) and len(node.cases) > 1:

        def other_case() -> None:
            first, second = node.cases[0], node.cases[1]
            first.body, second.body = second.body, first.body

        yield "branch", node, f"match {_text(node.subject)}", "the first two cases are swapped", other_case


def _crossed(node: ast.stmt, table: ast.Dict) -> Iterator[_Change]:
    is_named = len(table.keys) > 1 and all(isinstance(key, ast.Constant) for key in table.keys)
    if is_named and ast.unparse(table.values[0]) != ast.unparse(table.values[1]):

        def crossed() -> None:
            table.values[0], table.values[1] = table.values[1], table.values[0]

        yield "branch", node, _text(table), "the first two values are swapped", crossed


def _in_place(node: ast.expr, other: ast.expr) -> Callable[[], None]:
    """Return a function that turns a node into another one in place."""

    def apply() -> None:
        fields = dict(vars(other))
        places = {name: value for name, value in vars(node).items() if name.endswith(("lineno", "col_offset"))}
        node.__class__ = type(other)
        vars(node).clear()
        vars(node).update(fields | places)

    return apply


# -- parts -----------------------------------------------------------------------------------


def _expressions(node: ast.stmt) -> Iterator[ast.expr]:
    """Yield the expressions of one statement, without nested statements, log calls and f-strings."""
    waiting: list[ast.AST] = list(ast.iter_child_nodes(node))
    while waiting:
        each = waiting.pop(0)
        if isinstance(each, (ast.stmt, ast.ExceptHandler, ast.match_case, ast.JoinedStr)):
            continue
        if isinstance(each, ast.Call) and _is_logging(each):
            continue
        if isinstance(each, ast.expr):
            yield each
        waiting += ast.iter_child_nodes(each)


def _is_action(node: ast.stmt) -> bool:
    if not isinstance(node, _SIMPLE):
        return False
    is_text = isinstance(node, ast.Expr) and (isinstance(node.value, ast.Constant) or _is_logging(node.value))
    return not is_text


def _calls(node: ast.stmt) -> bool:
    return any(isinstance(each, (ast.Call, ast.Await)) and not _is_logging(each) for each in ast.walk(node))


def _changes(node: ast.stmt) -> bool:
    """Whether a statement calls something, or changes an attribute or an element."""
    targets = (ast.Attribute, ast.Subscript)
    return isinstance(node, ast.Expr) or any(
        isinstance(each, targets) and isinstance(each.ctx, (ast.Store, ast.Del)) for each in ast.walk(node)
    )


def _bound(node: ast.stmt) -> set[str]:
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)}


def _used(node: ast.stmt) -> set[str]:
    return {each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load)}


def _is_named(node: ast.Compare) -> bool:
    """Whether a comparison is with one or several texts or members of an enumeration."""
    if not isinstance(node.ops[0], (ast.Eq, ast.NotEq, ast.In, ast.Is)):
        return False
    other = node.comparators[0]
    elements = other.elts if isinstance(other, (ast.Tuple, ast.List, ast.Set)) else [other]
    is_member = all(isinstance(each, ast.Attribute) and each.attr.isupper() for each in elements)
    is_text = all(isinstance(each, ast.Constant) and isinstance(each.value, str) for each in elements)
    return bool(elements) and (is_text or is_member)


def _name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
