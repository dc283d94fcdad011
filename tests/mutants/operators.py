"""Mutations: small changes to a module that its tests should detect, and the module with one of them.

The operators are the usual ones: a comparison moved by one, a negated condition, `and` instead of `or`, another
arithmetic operator, another number, an omitted statement, `None` returned. Texts, log calls, annotations, decorators,
assertions and `__repr__` are not changed, because such a change affects only wording.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable
from typing import Any, NamedTuple

#: Comparisons that differ only for equal values.
BOUNDARIES: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
}

OPPOSITES: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}

ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitOr,
    ast.MatMult: ast.Mult,
}

#: Functions with a result that is only for people.
WORDS = {"__repr__", "_repr_html_", "__rich__"}

#: Names of loggers and of the module for warnings, which are the first part of a call.
LOGGERS = {"log", "_log", "logger", "_logger", "LOG", "logging", "warnings"}


class Function(NamedTuple):
    """Function in the body of a module or class, identified by its code object."""

    name: str
    line: int


class Mutation(NamedTuple):
    number: int
    line: int
    end: int
    #: Function that contains the change; None outside of all functions, and for a default value.
    function: Function | None
    before: str
    after: str
    #: Operator of `defects`; empty for the operators of this module.
    kind: str = ""


class _Mutator(ast.NodeTransformer):
    """Transformer that numbers the mutations as it finds them, and makes the chosen one."""

    def __init__(self, chosen: int | None) -> None:
        self._chosen = chosen
        self._function: Function | None = None
        self._statement: ast.stmt | None = None
        self._is_condition = False
        self.found: list[Mutation] = []

    # -- offering ----------------------------------------------------------------------------

    def _offer(self, node: ast.AST, others: Iterable[ast.AST]) -> ast.AST:
        for other in others:
            number = len(self.found)
            statement = self._statement or node
            line = getattr(statement, "lineno", 0)
            # For a compound statement, use only the head, which contains the change.
            end = max(getattr(node, "end_lineno", None) or line, line)
            ast.copy_location(other, node)
            ast.fix_missing_locations(other)
            self.found.append(Mutation(number, line, end, self._function, _text(node), _text(other)))
            if number == self._chosen:
                return other
        return node

    def visit(self, node: ast.AST) -> Any:
        if not isinstance(node, ast.stmt):
            return super().visit(node)
        before, self._statement = self._statement, node
        try:
            return super().visit(node)
        finally:
            self._statement = before

    # -- unchanged nodes ---------------------------------------------------------------------

    def _leave(self, node: ast.AST) -> ast.AST:
        return node

    visit_JoinedStr = visit_Assert = visit_Import = visit_ImportFrom = _leave

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        if node.value is not None:
            node.value = self.visit(node.value)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        return self._in_function(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.AST:
        return self._in_function(node)

    def _in_function(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        if node.name in WORDS:
            return node
        # Defaults are evaluated where the function is defined.
        node.args.defaults = [self.visit(each) for each in node.args.defaults]
        node.args.kw_defaults = [each and self.visit(each) for each in node.args.kw_defaults]
        outer = self._function
        if outer is None:
            first = node.decorator_list[0].lineno if node.decorator_list else node.lineno
            self._function = Function(node.name, first)
        node.body = [self.visit(each) for each in node.body]
        self._function = outer
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.body = [self.visit(each) for each in node.body]
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        node.func = self.visit(node.func)
        node.args = [self.visit(each) for each in node.args]
        # ``strict`` of zip asserts that lengths are equal, and asserts are not changed.
        if not (isinstance(node.func, ast.Name) and node.func.id == "zip"):
            node.keywords = [self.visit(each) for each in node.keywords]
        return node

    # -- conditions --------------------------------------------------------------------------

    def _condition(self, test: ast.expr) -> ast.expr:
        # The opposite of a comparison or of `not x` equals its negation, so it is offered only once.
        self._is_condition = isinstance(test, (ast.Compare, ast.UnaryOp))
        return self._offer(self.visit(test), [_negated(test)])  # type: ignore[return-value]

    def visit_If(self, node: ast.If) -> ast.AST:
        return self._with_blocks(node)

    def visit_While(self, node: ast.While) -> ast.AST:
        return self._with_blocks(node)

    def _with_blocks(self, node: ast.If | ast.While) -> ast.AST:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return node
        if not isinstance(node.test, ast.Constant):
            node.test = self._condition(node.test)
        node.body = [self.visit(each) for each in node.body]
        node.orelse = [self.visit(each) for each in node.orelse]
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        node.test = self._condition(node.test)
        node.body = self.visit(node.body)
        node.orelse = self.visit(node.orelse)
        return node

    def visit_comprehension(self, node: ast.comprehension) -> ast.AST:
        node.iter = self.visit(node.iter)
        node.ifs = [self._condition(each) for each in node.ifs]
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        is_condition, self._is_condition = self._is_condition, False
        self.generic_visit(node)
        others: list[ast.AST] = []
        for at, operator in enumerate(node.ops):
            other = BOUNDARIES.get(type(operator))
            if other is None and not is_condition:
                other = OPPOSITES.get(type(operator))
            if other is not None:
                ops = [*node.ops[:at], other(), *node.ops[at + 1 :]]
                others.append(ast.Compare(node.left, ops, node.comparators))
        return self._offer(node, others)

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        return self._offer(node, [ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values)])

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        is_condition, self._is_condition = self._is_condition, False
        self.generic_visit(node)
        if isinstance(node.op, ast.USub) or (isinstance(node.op, ast.Not) and not is_condition):
            return self._offer(node, [node.operand])
        return node

    # -- numbers -----------------------------------------------------------------------------

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if _is_text(node.left) or _is_text(node.right):
            return node
        return self._offer(node, [ast.BinOp(node.left, ARITHMETIC[type(node.op)](), node.right)])

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        node.value = self.visit(node.value)
        if _is_text(node.value):
            return node
        return self._offer(node, [ast.AugAssign(node.target, ARITHMETIC[type(node.op)](), node.value)])

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        value = node.value
        if isinstance(value, bool):
            return self._offer(node, [ast.Constant(not value)])
        if isinstance(value, int):
            return self._offer(node, [ast.Constant(value + 1)])
        if isinstance(value, float):
            return self._offer(node, [ast.Constant(2 * value or 1.0)])
        return node

    # -- statements --------------------------------------------------------------------------

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        if isinstance(node.value, ast.Constant) or _is_logging(node.value):
            return node
        self.generic_visit(node)
        return self._offer(node, [ast.Pass()] if isinstance(node.value, ast.Call) else [])

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        node.value = self.visit(node.value)
        is_state = all(isinstance(target, (ast.Attribute, ast.Subscript)) for target in node.targets)
        return self._offer(node, [ast.Pass()] if is_state and self._function else [])

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        self.generic_visit(node)
        return self._offer(node, [ast.Pass()])

    def visit_Delete(self, node: ast.Delete) -> ast.AST:
        return self._offer(node, [ast.Pass()])

    def visit_Return(self, node: ast.Return) -> ast.AST:
        self.generic_visit(node)
        if node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None):
            return node
        return self._offer(node, [ast.Return(ast.Constant(None))])

    def visit_Break(self, node: ast.Break) -> ast.AST:
        return self._offer(node, [ast.Pass()])

    def visit_Continue(self, node: ast.Continue) -> ast.AST:
        return self._offer(node, [ast.Pass()])


def _negated(test: ast.expr) -> ast.expr:
    if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
        return test.operand
    return ast.UnaryOp(ast.Not(), test)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, (str, bytes)))


def _is_logging(node: ast.expr) -> bool:
    while isinstance(node, (ast.Call, ast.Attribute)):
        node = node.func if isinstance(node, ast.Call) else node.value
    return isinstance(node, ast.Name) and node.id in LOGGERS


def _text(node: ast.AST) -> str:
    """Return the first line of the source of a node."""
    return ast.unparse(node).partition("\n")[0][:100]


def mutations(source: str) -> list[Mutation]:
    """Return all mutations of a module, in the order of its text."""
    mutator = _Mutator(None)
    mutator.visit(ast.parse(source))
    return mutator.found


def mutated(source: str, number: int) -> ast.Module:
    """Return the module with the mutation of this number."""
    tree = ast.parse(source)
    _Mutator(number).visit(tree)
    return tree
