"""Compiler from the syntax tree of a program to instructions.

An expression becomes one Python function, unless it calls a function of the program or a function that takes time. Such
a call becomes an instruction, which stores the result of the call in a slot of the frame. The operands to the left of
the call are evaluated before it, and their values are stored in slots too, so that the order of evaluation is the order
in the text. A leaf function of the program (`scopes.leaf_size`) also becomes a Python function.
"""

from __future__ import annotations

import contextlib
import copy
import gc
from collections import ChainMap
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal

from urlink.protocol.firmware import Firmware

from . import instructions, operations
from .builtins import find
from .builtins.declaration import REQUIRED, Builtin
from .builtins.remote_procedures import call_method
from .errors import ProgramError
from .instructions import Label
from .machine import FIRST, Code, Instruction, Script, ScriptThread, StatementCode, Waiting
from .operations import Function
from .parser import parse
from .scopes import Functions, Names, global_names, leaf_size
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
    Node,
    NodeLabel,
    PoseDisplay,
    Return,
    Statement,
    Unary,
    While,
    parts_of,
)
from .tokens import SourceText
from .values import NUMBERS, UNSET, MemberName

# Functions that a statement can call without parentheses.
_BARE = ("enter_critical", "exit_critical")
# Name of an undefined variable -> function that is called by an assignment to an element of this variable. The manuals
# (cited from memory) do not mention such assignments. A public client sets outputs with them, and its users report that
# the outputs switch.
_SETTERS = {"digital_out": "set_digital_out"}
# Maximum number of parts of an expression that does not count as work.
_SHORT = 32


def compile_script(text: str, firmware: Firmware) -> Script:
    """Compile a program.

    If the text ends with a `def` or `sec`, this function is the program, and the statements before it run first.
    Otherwise all statements are the program. Both rules are assumed.

    Raises:
        ProgramError: If the program does not compile. The error contains the position in the text and the controller's
            message.
    """
    with _collection_paused():
        source = SourceText(text)
        return _Program(source, parse(source), firmware).script


@contextlib.contextmanager
def _collection_paused() -> Iterator[None]:
    """Disable cyclic garbage collection in this process until the block ends, if it is enabled.

    The compiler makes 0.4 to 1.2 million objects for a program of 250 kB, and none of them can be freed before the end.
    So many new objects trigger one collection after another, and each collection visits all objects. Together, the
    collections would take two thirds of the compile time. `MAX_TOKENS` limits the memory in use during this time to
    about 120 MB.
    """
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


#: Beginnings of the names of functions that open connections or execute statements of clients.
_CONNECTED = ("socket_", "rpc_", "interpreter_mode")


class _Program:
    """Compilation of one program: the state that the compilers of all its functions share."""

    def __init__(self, source: SourceText, statements: Block, firmware: Firmware) -> None:
        self.source = source
        self.firmware = firmware
        last = statements[-1] if statements else None
        body = statements
        name = "unnamed"
        self.kind: Literal["def", "sec"] = "def"
        if isinstance(last, Definition) and last.kind != "thread":
            name, self.kind = last.name, last.kind
            for parameter in last.parameters:
                raise source.failure(parameter.place, f"program_with_parameters:{name}:")
            body = [*statements[:-1], *last.body]
        self.globals = {variable: slot for slot, variable in enumerate(global_names(body))}
        self._builtins: dict[str, Builtin | None] = {}
        self._leaves: dict[int, tuple[Definition, Function | None, int]] = {}
        main = Code(source)
        _Compiler(self, main, body, [], None).compile()
        is_connected = any(name.startswith(_CONNECTED) for name in self._builtins)
        self.script = Script(name, self.kind, main, len(self.globals), is_connected)

    def builtin(self, name: str) -> Builtin | None:
        """Return the built-in function with this name; None if the firmware lacks it."""
        if name not in self._builtins:
            self._builtins[name] = find(name, self.firmware)
        return self._builtins[name]

    def leaf(self, definition: Definition, code: Code) -> tuple[Function | None, int]:
        """Return the Python function for a leaf function, and its number of parts.

        For any other function, return None and 0.
        """
        if code.source is not self.source:
            # Otherwise errors in the leaf function would show positions in the text of a later statement.
            return None, 0
        if id(definition) not in self._leaves:
            size = leaf_size(definition, self.globals)
            compiler = _Compiler(self, Code(self.source), definition.body, definition.parameters, None)
            self._leaves[id(definition)] = definition, compiler.leaf() if size else None, size
        _, function, size = self._leaves[id(definition)]
        return function, size

    def error(self, node: Node, text: str) -> ProgramError:
        """Return a compile error at the position of a node."""
        return self.source.failure(node.place, text)

    def not_found(self, node: Node, name: str) -> ProgramError:
        """Return the error for an undefined name."""
        return self.error(node, f"compile_error_name_not_found:{name}:")


