"""Small changes of code, told by function and by what the syntax has there, so that no source text is quoted.

A change is `WHAT -> INTO` of the nth such node in a function, in the order of the source. WHAT is an operator (`+`,
`<=`, `and`, `-x` for a sign), a name, an attribute by its last name (`.sigma`), a constant, or the kind of a larger
expression: `call NAME`, `if`, `[]`, `()`, `+ ...` for a whole term with that operator. INTO is an operator, or an
expression in which `it` is what stood there, and `left`, `right`, `first`, `yes`, `no` are its operands, its first
argument and the two sides of an `if`.

A mutation is a change that nobody thought of: WHAT is its operator, of those that `mutations` finds in any function,
and there is no INTO.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

OPERATORS: dict[str, type[ast.AST]] = {
    "+": ast.Add, "-": ast.Sub, "*": ast.Mult, "/": ast.Div, "//": ast.FloorDiv, "%": ast.Mod, "**": ast.Pow,
    "@": ast.MatMult, "&": ast.BitAnd, "|": ast.BitOr, "<": ast.Lt, "<=": ast.LtE, ">": ast.Gt, ">=": ast.GtE,
    "==": ast.Eq, "!=": ast.NotEq, "and": ast.And, "or": ast.Or, "-x": ast.USub, "not": ast.Not,
}  # fmt: skip
KINDS: dict[str, type[ast.AST]] = {"if": ast.IfExp, "[]": ast.Subscript, "()": ast.Tuple}
OPPOSITE: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot, ast.In: ast.NotIn, ast.Add: ast.Sub,
    ast.Mult: ast.Div, ast.And: ast.Or,
}  # fmt: skip
OPPOSITE |= {other: one for one, other in OPPOSITE.items()}
Site = tuple[str, ast.AST, str]
"""Operator of a mutation, what stands in the code, and the text that takes its place."""
SILENT = ("strict", "encoding", "optimize")
"""Keywords that change nothing where lengths agree, on machines of UTF-8, and but the time that it takes."""
SEARCHED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


class StaleChangeError(Exception):
    """A change that does not fit the code any more."""


@dataclass(frozen=True)
class Change:
    """`what -> into`, of the nth such node; the nth mutation by the operator `what` where `into` is empty."""

    what: str
    into: str
    nth: int

    @classmethod
    def read(cls, text: str) -> Change:
        """From `WHAT -> INTO`, `WHAT #NTH -> INTO`, or `OPERATOR #NTH` of a mutation."""
        what, _, into = text.partition(" -> ")
        what, _, nth = what.partition(" #")
        return cls(what, into, int(nth or 1))

    def of(self, function: ast.AST) -> tuple[Any, str]:
        """The expression or statement that it changes, and what takes its place."""
        if not self.into:
            sites = [(node, text) for operator, node, text in mutations(function) if operator == self.what]
            if len(sites) < self.nth:
                raise StaleChangeError(f"has {len(sites)} times: {self.what} (wanted: number {self.nth})")
            return sites[self.nth - 1]
        found = [node for node in walk(function) if self._fits(node)]
        if len(found) < self.nth:
            raise StaleChangeError(f"has {len(found)} times: {self.what} (wanted: number {self.nth})")
        node = found[self.nth - 1]
        if self.into in OPERATORS:
            return node, f"({ast.unparse(_with_operator(node, OPERATORS[self.into]()))})"
        return node, f"({ast.unparse(_Filled(node).visit(ast.parse(self.into, mode='eval').body))})"

    def _fits(self, node: ast.expr) -> bool:
        what = self.what.removesuffix(" ...")
        if what in OPERATORS:
            return type(_operator(node)) is OPERATORS[what]
        if what in KINDS:
            return isinstance(node, KINDS[what])
        if what.startswith("call "):
            return isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] == what.removeprefix("call ")
        if what.startswith("."):
            return isinstance(node, ast.Attribute) and node.attr == what[1:]
        return isinstance(node, ast.Name | ast.Constant) and ast.unparse(node) == what


def find(tree: ast.AST, qualified: str) -> ast.AST:
    """A function, a class or an assignment of a module by its name, such as `Score.p_value`."""
    for name in qualified.split("."):
        named = [node for node in ast.iter_child_nodes(tree) if name in _names(node)]
        if not named:
            named = [node for node in ast.walk(tree) if isinstance(node, SEARCHED) and node.name == name]
        if len(named) != 1:
            raise StaleChangeError(f"has {len(named)} of the name {qualified}")
        tree = named[0]
    return tree


def changed(source: str, qualified: str, changes: list[Change]) -> str:
    """The source of a module with changes of one of its functions; all else stays as it is, comments too."""
    function = find(ast.parse(source), qualified)
    starts = [0]
    for line in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    places = []
    for change in changes:
        node, text = change.of(function)
        end = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
        places.append((starts[node.lineno - 1] + node.col_offset, end, text.encode()))
    code = source.encode()
    for start, end, new in sorted(places, reverse=True):
        code = code[:start] + new + code[end:]
    result = code.decode()
    if ast.dump(ast.parse(result)) == ast.dump(ast.parse(source)):
        raise StaleChangeError("is not changed")
    return result


def walk(node: ast.AST) -> Iterator[ast.expr]:
    """The expressions of a function in the order of the source, the outer before the inner."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            yield child
        yield from walk(child)


