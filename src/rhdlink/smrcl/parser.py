"""Parser of one line of SMR-CL to its syntax tree.

The parser uses recursive descent with precedence climbing.

::

    line       = { assignment } [ command | wait | eval | if | switch | case | endswitch ]
    assignment = variable [ "[" expression "]" ] "=" expression
    command    = COMMAND { ["-"] NUMBER | variable | STRING } { "@v" ["-"] NUMBER | "@v" variable
                 | "@a" NUMBER | "@a" variable } [ ":" conditions ]
    wait       = ":" conditions
    conditions = "(" expression ")" { "|" "(" expression ")" }
    eval       = "eval" expression { ";" expression }
    if         = "if" "(" expression ")" STRING            ; the rest of the line is ignored
    switch     = "switch" "(" expression ")"               ; the rest of the line is ignored
    case       = "case" NUMBER                             ; the rest of the line is ignored
    endswitch  = "endswitch"                               ; the rest of the line is ignored

MRC executes a line while it reads the line, so the text before an error has already been executed. For a line with an
error, this parser returns the tree of the text before the error, and the error (`ScriptLine`). The execution of this
result has the same effect as in MRC.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from .arithmetic import BINARY_FUNCTIONS, UNARY_FUNCTIONS
from .lexer import LONGEST_NAME, Token, TokenType, tokenize
from .plan import LONGEST_LINE
from .syntax import (
    PRECEDENCE,
    UNARY_PRECEDENCE,
    ArrayElement,
    Assign,
    Binary,
    Call,
    Case,
    CommandStatement,
    EndSwitch,
    Evaluate,
    Expression,
    If,
    Negate,
    NumberLiteral,
    Operand,
    Problem,
    ScriptLine,
    SpeedSetting,
    Statement,
    Switch,
    TextLiteral,
    VariableName,
    WaitFor,
)

#: Words that begin statements and cannot be names.
KEYWORDS = frozenset(("if", "eval", "switch", "case", "endswitch"))

#: Number of arguments of each function of the language.
FUNCTIONS: Mapping[str, int] = {
    **dict.fromkeys(UNARY_FUNCTIONS, 1),
    **dict.fromkeys(BINARY_FUNCTIONS, 2),
    "rem": 2,
    "ntrue": 2,
}

#: Maximum depth of nested brackets. A line of 255 characters has room for 125; scripts use only a few.
DEEPEST = 60


class _Unexpected(Exception):
    """Error: the next token is not allowed at this position. It is not raised outside of this module."""

    def __init__(self, token: Token, message: str) -> None:
        super().__init__(message)
        self.token = token


class Parser:
    """Parser of lines.

    Args:
        commands: Names of the commands, which variables cannot have.
        functions: Names of additional functions; they accept any number of arguments.
    """

    def __init__(self, commands: Collection[str], functions: Iterable[str] = ()) -> None:
        self._commands = commands
        self._functions: dict[str, int | None] = {**FUNCTIONS, **dict.fromkeys(functions)}
        self._tokens: list[Token] = []
        self._place = self._depth = 0
        self._statements: list[Statement] = []

    def parse(self, text: str) -> ScriptLine:
        """Parse a line into a tree. Never raises: an error is stored in the tree."""
        length = len(text.rstrip("\r\n"))
        if length > LONGEST_LINE:
            # Do not execute any part of this line, because the length of a line limits the depth of its tree.
            return ScriptLine(
                (), Problem(LONGEST_LINE + 1, f"the line has {length} characters; {LONGEST_LINE} are allowed")
            )
        self._tokens = tokenize(text)
        self._place = self._depth = 0
        self._statements = []
        problem = None
        try:
            while (statement := self._statement()) is not None:
                self._statements.append(statement)
                if not isinstance(statement, Assign):
                    break
        except _Unexpected as error:
            problem = Problem(error.token.column, str(error))
        return ScriptLine(tuple(self._statements), problem)

    # -- tokens --------------------------------------------------------------------------------

    @property
    def _token(self) -> Token:
        return self._tokens[self._place]

    def _next(self) -> Token:
        self._place += 1
        return self._tokens[self._place - 1]

    def _is(self, symbol: str) -> bool:
        return self._token.type is TokenType.SYMBOL and self._token.text == symbol

    def _take(self, symbol: str) -> bool:
        if self._is(symbol):
            self._place += 1
            return True
        return False

    def _expect(self, symbol: str, where: str) -> None:
        if not self._take(symbol):
            raise self._unexpected(f"'{symbol}' {where}")

    def _unexpected(self, expected: str) -> _Unexpected:
        token = self._token
        found = f"'{token}'"
        if token.type is TokenType.NAME:
            found = f"the {self._kind(token.text)} {token.text}"
        elif token.type in (TokenType.END, TokenType.FOREIGN):
            found = str(token)
        return _Unexpected(token, f"expected {expected}, found {found}")

    def _kind(self, name: str) -> str:
        if name in KEYWORDS:
            return "word"
        if name in self._commands:
            return "command"
        return "function" if name in self._functions else "name"

    def _is_variable(self) -> bool:
        token = self._token
        return token.type is TokenType.SYSTEM or (token.type is TokenType.NAME and self._kind(token.text) == "name")

    def _number(self, expected: str) -> float:
        if self._token.type is not TokenType.NUMBER:
            raise self._unexpected(expected)
        return self._next().value

    def _variable(self) -> VariableName:
        token = self._next()
        if len(token.text) > LONGEST_NAME:
            raise _Unexpected(
                token, f"a name can have at most {LONGEST_NAME} characters; this one has {len(token.text)}"
            )
        return VariableName(token.text, token.type is TokenType.SYSTEM, token.column)

    # -- statements ----------------------------------------------------------------------------

    def _statement(self) -> Statement | None:
        """Parse the statement that begins here; None at the end of the line."""
        token = self._token
        if token.type is TokenType.END:
            return None
        if token.type is TokenType.FOREIGN:
            return WaitFor((), token.column)
        if self._take(":"):
            conditions = self._conditions()
            self._end("the conditions")
            return WaitFor(conditions, token.column)
        if token.type in (TokenType.NAME, TokenType.SYSTEM):
            if self._is_variable():
                return self._assignment()
            if token.text in KEYWORDS:
                self._place += 1
                return self._keyword(token.text)
            if token.text in self._commands:
                self._place += 1
                return self._command(token)
        raise self._unexpected("a command or an assignment")

    def _keyword(self, word: str) -> Statement:
        if word == "eval":
            values = [self._expression()]
            while self._take(";"):
                values.append(self._expression())
            self._end("the values")
            return Evaluate(tuple(values))
        if word == "if":
            condition = self._bracketed("after if")
            if self._token.type is not TokenType.STRING:
                raise self._unexpected('a label, as in if (a > 1) "label"')
            label = self._next()
            return If(condition, label.text, label.column)
        if word == "switch":
            return Switch(self._bracketed("after switch"))
        if word == "case":
            return Case(NumberLiteral(self._number("a number after case")))
        return EndSwitch()

    def _assignment(self) -> Assign:
        target = self._variable_or_element()
        if not self._take("="):
            if isinstance(target, VariableName) and not target.is_system:
                raise self._unexpected(f"'=' after {target.name}, which is not a command")
            raise self._unexpected("'='")
        value = self._expression()
        following = self._token
        is_name = following.type is TokenType.NAME and self._is_variable()
        return Assign(target, value, following.text if is_name else None)

    def _command(self, name: Token) -> CommandStatement:
        """Parse a command.

        If it contains an error, its first part becomes a statement of the line too.
        """
        parameters: list[Operand] = []
        speeds: list[SpeedSetting] = []
        conditions: tuple[Expression, ...] = ()
        try:
            while (operand := self._parameter()) is not None:
                parameters.append(operand)
            while (speed := self._speed()) is not None:
                speeds.append(speed)
            if self._take(":"):
                conditions = self._conditions()
            self._end("the parameters" if not (speeds or conditions) else "the line")
        except _Unexpected:
            self._statements.append(
                CommandStatement(name.text, tuple(parameters), tuple(speeds), column=name.column, is_broken=True)
            )
            raise
        return CommandStatement(name.text, tuple(parameters), tuple(speeds), conditions, name.column)

    def _parameter(self) -> Operand | None:
        token = self._token
        if token.type is TokenType.NUMBER:
            return NumberLiteral(self._next().value)
        if token.type is TokenType.STRING:
            return TextLiteral(self._next().text)
        if self._is_variable():
            return self._variable()
        if self._take("-"):
            return NumberLiteral(-self._number("a number after '-'; a parameter is a number, a variable or a text"))
        return None

    def _speed(self) -> SpeedSetting | None:
        for letter in "va":
            if self._take(f"@{letter}"):
                if letter == "v" and self._take("-"):
                    return SpeedSetting(letter, NumberLiteral(-self._number("a number after '@v -'")))
                if self._token.type is TokenType.NUMBER:
                    return SpeedSetting(letter, NumberLiteral(self._next().value))
                if self._is_variable():
                    return SpeedSetting(letter, self._variable())
                raise self._unexpected(f"a number or a variable after '@{letter}'")
        return None

    def _conditions(self) -> tuple[Expression, ...]:
        found = [self._bracketed("around a condition")]
        while self._take("|"):
            found.append(self._bracketed("around a condition"))
        return tuple(found)

    def _bracketed(self, where: str) -> Expression:
        self._expect("(", where)
        expression = self._expression()
        self._expect(")", where)
        return expression

    def _end(self, what: str) -> None:
        if self._token.type is not TokenType.END:
            raise self._unexpected(f"the end of the line after {what}")

    # -- expressions ---------------------------------------------------------------------------

    def _expression(self, loosest: int = 0) -> Expression:
        """Parse an expression whose operators bind at least as tightly as `loosest`."""
        self._depth += 1
        if self._depth > DEEPEST:
            raise _Unexpected(self._token, f"brackets and signs are nested too deeply; the maximum is {DEEPEST}")
        left = self._primary()
        while self._token.type is TokenType.SYMBOL:
            operator = self._token.text
            level = PRECEDENCE.get(operator)
            if level is None or level < loosest:
                break
            self._place += 1
            left = Binary(operator, left, self._expression(level if operator == "^" else level + 1))
        self._depth -= 1
        return left

    def _primary(self) -> Expression:
        token = self._token
        if token.type is TokenType.NUMBER:
            return NumberLiteral(self._next().value)
        if self._take("-"):
            return Negate(self._expression(UNARY_PRECEDENCE))
        if self._is("("):
            return self._bracketed("around an expression")
        if token.type is TokenType.NAME and token.text in self._functions:
            self._place += 1
            return self._call(token)
        if self._is_variable():
            return self._variable_or_element()
        raise self._unexpected("a number, a variable or '('")

    def _variable_or_element(self) -> VariableName | ArrayElement:
        variable = self._variable()
        if not self._take("["):
            return variable
        element = ArrayElement(variable, self._expression())
        self._expect("]", "after the index")
        return element

    def _call(self, name: Token) -> Call:
        self._expect("(", f"after the function {name.text}")
        count = self._functions[name.text]
        arguments: list[Expression] = []
        if not (count is None and self._is(")")):
            arguments.append(self._expression())
            while (count is None or len(arguments) < count) and self._take(","):
                arguments.append(self._expression())
        if count is not None and len(arguments) < count:
            raise self._unexpected(f"',' and another value: {name.text} takes {count}")
        self._expect(")", f"after the {'value' if count == 1 else 'values'} of {name.text}")
        return Call(name.text, tuple(arguments), name.column)
