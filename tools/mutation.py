"""Mutants of Python sources: the places for small changes, and the tests that run each
place.

A mutant is one change of one node of a module's syntax tree. Docstrings, annotations,
decorators, assertions, f-strings and the contents of `raise` are left unchanged: they
are text for people or for the type checker.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType
from typing import Any

# the builtin in which an instrumented module records the blocks that were run
HITS = "__fraclink_hits__"
REMOVED = "removed statement"
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_BODIES = ("body", "orelse", "finalbody")

# Commutative in the first two arguments: swapping them is no change.
_SYMMETRIC = {
    "min", "max", "minimum", "maximum", "hypot", "gcd", "isclose", "allclose", "array_equal", "isinstance",
    "logical_and", "logical_or", "multiply", "add", "zip",
}  # fmt: skip
# Keywords that affect no result: `strict` of zip only rejects lengths that differ
# because of a defect elsewhere.
_NO_RESULT = {"stacklevel", "maxsize", "indent", "strict"}

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,), ast.NotIn: (ast.In,),
}  # fmt: skip
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Div, ast.Mod: ast.FloorDiv, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
    ast.LShift: ast.RShift, ast.RShift: ast.LShift,
}  # fmt: skip


@dataclass
class Site:
    """One change that can be made: `apply` makes it, in the tree in which it was found."""

    kind: str
    node: ast.AST
    apply: Callable[[], Any]
    line: int
    # the block of statements that contains it; None for code run at import
    block: int | None
    # qualified name of the outermost function that contains it; "" at import
    function: str
    names: frozenset[str]  # names by which other modules refer to a change at import


# --- blocks: runs of statements of which either all run or none, but for exceptions ---------------------


def number_blocks(tree: ast.Module, first: int) -> int:
    """Give every statement inside a function the number of its block; returns the next
    free number.
    """
    counter = [first]

    def visit(body: list[ast.stmt], inside: bool) -> None:
        block = None
        for statement in body:
            if inside and block is None:
                block, counter[0] = counter[0], counter[0] + 1
            statement.block = block  # type: ignore[attr-defined]
            inner = list(_bodies(statement))
            for part in inner:
                visit(part, inside or isinstance(statement, FUNCTIONS))
            if inner and not isinstance(statement, (*FUNCTIONS, ast.ClassDef)):
                # a branch may have left: the following statements are counted
                # separately
                block = None

    visit(tree.body, False)
    return counter[0]


def _bodies(statement: ast.stmt) -> Iterator[list[ast.stmt]]:
    for name in _BODIES:
        part = getattr(statement, name, None)
        if isinstance(part, list) and part:
            yield part
    for branch in (
        *getattr(statement, "handlers", ()),
        *getattr(statement, "cases", ()),
    ):
        yield branch.body


def instrumented(path: Path, first: int) -> tuple[CodeType, int]:
    """The module's code with a note at the head of every block, and the next free
    number.
    """
    tree = ast.parse(path.read_bytes())
    after = number_blocks(tree, first)
    for node in ast.walk(tree):
        for name in _BODIES:
            body = getattr(node, name, None)
            if isinstance(body, list):
                setattr(node, name, _with_notes(body))
    return compile(ast.fix_missing_locations(tree), str(path), "exec"), after


def _with_notes(body: list[ast.stmt]) -> list[ast.stmt]:
    result: list[ast.stmt] = []
    before = None
    for k, statement in enumerate(body):
        block = getattr(statement, "block", None)
        text = isinstance(statement, ast.Expr) and isinstance(
            statement.value, ast.Constant
        )
        if block is not None and block != before and not (k == 0 and text):
            result.append(
                ast.copy_location(ast.parse(f"{HITS}[{block}] = 1").body[0], statement)
            )
            before = block
        result.append(statement)
    return result


def _text(node: ast.expr) -> bool:
    """Whether an expression is text, literal or formatted."""
    words = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return words or isinstance(node, ast.JoinedStr)


# --- where a change can be made -----------------------------------------------------------------------


@dataclass
class Finder(ast.NodeVisitor):
    """Collects the sites of one tree whose blocks are numbered."""

    sites: list[Site] = field(default_factory=list)
    block: int | None = None
    scope: tuple[str, ...] = ()
    function: str = ""
    names: frozenset[str] = frozenset()

    def _add(
        self,
        kind: str,
        node: ast.AST,
        apply: Callable[[], Any],
        line: int | None = None,
    ) -> None:
        at = line if line is not None else getattr(node, "lineno", 0)
        self.sites.append(
            Site(kind, node, apply, at, self.block, self.function, self.names)
        )

    def _set(
        self, kind: str, node: Any, name: str, value: object, holder: Any = None
    ) -> None:
        """A site that sets an attribute of the node (or of `holder`, a part of it)."""
        self._add(kind, node, lambda: setattr(holder or node, name, value))

    # statements

    def visit(self, node: ast.AST) -> None:
        if not isinstance(node, ast.stmt):
            return super().visit(node)
        kept = self.block, self.names
        self.block = getattr(node, "block", None)
        if not self.scope:
            self.names = frozenset()
        if self.block is None:
            self.names |= {
                t.id
                for target in (
                    *getattr(node, "targets", ()),
                    getattr(node, "target", None),
                )
                for t in ast.walk(target or ast.Pass())
                if isinstance(t, ast.Name)
            }
        super().visit(node)
        self.block, self.names = kept
        return None

    def _statements(self, node: Any) -> None:
        """The bodies of a compound statement, from which each statement may also be
        removed.
        """
        for body in _bodies(node):
            for k, statement in enumerate(body):
                if self._removable(statement):
                    kept, self.block = self.block, getattr(statement, "block", None)
                    self._add(
                        REMOVED,
                        statement,
                        lambda b=body, k=k: b.__setitem__(k, ast.Pass()),
                    )
                    self.block = kept
                self.visit(statement)

    def _removable(self, statement: ast.stmt) -> bool:
        if not self.function:
            return False
        if isinstance(statement, ast.Assign):
            return not isinstance(statement.targets[0], (ast.Name, ast.Tuple))
        if isinstance(statement, ast.Expr):
            return isinstance(statement.value, (ast.Call, ast.Await))
        if isinstance(statement, ast.Raise) and statement.exc is not None:
            # like `assert`, it states what cannot happen
            return "AssertionError" not in ast.unparse(statement.exc)
        return isinstance(
            statement, (ast.Raise, ast.AugAssign, ast.Continue, ast.Break)
        )

    def visit_Module(self, node: ast.Module) -> None:
        self._statements(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        kept = self.scope, self.names
        self.scope, self.names = (*self.scope, node.name), self.names | {node.name}
        self._statements(node)
        self.scope, self.names = kept

    def visit_FunctionDef(self, node: Any) -> None:
        if node.name == "__repr__":
            return
        kept = self.scope, self.function, self.names
        if not self.function:
            self.names = frozenset({*self.scope, node.name})
        for default in (
            *node.args.defaults,
            *(d for d in node.args.kw_defaults if d is not None),
        ):
            self.visit(default)
        self.scope = (*self.scope, node.name)
        self.function = self.function or ".".join(self.scope)
        self._statements(node)
        self.scope, self.function, self.names = kept

    visit_AsyncFunctionDef = visit_FunctionDef

    def visit_Raise(self, node: ast.Raise) -> None:
        """What is said in an error is text."""

    visit_Assert = visit_Raise  # type: ignore[assignment]

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_If(self, node: Any) -> None:
        text = ast.unparse(node.test)
        if "TYPE_CHECKING" in text or "__name__" in text:
            return
        self._condition(node)
        self.visit(node.test)
        self._statements(node)

    visit_While = visit_If

    def visit_For(self, node: Any) -> None:
        self.visit(node.iter)
        self._statements(node)

    visit_AsyncFor = visit_For

    def visit_With(self, node: Any) -> None:
        for item in node.items:
            self.visit(item.context_expr)
        self._statements(node)

    visit_AsyncWith = visit_With
    visit_Try = _statements

    def visit_Match(self, node: ast.Match) -> None:
        self.visit(node.subject)
        self._statements(node)

    def visit_Return(self, node: ast.Return) -> None:
        if node.value is not None and not isinstance(node.value, ast.Constant):
            self._set(REMOVED, node, "value", ast.Constant(None))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self._arithmetic(node, node.value)
        self.visit(node.value)

    # expressions

    def _condition(self, node: Any) -> None:
        if not isinstance(node.test, (ast.Compare, ast.Constant)):
            self._set("boolean", node, "test", ast.UnaryOp(ast.Not(), node.test))

    def visit_IfExp(self, node: ast.IfExp) -> None:
        if not (_text(node.body) and _text(node.orelse)):
            self._condition(node)
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for k, operator in enumerate(node.ops):
            for other in _COMPARISONS[type(operator)]:
                self._add(
                    "comparison",
                    node,
                    lambda k=k, o=other: node.ops.__setitem__(k, o()),
                )
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        if isinstance(node.op, ast.MatMult):
            left, right = node.left, node.right
            self._add(
                "swapped", node, lambda: node.__dict__.update(left=right, right=left)
            )
        else:
            self._arithmetic(node, node.left, node.right)
        self.generic_visit(node)

    def _arithmetic(self, node: Any, *operands: ast.expr) -> None:
        text = any(
            isinstance(o, (ast.JoinedStr, ast.List, ast.Tuple))
            or (isinstance(o, ast.Constant) and isinstance(o.value, (str, bytes)))
            for o in operands
        )
        kind = _ARITHMETIC.get(type(node.op))
        # At import a | b joins types.
        if (
            kind is None
            or text
            or (isinstance(node.op, ast.BitOr) and self.block is None)
        ):
            return
        self._set("arithmetic", node, "op", kind())

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        self._set(
            "boolean",
            node,
            "op",
            ast.Or() if isinstance(node.op, ast.And) else ast.And(),
        )
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not):
            self._set("boolean", node, "operand", ast.UnaryOp(ast.Not(), node.operand))
        elif isinstance(node.op, ast.USub):
            self._set("arithmetic", node, "op", ast.UAdd())
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = (
            node.func.attr
            if isinstance(node.func, ast.Attribute)
            else getattr(node.func, "id", "")
        )
        if (
            len(node.args) >= 2
            and name not in _SYMMETRIC
            and name not in ("TypeVar", "NewType", "cast")
        ):
            a, b = node.args[:2]
            plain = not isinstance(a, ast.Starred) and not isinstance(b, ast.Starred)
            if plain and ast.dump(a) != ast.dump(b) and not (_text(a) and _text(b)):
                self._add(
                    "swapped", node, lambda: node.args.__setitem__(slice(0, 2), [b, a])
                )
        self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        if node.arg not in _NO_RESULT:
            self.visit(node.value)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """What a message says is text, and so are the values that it names."""

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self._set("constant", node, "value", not value)
        elif isinstance(value, int):
            self._set("constant", node, "value", value + 1)
            self._set("constant", node, "value", value - 1)
        elif isinstance(value, float):
            near = value + 1.0 if abs(value) < 100.0 else 10.0 * value
            self._set("constant", node, "value", near)
            self._set("constant", node, "value", 2.0 * value if value else -1.0)
        elif isinstance(value, complex):
            self._set("constant", node, "value", -value)


def sites(path: Path, first: int = 0) -> tuple[ast.Module, list[Site]]:
    """The module's tree and its sites, always in the same order."""
    tree = ast.parse(path.read_bytes())
    number_blocks(tree, first)
    finder = Finder()
    finder.visit(tree)
    return tree, finder.sites


def mutated(path: Path, index: int, first: int = 0) -> tuple[CodeType, Site, str]:
    """The module's code with the change `index` made, its site, and the change in
    words.
    """
    tree, found = sites(path, first)
    site = found[index]
    before = ast.unparse(site.node).splitlines()[0]
    site.apply()
    after = (
        "pass"
        if site.kind == REMOVED
        else ast.unparse(ast.fix_missing_locations(site.node))
    )
    if isinstance(site.node, ast.Return):
        after = "return None"
    code = compile(ast.fix_missing_locations(tree), str(path), "exec")
    return code, site, f"{before[:90]}  ->  {after.splitlines()[0][:90]}"