def mutations(function: ast.AST) -> Iterator[Site]:
    """Every mutation of a function, in the order of the source and without its head."""
    if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
        return
    names = [one.arg for one in (*function.args.posonlyargs, *function.args.args) if one.arg not in ("self", "cls")]
    for node in (one for statement in function.body for one in _executed(statement)):
        yield from _opposites(node)
        yield from _numbers(node)
        match node:
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
                yield "condition negated", test, _negated(test)
            case ast.comprehension(ifs=[test, *_]):
                yield "condition negated", test, _negated(test)
            case ast.Raise() | ast.Expr(value=ast.Call()) | ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
                yield "statement dropped", node, "pass"
            case ast.Return(value=ast.expr() as value) if names and ast.unparse(value) != names[0]:
                yield "first argument returned", value, names[0]
            case ast.Call(func=ast.Name(id="sorted")):
                yield "order reversed", node, f"{ast.unparse(node)}[::-1]"
            case ast.Call(keywords=[*kept, ast.keyword(arg=str(name))]) if name not in SILENT:
                yield "keyword dropped", node, ast.unparse(ast.Call(node.func, node.args, kept))


def _negated(test: ast.expr) -> str:
    return f"({ast.unparse(ast.UnaryOp(ast.Not(), test))})"


def _numbers(node: ast.AST) -> Iterator[Site]:
    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int(value)):
            yield "integer + 1", node, str(value + 1)
        case ast.Constant(value=float(value)) if value:
            yield "float x 1.1", node, repr(1.1 * value)


def _opposites(node: ast.AST) -> Iterator[Site]:
    operator = next((other for one, other in OPPOSITE.items() if isinstance(_operator(node), one)), None)
    if operator is None or (isinstance(node, ast.Compare) and len(node.ops) > 1):
        return
    text = ast.unparse(_with_operator(node, operator()))
    yield "opposite operator", node, text if isinstance(node, ast.stmt) else f"({text})"


def _executed(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a statement that are run, the outer before the inner: no docstring and no annotation."""
    yield node
    for name, field in ast.iter_fields(node):
        if name not in ("annotation", "returns"):
            for child in field if isinstance(field, list) else [field]:
                if isinstance(child, ast.AST):
                    yield from _executed(child)


def _names(node: ast.AST) -> list[str]:
    if isinstance(node, SEARCHED):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]


def _operator(node: ast.AST) -> ast.AST | None:
    return node.ops[0] if isinstance(node, ast.Compare) else getattr(node, "op", None)


def _with_operator(node: Any, operator: ast.AST) -> Any:
    fields = dict(ast.iter_fields(node))
    return type(node)(**fields | ({"ops": [operator]} if isinstance(node, ast.Compare) else {"op": operator}))


class _Filled(ast.NodeTransformer):
    """Puts what stood there, and its parts, in the place of their names."""

    def __init__(self, node: ast.expr) -> None:
        values = getattr(node, "values", [None, None])
        self.parts = {
            "it": node, "left": getattr(node, "left", values[0]), "right": getattr(node, "right", values[-1]),
            "yes": getattr(node, "body", None), "no": getattr(node, "orelse", None),
            "first": (getattr(node, "args", None) or [None])[0],
        }  # fmt: skip

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return self.parts.get(node.id) or node
