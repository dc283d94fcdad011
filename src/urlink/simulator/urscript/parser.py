"""Recursive-descent parser, which converts the tokens of a program to a syntax tree.

    program    = { statement }
    statement  = definition | if | while | simple | "pass" | "$" number string [ string ]
    definition = ( "def" | "sec" | "thread" ) name "(" [ parameter { "," parameter } ] ")" ":" block "end"
    parameter  = name [ "=" expression ]
    block      = { statement }
    if         = "if" expression ":" block { "elif" expression ":" block } [ "else" ":" block ] "end"
    while      = "while" expression ":" block "end"
    simple     = [ "global" | "local" ] name [ "=" expression ]
               | name { "[" expressions "]" | "." name } "=" expression
               | "return" [ expression ] | "break" | "continue" | "halt" [ "(" ")" ]
               | "kill" expression | "join" expression | expression
    expression = xor { "or" xor }
    xor        = and { "xor" and }
    and        = not { "and" not }
    not        = "not" not | comparison
    comparison = sum { ( "==" | "!=" | "<" | "<=" | ">" | ">=" ) sum }
    sum        = product { ( "+" | "-" ) product }
    product    = unary { ( "*" | "/" | "%" ) unary }
    unary      = ( "-" | "+" ) unary | postfix
    postfix    = primary { "[" expressions "]" | "." name [ "(" [ expressions ] ")" ] }
    primary    = number | string | "True" | "False" | "(" expression ")" | "[" [ expressions ] "]"
               | "p" "[" six expressions "]" | [ "run" ] name "(" [ argument { "," argument } ] ")" | name
    argument   = [ name "=" ] expression

The following facts are known from public programs that run on real controllers (docs/protocols/urscript.md, What public
programs need):

- Line ends are white space. So two statements can be on one line, and an expression can continue on the next line.
- Blocks can be empty.
- PolyScope writes `$ 1 "Robot Program"` or `$ 3 "home" "breakAfter"` before each node of a program. The only effect of
  this text is that `jump_to_label` can jump to it.
- `m[i, j]` is an element of a matrix, which is a list of lists. `p[i]` is an element of a variable with the name p.
  `s.a` is a member of a struct such as `struct(a=1)`. `handle.method(x)` calls a remote method; the handle is the
  result of `rpc_factory`.

Three things are assumed. The first is the precedence of `xor`. The second is that a statement which consists of an
expression begins with a name. The third is that the value of a `return` begins on the same line; otherwise the next
statement would be read as the value. `true` and `false` occur in users' programs and mean `True` and `False`.

Each token is examined a limited number of times, so the work is proportional to the length of the text.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal

from .errors import MAX_INTEGER, MAX_NESTING, MAX_PARAMETERS, ProgramError
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
    FunctionParameter,
    Halt,
    If,
    Index,
    Join,
    Kill,
    ListDisplay,
    Member,
    MethodCall,
    Name,
    NodeLabel,
    PoseDisplay,
    Return,
    Scope,
    Statement,
    Unary,
    While,
)
from .tokens import END, NAME, NUMBER, STRING, SourceText, tokens_of
from .values import MemberName

#: Binary operators. The highest precedence comes last.
_LEVELS = (("or",), ("xor",), ("and",), ("==", "!=", "<", "<=", ">", ">="), ("+", "-"), ("*", "/", "%"))
_BINDING = {operator: level for level, operators in enumerate(_LEVELS, 1) for operator in operators}
_COMPARISON = 4
#: Tokens that continue an expression such as a name.
_POSTFIX = ("[", ".")
#: Kinds of tokens that are a complete expression, unless a token of `_CONTINUATIONS` follows.
_LEAVES = frozenset({NAME, NUMBER, STRING, "True", "False", "true", "false"})
_CONTINUATIONS = frozenset({*_BINDING, *_POSTFIX, "("})


def parse(source: SourceText) -> Block:
    """Return the statements of a program.

    Raises:
        ProgramError: If there is a syntax error. The error contains the position in the text and the controller's
            message.
    """
    return _Parser(source).program()


class _Parser:
    def __init__(self, source: SourceText) -> None:
        self._source = source
        self._kinds, self._texts, self._places = tokens_of(source)
        self._at = 0
        self._nesting = 0

    # -- tokens ------------------------------------------------------------------------------------

    def _take(self) -> int:
        """Consume the current token, which must not be the end of the text, and return its place."""
        self._at += 1
        return self._places[self._at - 1]

    def _expect(self, kind: str) -> int:
        if self._kinds[self._at] != kind:
            raise self._unexpected()
        return self._take()

    def _accept(self, kind: str) -> bool:
        if self._kinds[self._at] == kind:
            self._at += 1
            return True
        return False

    def _name(self) -> tuple[int, str]:
        """Consume a name, and return its place and its text."""
        place = self._expect(NAME)
        return place, self._texts[self._at - 1]

    def _begins_a_line(self) -> bool:
        """Whether the current token is the first on its line."""
        return "\n" in self._source.text[self._places[self._at - 1] : self._places[self._at]]

    def _unexpected(self) -> ProgramError:
        return self._source.syntax_error(self._places[self._at])

    def _deeper(self) -> None:
        self._nesting += 1
        if self._nesting > MAX_NESTING:
            raise self._too_deep(self._places[self._at])

    def _too_deep(self, place: int) -> ProgramError:
        line, _ = self._source.line_and_column(place)
        return self._source.failure(place, f"nesting_too_deep_on_line:{line}:")

    def _depth(self, place: int, parts: Sequence[Expression]) -> int:
        """Return the nesting depth of an expression that has these parts."""
        depth = 1 + max((part.depth for part in parts), default=0)
        if depth > MAX_NESTING:
            raise self._too_deep(place)
        return depth

    # -- statements --------------------------------------------------------------------------------

    def program(self) -> Block:
        block: Block = []
        while self._kinds[self._at] != END:
            self._statement(block)
        return block

    def _block(self, *ends: str) -> Block:
        """Parse statements up to one of these keywords. The keyword is not consumed."""
        block: Block = []
        self._deeper()
        while self._kinds[self._at] not in ends:
            self._statement(block)
        self._nesting -= 1
        return block

    def _statement(self, block: Block) -> None:
        kind = self._kinds[self._at]
        reader = _READERS.get(kind)
        if reader is not None:
            block.append(reader(self))
        elif kind == "pass":
            self._at += 1
        else:
            raise self._unexpected()

    def _definition(self, kind: Literal["def", "sec", "thread"]) -> Definition:
        self._at += 1
        place, name = self._name()
        self._expect("(")
        parameters: dict[str, FunctionParameter] = {}
        while self._kinds[self._at] != ")":
            if parameters:
                self._expect(",")
            at, parameter = self._name()
            if parameter in parameters:
                raise self._source.syntax_error(at)
            if len(parameters) == MAX_PARAMETERS:
                raise self._source.failure(at, f"too_many_parameters:{name}:")
            default = self._expression() if self._accept("=") else None
            parameters[parameter] = FunctionParameter(at, parameter, default)
        self._expect(")")
        self._expect(":")
        body = self._block("end")
        self._expect("end")
        return Definition(place, kind, name, list(parameters.values()), body)

    def _if(self) -> If:
        place = self._take()
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
        return If(place, branches, otherwise)

    def _while(self) -> While:
        place = self._take()
        condition = self._expression()
        self._expect(":")
        body = self._block("end")
        self._expect("end")
        return While(place, condition, body)

    def _return(self) -> Return:
        place = self._take()
        ends = self._kinds[self._at] in ("end", "else", "elif", END) or self._begins_a_line()
        return Return(place, None if ends else self._expression())

    def _halt(self) -> Halt:
        place = self._take()
        if self._accept("("):
            self._expect(")")
        return Halt(place)

    def _declaration(self, scope: Scope) -> Statement:
        self._at += 1
        place, name = self._name()
        if self._accept("="):
            return Assign(place, name, scope, [], self._expression())
        return Declare(place, name, scope)

    def _node_label(self) -> NodeLabel:
        place = self._take()
        number = self._number(self._expect(NUMBER), self._texts[self._at - 1])
        self._expect(STRING)
        name = self._texts[self._at - 1][1:-1]
        self._accept(STRING)
        return NodeLabel(place, int(number), name)

    def _simple(self) -> Statement:
        place = self._places[self._at]
        value = self._expression()
        if self._kinds[self._at] != "=":
            return Evaluate(place, value)
        indices: list[Expression] = []
        target = value
        while isinstance(target, (Index, Member)):
            if isinstance(target, Member):
                indices.append(Constant(target.place, 1, False, MemberName(target.name)))
            else:
                indices.append(target.index)
            target = target.base
        if not isinstance(target, Name):
            raise self._unexpected()
        indices.reverse()
        self._at += 1
        return Assign(place, target.name, "free", indices, self._expression())

    # -- expressions -------------------------------------------------------------------------------

    def _expression(self, level: int = 1) -> Expression:
        """Parse an expression with operators of precedence `level` or higher."""
        kinds = self._kinds
        if kinds[self._at] in _LEAVES and kinds[self._at + 1] not in _CONTINUATIONS:
            return self._primary(kinds[self._at])
        self._deeper()
        if kinds[self._at] == "not" and level <= _COMPARISON:
            place = self._take()
            operand = self._expression(_COMPARISON)
            left: Expression = Unary(place, self._depth(place, (operand,)), operand.has_calls, "not", operand)
        else:
            left = self._unary()
        while (binding := _BINDING.get(kinds[self._at], 0)) >= level:
            operator, place = kinds[self._at], self._places[self._at]
            self._at += 1
            right = self._expression(binding + 1)
            depth = 1 + (left.depth if left.depth > right.depth else right.depth)
            if depth > MAX_NESTING:
                raise self._too_deep(place)
            left = Binary(place, depth, left.has_calls or right.has_calls, operator, left, right)
        self._nesting -= 1
        return left

    def _unary(self) -> Expression:
        kind = self._kinds[self._at]
        if kind not in ("-", "+"):
            value = self._primary(kind)
            return value if self._kinds[self._at] not in _POSTFIX else self._postfix(value)
        place = self._take()
        self._deeper()
        operand = self._unary()
        self._nesting -= 1
        if isinstance(operand, Constant) and operand.value.__class__ in (int, float):
            number = operand.value
            return Constant(place, 1, False, -number if kind == "-" else number)
        return Unary(place, self._depth(place, (operand,)), operand.has_calls, kind, operand)

    def _postfix(self, value: Expression) -> Expression:
        while (kind := self._kinds[self._at]) in _POSTFIX:
            place = self._take()
            if kind == ".":
                value = self._member(value)
                continue
            indices = self._items("]")
            if not indices:
                raise self._source.syntax_error(place)
            for index in indices:
                has_calls = value.has_calls or index.has_calls
                value = Index(place, self._depth(place, (value, index)), has_calls, value, index)
        return value

    def _member(self, base: Expression) -> Expression:
        """Parse a member or a method call. The name may be a keyword, as in `program.end()`."""
        name = self._texts[self._at]
        if not name.isidentifier():
            raise self._unexpected()
        place = self._take()
        if not self._accept("("):
            return Member(place, self._depth(place, (base,)), base.has_calls, base, name)
        arguments = self._items(")")
        return MethodCall(place, self._depth(place, (base, *arguments)), True, base, name, arguments)

    def _primary(self, kind: str) -> Expression:
        at = self._at
        place = self._places[at]
        if kind == NAME:
            self._at += 1
            follower = self._kinds[at + 1]
            if follower == "(":
                return self._call(place, self._texts[at], is_run=False)
            if follower == "[" and self._texts[at] == "p":
                return self._pose(place)
            return Name(place, 1, False, self._texts[at])
        if kind == NUMBER:
            self._at += 1
            return Constant(place, 1, False, self._number(place, self._texts[at]))
        if kind == STRING:
            self._at += 1
            return Constant(place, 1, False, self._texts[at][1:-1])
        if kind in ("True", "False", "true", "false"):
            self._at += 1
            return Constant(place, 1, False, kind in ("True", "true"))
        if kind == "(":
            self._at += 1
            value = self._expression()
            self._expect(")")
            return value
        if kind == "[":
            self._at += 1
            items = self._items("]")
            return ListDisplay(place, self._depth(place, items), _have_calls(items), items)
        if kind == "run":
            self._at += 1
            return self._call(*self._name(), is_run=True)
        raise self._unexpected()

    def _pose(self, place: int) -> Expression:
        """Parse `p[...]`: a pose if there are six expressions, or an element of the variable p if there is one."""
        self._at += 1
        items = self._items("]")
        depth, has_calls = self._depth(place, items), _have_calls(items)
        if len(items) == 1:
            return Index(place, depth, has_calls, Name(place, 1, False, "p"), items[0])
        if len(items) != 6:
            raise self._source.syntax_error(place)
        return PoseDisplay(place, depth, has_calls, items)

    def _number(self, place: int, text: str) -> float | int:
        """Return an integer if the text is a whole number of at most 32 bits; otherwise a float (assumed)."""
        if text.isdigit() and len(text) < 20:
            value: float | int = int(text)
        elif text[:2] in ("0x", "0X"):
            value = int(text, 16) if len(text) < 20 else math.inf
        else:
            value = float(text)
        if value > MAX_INTEGER:
            value = float(value)
            if math.isinf(value):
                raise self._source.syntax_error(place)
        return value

    def _items(self, end: str) -> list[Expression]:
        items: list[Expression] = []
        while self._kinds[self._at] != end:
            if items:
                self._expect(",")
            items.append(self._expression())
        self._at += 1
        return items

    def _call(self, place: int, name: str, is_run: bool) -> Call:
        kinds = self._kinds
        self._expect("(")
        arguments: list[Expression] = []
        named: list[tuple[str, Expression]] = []
        while kinds[self._at] != ")":
            if arguments or named:
                self._expect(",")
            if kinds[self._at] == NAME and kinds[self._at + 1] == "=":
                _, key = self._name()
                self._at += 1
                named.append((key, self._expression()))
            elif named:
                raise self._unexpected()
            else:
                arguments.append(self._expression())
        self._at += 1
        depth = self._depth(place, [*arguments, *(value for _, value in named)] if named else arguments)
        return Call(place, depth, True, name, arguments, named, is_run)


#: First token of a statement -> function that parses the statement.
_READERS: dict[str, Callable[[_Parser], Statement]] = {
    "def": lambda parser: parser._definition("def"),
    "sec": lambda parser: parser._definition("sec"),
    "thread": lambda parser: parser._definition("thread"),
    "if": _Parser._if,
    "while": _Parser._while,
    "return": _Parser._return,
    "break": lambda parser: Break(parser._take()),
    "continue": lambda parser: Continue(parser._take()),
    "halt": _Parser._halt,
    "kill": lambda parser: Kill(parser._take(), parser._expression()),
    "join": lambda parser: Join(parser._take(), parser._expression()),
    "global": lambda parser: parser._declaration("global"),
    "local": lambda parser: parser._declaration("local"),
    "run": _Parser._simple,
    "$": _Parser._node_label,
    NAME: _Parser._simple,
}


def _have_calls(items: Sequence[Expression]) -> bool:
    return any(item.has_calls for item in items)