class _Compiler:
    """Compiler of one function."""

    def __init__(
        self, program: _Program, code: Code, body: Block, parameters: list[FunctionParameter], outer: Functions | None
    ) -> None:
        self._program = program
        self._code = code
        self._body = body
        self._outer = outer
        self._parameters = parameters
        # Parameters without a default, which always have a value.
        self._given = {parameter.name for parameter in self._parameters if parameter.default is None}
        names = Names.of(body)
        defined = {each.name: (each, Code(program.source)) for each in names.definitions}
        self.functions: Functions = ChainMap(defined) if outer is None else outer.new_child(defined)
        own = [
            *(parameter.name for parameter in self._parameters),
            *sorted(names.local),
            *sorted(names.free.keys() - program.globals.keys()),
        ]
        self._slots = {name: slot for slot, name in enumerate(dict.fromkeys(own), FIRST)}
        self._used = self._top = FIRST + len(self._slots)
        self._makers: list[tuple[Callable[[int], Instruction], int]] = []
        self._loops: list[tuple[Label, Label]] = []
        self._labels: dict[str | int, Label] = {}
        self._taking: dict[int, bool] = {}
        # Number of parts of all expressions since the last instruction.
        self._parts = 0

    def compile(self) -> None:
        """Generate the instructions."""
        for parameter in self._parameters:
            if parameter.default is not None:
                self._default(parameter, parameter.default, self._slots[parameter.name])
        self._block(self._body)
        last = self._body[-1] if self._body else None
        self._makers.append((lambda after: instructions.leave(None), last.place if last else 0))
        self._code.size = self._top
        self._code.instructions.extend(maker(at) for at, (maker, _) in enumerate(self._makers, 1))
        self._code.places.extend(place for _, place in self._makers)

    def leaf(self) -> Function:
        """Return the Python function for a leaf function. It is called with the frame."""
        return self._chosen(self._body, operations.constant(None))

    def _chosen(self, block: Block, after: Function) -> Function:
        """Return a function for the value that these statements return, or `after` returns if they return none."""
        for statement in reversed(block):
            if isinstance(statement, Return):
                after = operations.constant(None) if statement.value is None else self._value(statement.value)
            elif isinstance(statement, If):
                chosen = self._chosen(statement.otherwise, after)
                for condition, body in reversed(statement.branches):
                    then = self._chosen(body, after)
                    chosen = operations.choice(self._value(condition), then, chosen, condition.place)
                after = chosen
        return after

    def statement(self, text: str) -> StatementCode:
        """Compile a statement of interpreter mode into the scope of this function.

        The statement assigns to variables of this function, or to global variables if the function is the program
        itself. If the statement defines functions, later statements can call them.

        Raises:
            ProgramError: If the statement does not compile.
        """
        source = SourceText(text)
        body = parse(source)
        known = self._program.globals
        names = Names.of(body)
        for name in global_names(body) if self._outer is None else names.global_:
            known.setdefault(name, len(known))
        for name in (*names.local, *names.free):
            if name not in known and name not in self._slots:
                self._slots[name] = self._code.size
                self._code.size += 1
        # Use the same program, but with the text of the statement as source.
        program = copy.copy(self._program)
        program.source = source
        compiler = _Compiler(program, Code(source), body, [], self.functions)
        compiler._slots = self._slots
        compiler._used = compiler._top = self._code.size
        compiler.compile()
        if compiler.functions.maps[0]:
            self.functions = compiler.functions
        return StatementCode(compiler._code, len(known))

    def _default(self, parameter: Node, default: Expression, slot: int) -> None:
        """Generate instructions that evaluate a default value in the called function, at each call (assumed)."""
        given = Label()
        self._emit(parameter, lambda after: instructions.skip_if_set(slot, given, after))
        value = self._value(default)
        self._emit(parameter, lambda after: instructions.store(False, slot, value, after))
        self._mark(given)

    # -- instructions ------------------------------------------------------------------------------

    def _emit(self, node: Node, maker: Callable[[int], Instruction]) -> None:
        parts, self._parts = self._parts, 0
        if parts > _SHORT:
            self._makers.append((lambda after: instructions.spend(parts, after), node.place))
        self._makers.append((maker, node.place))

    def _mark(self, label: Label) -> None:
        label.at = len(self._makers)

    def _slot(self) -> int:
        """Return a slot of the frame that this statement does not use yet."""
        slot = self._used
        self._used += 1
        self._top = max(self._top, self._used)
        return slot

    # -- statements --------------------------------------------------------------------------------

    def _block(self, block: Block) -> None:
        for statement in block:
            used = self._used
            _STATEMENTS[statement.__class__](self, statement)
            self._used = used

    def _return(self, s: Return) -> None:
        value = None if s.value is None else self._value(s.value)
        self._emit(s, lambda after: instructions.leave(value))

    def _leave_loop(self, s: Break | Continue) -> None:
        if not self._loops:
            line, _ = self._program.source.line_and_column(s.place)
            raise self._program.error(s, f"not_in_a_loop_on_line:{line}:")
        label = self._loops[-1][isinstance(s, Break)]
        self._emit(s, lambda after: instructions.jump(label))

    def _node_label(self, s: NodeLabel) -> None:
        """Register a target of `jump_to_label` under its name and its number.

        If several targets have the same name, the first is used.
        """
        label = Label()
        self._mark(label)
        self._labels.setdefault(s.name, label)
        self._labels.setdefault(s.number, label)

    def _halt(self, s: Halt) -> None:
        self._emit(s, lambda after: instructions.halt())

    def _kill(self, s: Kill) -> None:
        handle = self._value(s.handle)
        self._emit(s, lambda after: instructions.kill(handle, after))

    def _join(self, s: Join) -> None:
        self._takes_time(s, "join")
        handle, slot = self._value(s.handle), self._slot()
        self._emit(s, lambda after: instructions.join(handle, slot, after))

    def _define(self, s: Definition) -> None:
        definition, code = self.functions[s.name]
        if definition is not s or s.kind == "sec":
            raise self._program.error(s, f"compile_error_name_already_used:{s.name}:")
        _Compiler(self._program, code, s.body, s.parameters, self.functions).compile()

    def _assign(self, s: Assign) -> None:
        is_known = s.name in self._slots or s.name in self._program.globals
        if not is_known and s.name in _SETTERS and len(s.indices) == 1 and not _is_member(s.indices[0]):
            setting = Call(s.place, 1, True, _SETTERS[s.name], [s.indices[0], s.value], [], False)
            value = self._call_builtin(setting)
            self._emit(s, lambda after: instructions.evaluate(value, after))
            return
        if s.scope == "global" or s.name not in self._slots:
            if s.name not in self._program.globals:
                raise self._program.not_found(s, s.name)
            is_global, slot = True, self._program.globals[s.name]
        else:
            is_global, slot = False, self._slots[s.name]
        *indices, value = self._sequence([*s.indices, s.value])
        if s.indices:
            self._emit(s, lambda after: instructions.store_element(is_global, slot, s.name, indices, value, after))
        else:
            self._emit(s, lambda after: instructions.store(is_global, slot, value, after))

    def _evaluate(self, s: Evaluate) -> None:
        expression = s.value
        if isinstance(expression, Name) and expression.name in _BARE:
            expression = Call(expression.place, 1, True, expression.name, [], [], False)
        value = self._value(expression)
        if not self._is_instruction(expression):
            self._emit(s, lambda after: instructions.evaluate(value, after))

    def _if(self, s: If) -> None:
        end = Label()
        for condition, body in s.branches:
            otherwise = Label()
            self._condition(condition, otherwise)
            self._block(body)
            if s.otherwise or condition is not s.branches[-1][0]:
                self._emit(s, lambda after: instructions.jump(end))
            self._mark(otherwise)
        self._block(s.otherwise)
        self._mark(end)

    def _while(self, s: While) -> None:
        begin, end = Label(), Label()
        self._mark(begin)
        self._condition(s.condition, end)
        self._loops.append((begin, end))
        self._block(s.body)
        self._loops.pop()
        self._emit(s, lambda after: instructions.jump(begin))
        self._mark(end)

    def _condition(self, condition: Expression, otherwise: Label) -> None:
        if isinstance(condition, Constant) and condition.value is True:
            return
        used = self._used
        value = self._value(condition)
        self._used = used
        self._emit(condition, lambda after: instructions.branch(value, otherwise, after))

    # -- expressions -------------------------------------------------------------------------------

    def _takes(self, node: Expression) -> bool:
        """Whether an expression contains a call that becomes an instruction."""
        if not node.has_calls:
            return False
        if id(node) not in self._taking:
            self._taking[id(node)] = self._is_instruction(node) or any(self._takes(part) for part in parts_of(node))
        return self._taking[id(node)]

    def _is_instruction(self, node: Expression) -> bool:
        """Whether an expression is a call that becomes an instruction."""
        if not isinstance(node, Call) or node.is_run:
            return isinstance(node, MethodCall)
        found = self.functions.get(node.name)
        if found is not None:
            return self._program.leaf(*found)[0] is None
        builtin = self._program.builtin(node.name)
        return builtin is None or builtin.takes_time

    def _sequence(self, nodes: Sequence[Expression]) -> list[Function]:
        """Return Python functions for expressions that are evaluated from left to right."""
        last = -1
        for at, node in enumerate(nodes):
            if node.has_calls and self._takes(node):
                last = at
        if last < 0:
            return [self._value(node) for node in nodes]
        functions = []
        for at, node in enumerate(nodes):
            function = self._value(node)
            if at < last and not isinstance(node, Constant):
                function = self._kept(node, function)
            functions.append(function)
        return functions

    def _kept(self, node: Node, function: Function) -> Function:
        slot = self._slot()
        self._emit(node, lambda after: instructions.store(False, slot, function, after))
        return operations.temporary(slot)

    def _value(self, node: Expression) -> Function:
        """Return the Python function for an expression, and emit the instructions for its calls."""
        self._parts += 1
        return _EXPRESSIONS[node.__class__](self, node)

    def _constant(self, node: Constant) -> Function:
        return operations.constant(node.value)

    def _pose(self, node: PoseDisplay) -> Function:
        return operations.pose_display(self._sequence(node.items), node.place)

    def _member(self, node: Member) -> Function:
        return operations.member(self._value(node.base), node.name, node.place)

    def _list(self, node: ListDisplay) -> Function:
        if all(isinstance(item, Constant) for item in node.items) and len(node.items) < 32:
            return operations.constant(tuple([item.value for item in node.items if isinstance(item, Constant)]))
        return operations.display(self._sequence(node.items), node.place)

    def _index(self, node: Index) -> Function:
        at = node.index.value if isinstance(node.index, Constant) else None
        if isinstance(node.base, Name) and at.__class__ is int and at >= 0:
            self._parts += 2
            name = node.base.name
            if name in self._slots:
                return operations.local_element(self._slots[name], int(at), name, node.base.place, node.place)
            if name in self._program.globals:
                slot = self._program.globals[name]
                return operations.global_element(slot, int(at), name, node.base.place, node.place)
            raise self._program.not_found(node.base, name)
        base, index = self._sequence((node.base, node.index))
        return operations.element(base, index, node.place)

    def _unary(self, node: Unary) -> Function:
        operand = self._value(node.operand)
        if node.operator == "not":
            return operations.inverted(operand, node.place)
        return operations.signed(node.operator, operand, node.place)

    def _variable(self, node: Name) -> Function:
        if node.name in self._given:
            return operations.temporary(self._slots[node.name])
        if node.name in self._slots:
            return operations.local_variable(self._slots[node.name], node.name, node.place)
        if node.name in self._program.globals:
            return operations.global_variable(self._program.globals[node.name], node.name, node.place)
        raise self._program.not_found(node, node.name)

    def _binary(self, node: Binary) -> Function:
        place = node.place
        if node.operator not in ("and", "or"):
            known_right = node.right.value if isinstance(node.right, Constant) else None
            if isinstance(known_right, (int, float)) and known_right.__class__ in NUMBERS:
                self._parts += 1
                return operations.operation_by(node.operator, self._value(node.left), known_right, place)
            left, right = self._sequence((node.left, node.right))
            return operations.operation(node.operator, left, right, place)
        join_of = operations.both if node.operator == "and" else operations.either
        if not self._takes(node.right):
            return join_of(self._value(node.left), self._value(node.right), place)
        # If the left operand determines the result, jump over the instructions of the right operand.
        settled, slot = Label(), self._slot()
        left = operations.checked_truth(self._value(node.left), place)
        self._emit(node, lambda after: instructions.store(False, slot, left, after))
        known = operations.temporary(slot)
        goes_on = known if node.operator == "and" else operations.inverted(known, place)
        self._emit(node, lambda after: instructions.branch(goes_on, settled, after))
        right = operations.checked_truth(self._value(node.right), place)
        self._emit(node, lambda after: instructions.store(False, slot, right, after))
        self._mark(settled)
        return known

    # -- calls -------------------------------------------------------------------------------------

    def _call(self, node: Call) -> Function:
        found = self.functions.get(node.name)
        if found is None:
            if node.is_run:
                raise self._program.not_found(node, node.name)
            return self._call_builtin(node)
        definition, code = found
        if node.is_run is not (definition.kind == "thread"):
            wanted = "thread" if node.is_run else "function"
            raise self._program.error(node, f"compile_error_not_a_{wanted}:{node.name}:")
        arguments = self._arguments(
            node, [(p.name, REQUIRED if p.default is None else UNSET) for p in definition.parameters]
        )
        if node.is_run:
            self._takes_time(node, "run")
            return operations.placed(instructions.start(code, arguments), node.place)
        leaf, size = self._program.leaf(definition, code)
        if leaf is not None:
            self._parts += size
            return operations.leaf_call(leaf, arguments)
        slot = self._slot()
        self._emit(node, lambda after: instructions.call(code, arguments, slot, after))
        return operations.temporary(slot)

    def _method_call(self, node: MethodCall) -> Function:
        self._takes_time(node, node.name)
        operands, slot = self._sequence((node.base, *node.arguments)), self._slot()

        def call_it(thread: ScriptThread, base: Any, *arguments: Any) -> Waiting:
            return call_method(thread, base, node.name, arguments)

        self._emit(node, lambda after: instructions.await_builtin(call_it, operands, slot, after))
        return operations.temporary(slot)

    def _struct(self, node: Call) -> Function:
        """Compile `struct(a=1, b=2)`, in which the names of the arguments are the names of the members."""
        for argument in node.arguments:
            raise self._program.error(argument, "compile_error_member_without_name:struct:")
        names = [name for name, _ in node.named]
        return operations.structure(names, self._sequence([value for _, value in node.named]), node.place)

    def _call_builtin(self, node: Call) -> Function:
        if node.name == "struct" and not self._program.firmware.is_cb2:
            return self._struct(node)
        builtin = self._program.builtin(node.name)
        if builtin is None:
            raise self._program.not_found(node, node.name)
        if not builtin.in_secondary:
            self._takes_time(node, node.name)
        if builtin.is_variadic:
            arguments = self._sequence([*node.arguments, *(value for _, value in node.named)])
        else:
            arguments = self._arguments(node, builtin.parameters)
        if node.name == "interpreter_mode":
            return self._interpreter_mode(node, arguments)
        if node.name == "jump_to_label":
            self._emit(node, lambda after: instructions.jump_to_label(self._labels, arguments[0]))
            return operations.constant(None)
        if not builtin.takes_time:
            return operations.call(builtin.function, arguments, node.place)
        slot = self._slot()
        self._emit(node, lambda after: instructions.await_builtin(builtin.function, arguments, slot, after))
        return operations.temporary(slot)

    def _interpreter_mode(self, node: Call, arguments: Sequence[Function]) -> Function:
        """Emit two instructions for `interpreter_mode`, because statements can arrive between them."""
        slot = self._slot()
        on_enter, on_end = arguments
        self._emit(node, lambda after: instructions.enter_interpreter(self.statement, on_enter, on_end, after))
        self._emit(node, lambda after: instructions.interpret(slot, after))
        return operations.constant(None)

    def _takes_time(self, node: Node, what: str) -> None:
        """Raise if this is a `sec` program, in which calls may not take time.

        It is assumed that such a call is a compile error.
        """
        if self._program.kind == "sec":
            raise self._program.error(node, f"compile_error_not_allowed_in_secondary_program:{what}:")

    def _arguments(self, node: Call, parameters: Sequence[tuple[str, object]]) -> list[Function]:
        """Return one function for each parameter, in the order of the parameters.

        If the number of arguments is wrong, the program fails at run time.
        """
        positions = {name: at for at, (name, _) in enumerate(parameters)}
        for name, value in node.named:
            if name not in positions:
                raise self._program.not_found(value, name)
        worked_out = self._sequence([*node.arguments, *(value for _, value in node.named)])
        given: list[Function | None] = [None] * len(parameters)
        given[: len(node.arguments)] = worked_out[: len(node.arguments)]
        problem = len(given) > len(parameters)
        for (name, _), function in zip(node.named, worked_out[len(node.arguments) :], strict=True):
            problem |= given[positions[name]] is not None
            given[positions[name]] = function
        if problem or any(
            function is None and default is REQUIRED for function, (_, default) in zip(given, parameters, strict=False)
        ):
            least = sum(default is REQUIRED for _, default in parameters)
            wanted = f"exactly {least}" if least == len(parameters) else f"{least} to {len(parameters)}"
            failing = operations.failing(
                f"Type error: {node.name} takes {wanted} arguments, {len(node.arguments) + len(node.named)} given"
            )
            return [failing] * max(1, len(parameters))
        return [
            operations.constant(default) if function is None else function
            for function, (_, default) in zip(given, parameters, strict=True)
        ]


