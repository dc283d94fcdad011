"""From words to syntax, by recursive descent.

    program    = { statement }
    statement  = [ definition | if | while | simple ] end-of-line
    definition = ( "def" | "sec" | "thread" ) name "(" [ parameter { "," parameter } ] ")" ":" block "end"
    parameter  = name [ "=" expression ]
    block      = statement { statement }               at least one that is not empty
    if         = "if" expression ":" block { "elif" expression ":" block } [ "else" ":" block ] "end"
    while      = "while" expression ":" block "end"
    simple     = [ "global" | "local" ] name [ "=" expression ] | name { "[" expressions "]" } "=" expression
               | "return" [ expression ] | "break" | "continue" | "pass" | "halt" [ "(" ")" ]
               | "kill" expression | "join" expression | expression
    expression = xor { "or" xor }
    xor        = and { "xor" and }
    and        = not { "and" not }
    not        = "not" not | comparison
    comparison = sum { ( "==" | "!=" | "<" | "<=" | ">" | ">=" ) sum }
    sum        = product { ( "+" | "-" ) product }
    product    = unary { ( "*" | "/" | "%" ) unary }
    unary      = ( "-" | "+" ) unary | postfix
    postfix    = primary { "[" expressions "]" }
    primary    = number | string | "True" | "False" | "(" expression ")" | "[" [ expressions ] "]"
               | "p" "[" six expressions "]" | [ "run" ] name "(" [ argument { "," argument } ] ")" | name
    argument   = [ name "=" ] expression

Three things are read off drivers' programs: `m[i, j]` is the element of a matrix, a list of lists; `p[i]` that of a
variable called p; and after an operator between two operands the line may end.

Guesses: the precedence of `xor`; that an empty block is an error (`pass` is there to fill it); that the line after a
colon need not end; that a word after a whole statement on one line is an error unless it is `end`, `else` or `elif`.
`true` and `false` stand in users' programs and are taken as `True` and `False`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

from .errors import ScriptError
from .limits import MAX_INTEGER, MAX_NESTING
from .syntax import (
    Assign,
    Binary,
    Block,
    Break,
    Call,
    Constant,
    Continue,
    Declare,
    Definition,
    Evaluate,
    Expression,
    Halt,
    If,
    Index,
    Join,
    Kill,
    ListDisplay,
    Name,
    Parameter,
    PoseDisplay,
    Return,
    Scope,
    Statement,
    Unary,
    While,
)
from .tokens import Source, Token

__all__ = ["parse"]

# Tightest last.
_LEVELS: list[frozenset[str]] = [
    frozenset({"or"}),
    frozenset({"xor"}),
    frozenset({"and"}),
    frozenset({"==", "!=", "<", "<=", ">", ">="}),
    frozenset({"+", "-"}),
    frozenset({"*", "/", "%"}),
]
_BINDING = {operator: level for level, operators in enumerate(_LEVELS, 1) for operator in operators}
_COMPARISON = 4


def parse(text: str) -> Block:
    """The statements of a program's text.

    Raises:
        ScriptError: it is no program, with the place and the controller's text.
    """
    return _Parser(Source(text)).program()


class _Parser:
    def __init__(self, source: Source) -> None:
        self._source = source
        self._tokens = source.tokens
        self._at = 0
        self._nesting = 0
        self._readers: dict[str, Callable[[], Statement]] = {
            "def": lambda: self._definition("def"),
            "sec": lambda: self._definition("sec"),
            "thread": lambda: self._definition("thread"),
            "if": self._if,
            "while": self._while,
            "return": self._return,
            "break": lambda: Break(*self._place()),
            "continue": lambda: Continue(*self._place()),
            "halt": self._halt,
            "kill": lambda: Kill(*self._place(), self._expression()),
            "join": lambda: Join(*self._place(), self._expression()),
            "global": lambda: self._declaration("global"),
            "local": lambda: self._declaration("local"),
        }

    # -- words -------------------------------------------------------------------------------------

    @property
    def _next(self) -> Token:
        return self._tokens[self._at]

    def _take(self) -> Token:
        token = self._tokens[self._at]
        if token.kind != "end of text":
            self._at += 1
        return token

    def _place(self) -> tuple[int, int]:
        """Of the word at hand, which is taken."""
        token = self._take()
        return token.line, token.column

    def _expect(self, kind: str) -> Token:
        if self._next.kind != kind:
            raise self._unexpected()
        return self._take()

    def _accept(self, kind: str) -> bool:
        if self._next.kind == kind:
            self._take()
            return True
        return False

    def _unexpected(self) -> ScriptError:
        return self._source.error(self._next.line, self._next.column)

    def _deeper(self, token: Token) -> None:
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise ScriptError(token.line, token.column, f"nesting_too_deep_on_line:{token.line}:")

    def _joined(self, token: Token, *parts: Expression) -> int:
        depth = 1 + max((part.depth for part in parts), default=0)
        if depth > MAX_NESTING:
            raise ScriptError(token.line, token.column, f"nesting_too_deep_on_line:{token.line}:")
        return depth

    # -- statements --------------------------------------------------------------------------------

    def program(self) -> Block:
        block: Block = []
        while self._next.kind != "end of text":
            self._statement(block)
        return block

    def _block(self, *ends: str) -> Block:
        """Statements up to one of those words, which is left."""
        block: Block = []
        self._deeper(self._next)
        has_any = False
        while self._next.kind not in ends:
            has_any |= self._statement(block)
        self._nesting -= 1
        if not has_any:
            raise self._unexpected()
        return block

    def _statement(self, block: Block) -> bool:
        """Read a line; False where it was empty."""
        token = self._next
        if token.kind == "newline":
            self._take()
            return False
        if token.kind == "pass":
            self._take()
        else:
            block.append(self._readers.get(token.kind, self._simple)())
        if self._next.kind not in ("end", "else", "elif"):
            self._expect("newline")
        return True

    def _definition(self, kind: Literal["def", "sec", "thread"]) -> Definition:
        self._take()
        name = self._expect("name")
        self._expect("(")
        parameters: list[Parameter] = []
        while self._next.kind != ")":
            if parameters:
                self._expect(",")
            parameter = self._expect("name")
            default = self._expression() if self._accept("=") else None
            if any(other.name == parameter.text for other in parameters):
                raise self._source.error(parameter.line, parameter.column)
            parameters.append(Parameter(parameter.line, parameter.column, parameter.text, default))
        self._expect(")")
        self._expect(":")
        body = self._block("end")
        self._expect("end")
        return Definition(name.line, name.column, kind, name.text, parameters, body)

    def _if(self) -> If:
        word = self._take()
        branches: list[tuple[Expression, Block]] = []
        otherwise: Block = []
        while True:
            condition = self._expression()
            self._expect(":")
            branches.append((condition, self._block("elif", "else", "end")))
            if not self._accept("elif"):
                break
        if self._accept("else"):
            self._expect(":")
            otherwise = self._block("end")
        self._expect("end")
        return If(word.line, word.column, branches, otherwise)

    def _while(self) -> While:
        word = self._take()
        condition = self._expression()
        self._expect(":")
        body = self._block("end")
        self._expect("end")
        return While(word.line, word.column, condition, body)

    def _return(self) -> Return:
        word = self._take()
        has_value = self._next.kind not in ("newline", "end", "else", "elif")
        return Return(word.line, word.column, self._expression() if has_value else None)

    def _halt(self) -> Halt:
        place = self._place()
        if self._accept("("):
            self._expect(")")
        return Halt(*place)

    def _declaration(self, scope: Scope) -> Statement:
        self._take()
        name = self._expect("name")
        if self._accept("="):
            return Assign(name.line, name.column, name.text, scope, [], self._expression())
        return Declare(name.line, name.column, name.text, scope)

    def _simple(self) -> Statement:
        begin = self._next
        value = self._expression()
        if self._next.kind != "=":
            return Evaluate(begin.line, begin.column, value)
        indices: list[Expression] = []
        target = value
        while isinstance(target, Index):
            indices.insert(0, target.index)
            target = target.base
        if not isinstance(target, Name):
            raise self._unexpected()
        self._take()
        return Assign(begin.line, begin.column, target.name, "free", indices, self._expression())

    # -- expressions -------------------------------------------------------------------------------

    def _expression(self, level: int = 1) -> Expression:
        """An operation whose operators bind at `level` or tighter."""
        token = self._next
        self._deeper(token)
        if token.kind == "not" and level <= _COMPARISON:
            self._take()
            operand = self._expression(_COMPARISON)
            left: Expression = Unary(token.line, token.column, self._joined(token, operand), "not", operand)
        else:
            left = self._unary()
        while (binding := _BINDING.get(self._next.kind, 0)) >= level:
            token = self._take()
            while self._accept("newline"):
                pass
            right = self._expression(binding + 1)
            left = Binary(token.line, token.column, self._joined(token, left, right), token.kind, left, right)
        self._nesting -= 1
        return left

    def _unary(self) -> Expression:
        token = self._next
        if token.kind not in ("-", "+"):
            return self._postfix()
        self._take()
        self._deeper(token)
        operand = self._unary()
        self._nesting -= 1
        if (
            isinstance(operand, Constant)
            and isinstance(operand.value, (int, float))
            and not isinstance(operand.value, bool)
        ):
            return Constant(token.line, token.column, 1, -operand.value if token.kind == "-" else operand.value)
        return Unary(token.line, token.column, self._joined(token, operand), token.kind, operand)

    def _postfix(self) -> Expression:
        value = self._primary()
        while self._next.kind == "[":
            token = self._take()
            indices = self._items("]")
            if not indices:
                raise self._source.error(token.line, token.column)
            for index in indices:
                value = Index(token.line, token.column, self._joined(token, value, index), value, index)
        return value

    def _primary(self) -> Expression:
        token = self._next
        line, column = token.line, token.column
        if token.kind == "name":
            self._take()
            if self._next.kind == "(":
                return self._call(token, is_run=False)
            if token.text == "p" and self._next.kind == "[":
                return self._pose(token)
            return Name(line, column, 1, token.text)
        if token.kind == "number":
            self._take()
            return Constant(line, column, 1, self._number(token))
        if token.kind == "string":
            self._take()
            return Constant(line, column, 1, token.text[1:-1])
        if token.kind in ("True", "False", "true", "false"):
            self._take()
            return Constant(line, column, 1, token.kind in ("True", "true"))
        if token.kind == "(":
            self._take()
            value = self._expression()
            self._expect(")")
            return value
        if token.kind == "[":
            self._take()
            items = self._items("]")
            return ListDisplay(line, column, self._joined(token, *items), items)
        if token.kind == "run":
            self._take()
            return self._call(self._expect("name"), is_run=True)
        raise self._unexpected()

    def _pose(self, token: Token) -> Expression:
        """Six numbers are a pose; with one it is the element of a variable that is called p."""
        place = (token.line, token.column)
        self._take()
        items = self._items("]")
        depth = self._joined(token, *items)
        if len(items) == 1:
            return Index(*place, depth, Name(*place, 1, token.text), items[0])
        if len(items) != 6:
            raise self._source.error(*place)
        return PoseDisplay(*place, depth, items)

    def _number(self, token: Token) -> float | int:
        """An integer, if it is one of 32 bits; that a longer one is a float is a guess."""
        text = token.text
        if text.lower().startswith("0x"):
            value: float | int = int(text, 16) if len(text) < 20 else math.inf
        elif text.isdigit() and len(text) < 20:
            value = int(text)
        else:
            value = float(text)
        if value > MAX_INTEGER:
            value = float(value)
        if math.isinf(value):
            raise self._source.error(token.line, token.column)
        return value

    def _items(self, end: str) -> list[Expression]:
        items: list[Expression] = []
        while self._next.kind != end:
            if items:
                self._expect(",")
            items.append(self._expression())
        self._take()
        return items

    def _call(self, name: Token, is_run: bool) -> Call:
        self._expect("(")
        arguments: list[Expression] = []
        named: list[tuple[str, Expression]] = []
        while self._next.kind != ")":
            if arguments or named:
                self._expect(",")
            follower = self._tokens[min(self._at + 1, len(self._tokens) - 1)]
            if self._next.kind == "name" and follower.kind == "=":
                key = self._take().text
                self._take()
                named.append((key, self._expression()))
            elif named:
                raise self._unexpected()
            else:
                arguments.append(self._expression())
        self._take()
        depth = self._joined(name, *arguments, *(value for _, value in named))
        return Call(name.line, name.column, depth, name.text, arguments, named, is_run)
