"""law.c as statements: a parser for the subset of C in which the law is written,
applied to its preprocessed text.

Conditions, assignments, calls and returns; loops are recognised but not parsed.
Anything else in a function raises `Unreadable`: a proof about a partly understood text
would be worthless.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Function", "Node", "Source", "Unreadable", "read_source"]

Node = tuple[object, ...]  # (kind, parts...): an expression or a statement

_TOKENS = re.compile(
    r"\s*(?:(?P<number>0[xX][0-9a-fA-F]+[uU]?|(?:\d+\.?\d*(?:[eE][-+]?\d+)?)[fFuU]?)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign>->|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/|&^]=|\+\+|[-+*/%&|^<>=!~?:;,.(){}\[\]]))"
)
_FUNCTION = re.compile(r"(?:static )?(void|uint32_t|law_real) (\w+)\(([^()]*)\)\s*\{")
_MEMBER = re.compile(r"^\s*(law_real|uint32_t) (\w+)(?:\[[^\]]*\])?;", re.MULTILINE)
# C's precedence, loosest first; all of them associate to the left.
_LEVELS = (
    ("||",),
    ("&&",),
    ("|",),
    ("^",),
    ("&",),
    ("==", "!="),
    ("<", ">", "<=", ">="),
    ("<<", ">>"),
    ("+", "-"),
    ("*", "/"),
)
_ASSIGNMENTS = ("=", "+=", "-=", "*=", "|=", "&=", "^=")
_TYPES = ("law_real", "uint32_t")


class Unreadable(Exception):
    """The text has something that this reader does not know."""


@dataclass(frozen=True)
class Function:
    """One function: its result's type, parameters as (type, is pointer, name), and its
    text.
    """

    name: str
    result: str
    parameters: tuple[tuple[str, bool, str], ...]
    text: str

    @property
    def loops(self) -> bool:
        """Whether the text has a loop."""
        return re.search(r"\b(for|while|do)\b", self.text) is not None

    @property
    def pure(self) -> bool:
        """Whether it works on numbers alone."""
        return not any(pointer for _, pointer, _ in self.parameters)

    def body(self) -> tuple[Node, ...]:
        """Return the statements; Unreadable where there are others than this reader
        knows.
        """
        return _Reader(_tokens(self.text)).block()


@dataclass(frozen=True)
class Source:
    """Every function of a file, and the type of every member of its structs."""

    functions: dict[str, Function]
    members: dict[str, str]

    def effects(self, name: str) -> frozenset[tuple[str, str]]:
        """Return what a call may change through pointers to structs: pairs (struct,
        member).
        """
        return self._effects(name, ())

    def _effects(self, name: str, above: tuple[str, ...]) -> frozenset[tuple[str, str]]:
        # Recursion: its effects would depend on themselves, without an end.
        if name in above:
            raise Unreadable(f"{name} calls itself")
        function = self.functions[name]
        changed: set[tuple[str, str]] = set()
        for kind, pointer, parameter in function.parameters:
            if pointer:
                # Found in the text instead of by parsing: functions with loops, which
                # are not parsed, also have effects.
                assigned = rf"\b{parameter}->(\w+)(?:\[[^\]]*\])?\s*(?:[-+*|&^/]?=(?!=)|\+\+|--)"
                # an address passed on may be written through
                for member in re.findall(
                    rf"{assigned}|&{parameter}->(\w+)", function.text
                ):
                    changed.update((kind, found) for found in member if found)
        for called in (
            set(re.findall(r"\b(\w+)\(", function.text)) & self.functions.keys()
        ):
            changed |= self._effects(called, (*above, name))
        return frozenset(changed)


def read_source(text: str) -> Source:
    """Return the functions of preprocessed C `text`."""
    text = re.sub(
        r"^#.*$",
        "",
        re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL),
        flags=re.MULTILINE,
    )
    functions = {}
    for found in _FUNCTION.finditer(text):
        result, name, listed = found.groups()
        end = _closing(text, found.end() - 1)
        functions[name] = Function(
            name, result, _parameters(listed), text[found.end() : end]
        )
    members: dict[str, str] = {}
    for struct in re.findall(r"typedef struct\s*\{(.*?)\}", text, flags=re.DOTALL):
        for kind, member in _MEMBER.findall(struct):
            # A type is looked up by the name of the member alone: two structs may have
            # the same member, but only with the same type.
            if members.setdefault(member, kind) != kind:
                raise Unreadable(f"{member} has two types")
    return Source(functions, members)


def _closing(text: str, place: int) -> int:
    depth = 0
    for end in range(place, len(text)):
        depth += {"{": 1, "}": -1}.get(text[end], 0)
        if depth == 0:
            return end
    raise Unreadable("a function does not end")


def _parameters(listed: str) -> tuple[tuple[str, bool, str], ...]:
    found = []
    for item in listed.split(","):
        words = item.replace("*", " * ").replace("const", " ").split()
        if words and words != ["void"]:
            found.append((words[0], "*" in words, words[-1]))
    return tuple(found)


def _tokens(text: str) -> list[str]:
    tokens, place, text = [], 0, text.rstrip()
    while place < len(text):
        found = _TOKENS.match(text, place)
        if found is None:
            raise Unreadable(f"{text[place : place + 20]!r}")
        tokens.append(found.group().strip())
        place = found.end()
    return tokens


class _Reader:
    """Recursive descent over the tokens of one function."""

    def __init__(self, tokens: list[str]) -> None:
        self.tokens, self.place = [*tokens, "}"], 0

    def peek(self, ahead: int = 0) -> str:
        place = self.place + ahead
        return self.tokens[place] if place < len(self.tokens) else ""

    def take(self, wanted: str | None = None) -> str:
        word = self.peek()
        if not word or (wanted is not None and word != wanted):
            raise Unreadable(f"{word!r} where {wanted or 'more'!r} was expected")
        self.place += 1
        return word

    def block(self) -> tuple[Node, ...]:
        statements: list[Node] = []
        while self.peek() != "}":
            statements += self.statement()
        self.take("}")
        return tuple(statements)

    def statement(self) -> list[Node]:
        word = self.peek()
        if word == ";":
            self.take()
            return []
        if word == "{":
            self.take()
            return list(self.block())
        if word == "if":
            return [self.condition()]
        if word == "return":
            self.take()
            value = self.expression()
            self.take(";")
            return [("return", value)]
        if word == "const" or (word in _TYPES and self.peek(1) != "("):
            return self.declaration()
        return [self.assignment()]

    def condition(self) -> Node:
        self.take("if")
        self.take("(")
        test = self.expression()
        self.take(")")
        yes = tuple(self.statement())
        no: tuple[Node, ...] = ()
        if self.peek() == "else":
            self.take()
            no = tuple(self.statement())
        return ("if", test, yes, no)

    def declaration(self) -> list[Node]:
        if self.peek() == "const":
            self.take()
        kind = self.take()
        if kind not in _TYPES:
            raise Unreadable(f"a variable of type {kind!r}")
        name = self.take()
        value = None
        if self.peek() == "=":
            self.take()
            value = self.expression()
        self.take(";")
        return [("declare", kind, name, value)]

    def assignment(self) -> Node:
        # (void)f(x): a value dropped on purpose.
        if self.peek() == "(" and self.peek(1) == "void":
            self.place += 3
        target = self.unary()
        if target[0] == "call" and self.peek() == ";":
            self.take()
            return ("do", target)
        sign = self.take()
        # An element of an array is not a target: its index would have to be tracked,
        # and no proof needs it.
        if sign not in _ASSIGNMENTS or target[0] not in ("name", "member", "at"):
            raise Unreadable(f"{sign!r} after {target[0]!r}")
        value = self.expression()
        self.take(";")
        # a += b is a = a + b: no target here has an effect that would then occur twice.
        return (
            "set",
            target,
            value if sign == "=" else ("binary", sign[:-1], target, value),
        )

    def expression(self) -> Node:
        test = self.binary(0)
        if self.peek() != "?":
            return test
        self.take()
        yes = self.expression()
        self.take(":")
        return ("choice", test, yes, self.expression())

    def binary(self, level: int) -> Node:
        lower: Callable[[], Node] = (
            (lambda: self.binary(level + 1)) if level + 1 < len(_LEVELS) else self.unary
        )
        left = lower()
        while self.peek() in _LEVELS[level]:
            sign = self.take()
            left = ("binary", sign, left, lower())
        return left

    def unary(self) -> Node:
        word = self.peek()
        if word in ("-", "*", "&"):
            self.take()
            return ({"-": "minus", "*": "at", "&": "address"}[word], self.unary())
        if word == "(" and self.peek(1) in _TYPES:
            self.take()
            kind = self.take()
            self.take(")")
            return ("cast", kind, self.unary())
        return self.postfix()

    def postfix(self) -> Node:
        word = self.take()
        if word == "(":
            inside = self.expression()
            self.take(")")
            return inside
        if word[0].isdigit():
            return ("number", word)
        if not (word[0].isalpha() or word[0] == "_"):
            raise Unreadable(f"{word!r} in an expression")
        if self.peek() == "(":
            return ("call", word, self.arguments())
        if self.peek() == "->":
            self.take()
            return self.element(("member", word, self.take()))
        return self.element(("name", word))

    def element(self, node: Node) -> Node:
        if self.peek() != "[":
            return node
        self.take()
        index = self.expression()
        self.take("]")
        return ("element", node, index)

    def arguments(self) -> tuple[Node, ...]:
        self.take("(")
        found: list[Node] = []
        while self.peek() != ")":
            found.append(self.expression())
            if self.peek() == ",":
                self.take()
        self.take(")")
        return tuple(found)