# These tables are not in the compiler object, because bound methods in it would create a reference cycle. The whole
# syntax tree would then stay in memory until the next garbage collection. Class of a statement -> method that compiles
# it.
_STATEMENTS: dict[type[Statement], Callable[[_Compiler, Any], None]] = {
    Assign: _Compiler._assign,
    Evaluate: _Compiler._evaluate,
    If: _Compiler._if,
    While: _Compiler._while,
    Return: _Compiler._return,
    Break: _Compiler._leave_loop,
    Continue: _Compiler._leave_loop,
    NodeLabel: _Compiler._node_label,
    Halt: _Compiler._halt,
    Kill: _Compiler._kill,
    Join: _Compiler._join,
    Definition: _Compiler._define,
    Declare: lambda compiler, s: None,
}
#: Class of an expression -> method that compiles it.
_EXPRESSIONS: dict[type[Expression], Callable[[_Compiler, Any], Function]] = {
    Constant: _Compiler._constant,
    Name: _Compiler._variable,
    ListDisplay: _Compiler._list,
    PoseDisplay: _Compiler._pose,
    Index: _Compiler._index,
    Member: _Compiler._member,
    MethodCall: _Compiler._method_call,
    Unary: _Compiler._unary,
    Binary: _Compiler._binary,
    Call: _Compiler._call,
}


def _is_member(index: Expression) -> bool:
    return isinstance(index, Constant) and isinstance(index.value, MemberName)
