"""A structure as text: "k*s**a/(s**b + w)*exp(-T*s)", read without executing any of it
as Python.

The text is parsed, every node is compared with the few kinds that a fractional transfer
function consists of, and the tree is evaluated in two algebras: arrays of complex
numbers (many parameter vectors at once) and exact transfer functions.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from fraclink.errors import FieldError
from fracsys._fractional import FractionalTransferFunction, s
from fracsys.checks import Complex

Role = Literal["order", "delay", "coefficient"]

_DEEPEST = 60  # nesting depth, since the evaluation below is recursive
_FORMS = "numbers, names, s, + - * / **, and exp(-T*s)"
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


@dataclass(frozen=True)
class Expression:
    """A transfer function of s and named parameters, as a tree.

    `roles` has the role of each parameter, in the order of the text: an "order" is in an
    exponent of s, a "delay" in exp(-T*s), a "coefficient" elsewhere. A parameter with
    several roles has the narrowest of them.
    """

    text: str
    roles: Mapping[str, Role]
    tree: ast.expr

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters in the order of the text."""
        return tuple(self.roles)

    @np.errstate(all="ignore")
    def response(self, values: Mapping[str, Any], points: Complex) -> Complex:
        """G at `points` [rad/s], shape (K,), for parameters of shape () or (M, 1)."""

        def power(_: Complex, order: Any) -> Complex:
            # Of many candidates few differ in this order: each power is computed once.
            orders, row = np.unique(order, return_inverse=True)
            # The principal branch: s^a is then the same function at every point, with
            # its cut along the negative real axis.
            rows = np.exp(orders[:, None] * np.log(points))
            return rows[row.reshape(np.shape(order)[:-1])]

        arrays = {name: np.asarray(value, np.float64) for name, value in values.items()}
        # a candidate may overflow: its cost is infinite, and it is dropped
        return _value(self.tree, _Leaves(self.text, points, power, np.exp, arrays))

    def function(self, values: Mapping[str, float]) -> FractionalTransferFunction:
        """The exact transfer function; FieldError if there is none for these values (a
        negative delay).
        """
        exact = {name: float(value) for name, value in values.items()}
        result = _value(self.tree, _Leaves(self.text, s, operator.pow, _delayed, exact))
        return (
            result
            if isinstance(result, FractionalTransferFunction)
            else float(result) * s**0
        )


@dataclass(frozen=True)
class _Leaves:
    """The values of s, s**a, exp and the parameters of a text in one algebra."""

    text: str
    variable: Any
    power: Callable[[Any, Any], Any]
    exponential: Callable[[Any], Any]
    values: Mapping[str, Any]


def _value(node: ast.expr, leaves: _Leaves, depth: int = 0) -> Any:
    """The value of a tree; FieldError names the piece that has none, or that belongs
    to no transfer function.
    """
    if depth > _DEEPEST:
        raise _refused(
            leaves.text,
            node,
            "nested too deeply",
            "write it with fewer brackets and terms",
        )
    if isinstance(node, ast.Name) and node.id not in ("exp", "offset"):
        return leaves.variable if node.id == "s" else leaves.values[node.id]
    # Room for a product: with 1e308 the first multiplication would overflow.
    if isinstance(node, ast.Constant) and (
        type(node.value) in (int, float) and abs(node.value) < 1e300  # type: ignore[arg-type]
    ):
        return float(node.value)  # type: ignore[arg-type]
    operation = _operation(node, leaves)
    if operation is None:
        raise _refused(
            leaves.text, node, "a piece that is not known", "write it with these alone"
        )
    values = [_value(operand, leaves, depth + 1) for operand in _operands(node)]
    try:
        result = operation(*values)
        # Python, unlike numpy, returns a complex power of a negative base.
        if type(result) is complex:
            raise ArithmeticError
    except (ArithmeticError, FieldError, TypeError) as error:
        raise _refused(leaves.text, node, *_cause(node, error)) from error
    return result


def _operation(node: ast.expr, leaves: _Leaves) -> Callable[..., Any] | None:
    """The operation of a node on its operands; None if no transfer function has it."""
    if isinstance(node, ast.Call):
        known = ast.unparse(node.func) == "exp" and len(node.args) == 1
        return leaves.exponential if known and not node.keywords else None
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        of_s = isinstance(node.left, ast.Name) and node.left.id == "s"
        return leaves.power if of_s else operator.pow
    return _OPERATORS.get(type(getattr(node, "op", None)))


