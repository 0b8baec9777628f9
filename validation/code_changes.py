"""Small changes of code, told by function and by what the syntax has there, so that no source text is quoted.

A change is `WHAT -> INTO` of the nth such node in a function, in the order of the source. WHAT is an operator (`+`,
`<=`, `and`, `-x` for a sign), a name, an attribute by its last name (`.sigma`), a constant, or the kind of a larger
expression: `call NAME`, `if`, `[]`, `()`, `+ ...` for a whole term with that operator. INTO is an operator, or an
expression in which `it` is what stood there, and `left`, `right`, `first`, `yes`, `no` are its operands, its first
argument and the two sides of an `if`.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

OPERATORS: dict[str, type[ast.AST]] = {
    "+": ast.Add, "-": ast.Sub, "*": ast.Mult, "/": ast.Div, "//": ast.FloorDiv, "%": ast.Mod, "**": ast.Pow,
    "@": ast.MatMult, "&": ast.BitAnd, "|": ast.BitOr, "<": ast.Lt, "<=": ast.LtE, ">": ast.Gt, ">=": ast.GtE,
    "==": ast.Eq, "!=": ast.NotEq, "and": ast.And, "or": ast.Or, "-x": ast.USub, "not": ast.Not,
}  # fmt: skip
KINDS: dict[str, type[ast.AST]] = {"if": ast.IfExp, "[]": ast.Subscript, "()": ast.Tuple}
SEARCHED = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


class StaleChangeError(Exception):
    """A change that does not fit the code any more."""


@dataclass(frozen=True)
class Change:
    """`what -> into`, of the nth such node."""

    what: str
    into: str
    nth: int

    @classmethod
    def read(cls, text: str) -> Change:
        """From `WHAT -> INTO` or `WHAT #NTH -> INTO`."""
        what, _, into = text.partition(" -> ")
        what, _, nth = what.partition(" #")
        return cls(what, into, int(nth or 1))

    def of(self, function: ast.AST) -> tuple[ast.expr, str]:
        """The expression that it changes, and what takes its place."""
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


def _names(node: ast.AST) -> list[str]:
    if isinstance(node, SEARCHED):
        return [node.name]
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]


def _operator(node: ast.expr) -> ast.AST | None:
    return node.ops[0] if isinstance(node, ast.Compare) else getattr(node, "op", None)


def _with_operator(node: ast.expr, operator: ast.AST) -> ast.expr:
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