def _cause(node: ast.expr, error: Exception) -> tuple[str, str]:
    """Why a piece has no value, and the remedy."""
    if isinstance(node, ast.Call):
        return "not a delay", "write it as exp(-T*s)"
    if isinstance(error, TypeError):
        return "s in an exponent", "a delay is exp(-T*s)"
    if isinstance(error, ZeroDivisionError) or (
        isinstance(error, FieldError) and error.field == "denominator"
    ):
        return "a division by zero", "divide by another number"
    if isinstance(error, FieldError):
        return error.problem, error.remedy
    return (
        "no finite real number",
        "write numbers and powers whose value is real and finite",
    )


def _delayed(exponent: FractionalTransferFunction) -> FractionalTransferFunction:
    """e^(−τs) for the exponent −τs."""
    slope = exponent / s
    orders = {term.order for term in (*slope.numerator, *slope.denominator)}
    if slope.delay or orders - {0.0}:
        raise TypeError("not proportional to s")
    return (s**0).delayed(-sum(term.coefficient for term in slope.numerator))


# --- parsing ------------------------------------------------------------------------------------------------


def parse_expression(text: str) -> Expression:
    """Return the structure described by `text`; FieldError names the first part without
    a meaning here.

    >>> parse_expression("k*s**a/(s**a + w)*exp(-T*s)").roles["a"]
    'order'
    >>> try:
    ...     parse_expression("1/sin(s)")
    ... except FieldError as error:
    ...     error.value, error.problem
    ('sin(s)', 'a piece that is not known')
    """
    if not isinstance(text, str) or not text.strip():
        raise FieldError(
            "expression",
            text,
            "not a formula",
            "a text",
            'write it as in "k/(T*s**a + 1)"',
        )
    text = " ".join(text.split())
    try:
        # Parsed as Python but never executed: `_value` compares every node with the few
        # kinds that a transfer function consists of, and rejects any other by name.
        tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        where = (
            f" at character {error.offset}"
            if isinstance(error, SyntaxError) and error.offset
            else ""
        )
        raise FieldError(
            "expression",
            text,
            f"not a formula{where}",
            _FORMS,
            "check brackets and operators; a product needs its *",
        ) from error
    # A number is a transfer function too, but a text without s is nearly always a
    # mistake.
    if not _has_s(tree):
        raise _refused(
            text,
            tree,
            "without s",
            "write the transfer function, such as k/(T*s**a + 1)",
        )
    expression = Expression(text, _roles(tree), tree)
    # Compared at values of which no two are equal and no sum is zero: a piece without a
    # value there belongs to no transfer function. The power of an array is its
    # principal value, which differs from s^(ab) for (s^a)^b with an order a above 2.
    first = {"order": 2.1, "delay": 0.1, "coefficient": 0.1}
    values = {
        name: first[role] + 0.0137 * k
        for k, (name, role) in enumerate(expression.roles.items())
    }
    point = np.array([0.01 + 0.83j])
    if not np.allclose(
        expression.response(values, point), expression.function(values)(point)
    ):
        raise _refused(
            text, tree, "a power of a power of s", "write (s**a)**b as s**(a*b)"
        )
    return expression


def _operands(node: ast.expr) -> list[ast.expr]:
    inner = node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node)
    return [child for child in inner if isinstance(child, ast.expr)]


def _names(tree: ast.expr) -> list[str]:
    """Names in the order of the text, except exp."""
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.Name))
    ordered = sorted(nodes, key=lambda node: (node.lineno, node.col_offset))
    return list(dict.fromkeys(node.id for node in ordered if node.id != "exp"))


def _has_s(node: ast.expr) -> bool:
    return "s" in _names(node)


def _refused(text: str, node: ast.expr, problem: str, remedy: str) -> FieldError:
    return FieldError(
        "expression", ast.get_source_segment(text, node), problem, _FORMS, remedy
    )


def _roles(tree: ast.expr) -> dict[str, Role]:
    orders: set[str] = set()
    delays: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            delays.update(*map(_names, node.args))
        elif (
            isinstance(node, ast.BinOp)
            and isinstance(node.op, ast.Pow)
            and _has_s(node.left)
        ):
            orders.update(_names(node.right))
    # The range of an order is the narrowest: a parameter that occurs in an exponent and
    # elsewhere gets that range.
    return {
        name: "order"
        if name in orders
        else "delay"
        if name in delays
        else "coefficient"
        for name in _names(tree)
        if name != "s"
    }
