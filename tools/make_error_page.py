"""Write docs/reference/errors.md from the source: `python tools/make_error_page.py`.

Errors come from `fraclink.errors`, their exit codes from the command line's own guard,
the codes of findings from the calls that make them. A test writes the page again and
compares.
"""

from __future__ import annotations

import ast
import contextlib
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from fraclink import errors
from fraclink._cli.console import guarded
from fraclink._files import write_text

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src" / "fraclink"
PAGE = ROOT / "docs" / "reference" / "errors.md"
CODE = re.compile(r"W[1-6]\d\d")
FAMILIES = {
    "1": "the rig",
    "2": "the log",
    "3": "the identification",
    "4": "the design",
    "5": "law and simulation",
    "6": "the twin",
}
# One instance of every class: its message is shown, and the guard determines its exit
# code.
EXAMPLES: tuple[tuple[errors.FraclinkError, str], ...] = (
    (
        errors.FieldError(
            "payload", -0.03, "negative", allowed="> 0 kg", remedy="give the mass in kg"
        ),
        "`field`, `value`, `problem`, `allowed`, `remedy`: put the value into the allowed range",
    ),
    (
        errors.LogError(
            "output",
            "zero throughout",
            "without information",
            allowed="a log that moves",
            remedy="excite the arm",
        ),
        "as above; `diagnose` and the codes W2xx say what is wrong with the log",
    ),
    (
        errors.FileFormatError(
            "format",
            7,
            "a version this release does not read",
            allowed="1",
            remedy="make the file again with this release",
        ),
        "make the file again, or give the file of the kind that is named",
    ),
    (
        errors.SizeError(
            "runs", 10**12, "too many", allowed="<= 1000000000", remedy="ask for less"
        ),
        "ask for less; nothing was computed and no memory was allocated",
    ),
    (
        errors.InfeasibleError(
            "gain_crossover",
            "too fast for this phase margin",
            {"gain_crossover": 11.25},
        ),
        "`condition`, `explanation`, `nearest`: call again with `**error.nearest`, or give up a requirement",
    ),
    (
        errors.NotCertifiedError(
            "|1 + L| = 0.31 at 20 g", payload=0.020, frequency=14.2
        ),
        "`payload`, `frequency`: look there; ask for a smaller `modulus_margin` or a narrower range",
    ),
    (
        errors.NotConvergedError(
            "zeros of the approximation",
            reached=1e-3,
            wanted=1e-6,
            remedy="narrow the band or lower the order",
        ),
        "`reached`, `wanted`, `remedy`: the value reached may suffice",
    ),
    (
        errors.MissingExtraError("python-control", "control"),
        "install the extra that the message names",
    ),
)
# One call creates several findings and takes their words from a loop or a caller.
NAMED = {
    "W202": {
        "message": "the motor angle, or the torque or deflection, is constant or zero throughout",
        "remedy": "excite the arm: a pulse, a PRBS or a square wave / check the gauge and its amplifier",
    },
    "W501": {
        "message": "the arm settles later than the linear loop promises; noise and "
        "friction take the voltage beyond its limit; a guard of the law acts in some runs",
        "remedy": "keep a larger reserve, allow less voltage, filter more, or derive the law's limits for faster moves",
    },
}
NONE: Mapping[str, ast.expr] = {}
SEVERITIES = ("info", "warning", "error")


@dataclass(frozen=True)
class Code:
    """A code as one call in the source makes it."""

    code: str
    severity: str
    message: str
    remedy: str


def words(node: ast.expr | None, handed: Mapping[str, ast.expr] = NONE) -> str:
    """The text of an expression with … for what is known at run time only.

    `handed` are the arguments of the function that makes the text, by the names of its
    parameters.
    """
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    if isinstance(node, ast.JoinedStr):
        return "".join(words(part, handed) or "…" for part in node.values)
    if isinstance(node, ast.FormattedValue) and isinstance(node.value, ast.Name):
        return words(handed.get(node.value.id))
    if isinstance(node, ast.IfExp):
        return " / ".join(filter(None, (words(node.body), words(node.orelse))))
    if isinstance(node, ast.Call):  # a table of remedies with a default
        return words(node.args[-1]) if node.args else ""
    return ""


def severity(node: ast.expr | None) -> str:
    """The severities that an expression can have, mildest first."""
    found = (
        {n.value for n in ast.walk(node) if isinstance(n, ast.Constant)}
        if node
        else set()
    )
    return " or ".join(level for level in SEVERITIES if level in found) or "warning"


def templates(tree: ast.Module) -> dict[str, tuple[ast.Call, list[str]]]:
    """Functions that make a finding of a code that is handed to them: name to the call
    and the parameters.
    """
    found = {}
    for function in (
        node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)
    ):
        for call in (node for node in ast.walk(function) if isinstance(node, ast.Call)):
            if getattr(call.func, "id", "") == "Finding" and isinstance(
                argument(call, 0, "code"), ast.Name
            ):
                found[function.name] = call, [own.arg for own in function.args.args]
    return found


def unpacked(call: ast.Call, tree: ast.Module) -> list[ast.expr]:
    """Arguments by place, with the pieces of a tuple that stands as `*name`."""
    tuples = {
        target.id: node.value.elts
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    found: list[ast.expr] = []
    for own in call.args:
        starred = isinstance(own, ast.Starred) and isinstance(own.value, ast.Name)
        found += tuples[own.value.id] if starred else [own]
    return found


def argument(call: ast.Call, place: int, name: str) -> ast.expr | None:
    """An argument by place or by name."""
    if len(call.args) > place:
        return call.args[place]
    return next((word.value for word in call.keywords if word.arg == name), None)


def of_finding(
    code: str, call: ast.Call, handed: Mapping[str, ast.expr] = NONE
) -> Code:
    """What a call of Finding says; `handed` as in `words`."""
    return Code(
        code,
        severity(argument(call, 1, "severity")),
        words(argument(call, 2, "message"), handed),
        words(argument(call, 4, "remedy"), handed),
    )


def codes_of(path: Path) -> list[Code]:
    """Every code that a module makes."""
    tree = ast.parse(path.read_text("utf-8"))
    made = templates(tree)
    found = []
    for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
        name = getattr(call.func, "id", "")
        handed = [
            n.value
            for n in call.args
            if isinstance(n, ast.Constant) and isinstance(n.value, str)
        ]
        code = handed[0] if handed and CODE.fullmatch(handed[0]) else ""
        if code and name == "Finding":
            found.append(replace(of_finding(code, call), **NAMED.get(code, {})))
        elif code and name == "FraclinkWarning":
            found.append(Code(code, "warning", words(call.args[1]), ""))
        elif code and name in made:
            inside, parameters = made[name]
            given = dict(zip(parameters, unpacked(call, tree), strict=True))
            found.append(of_finding(code, inside, given))
    return found


def all_codes() -> list[Code]:
    """Every code of the package in order, calls that say the same once."""
    found = [code for path in sorted(SOURCE.rglob("*.py")) for code in codes_of(path)]
    return sorted(dict.fromkeys(found), key=lambda item: item.code)


def exit_code(error: errors.FraclinkError) -> int:
    """The exit code that the command line gives this error."""

    def fail() -> int:
        raise error

    with contextlib.redirect_stderr(io.StringIO()):
        return guarded(fail, as_json=False)


def cell(text: str) -> str:
    """Text that cannot end a table's cell."""
    return text.replace("|", "\\|")


def page() -> str:
    """The page."""
    lines = [
        "# Errors and codes",
        "",
        "*Written by `tools/make_error_page.py` from the source; a test compares.*",
        "",
        "Everything that fraclink raises on purpose is a `fraclink.errors.FraclinkError`. The base of each",
        "class is given in brackets; `except ValueError` works as well. On the command line the",
        "message is one line and the class decides the exit code; with `--json` its parts are the fields",
        "of `error`.",
        "",
        "| error | when | exit code | what to do |",
        "|---|---|---|---|",
    ]
    for error, remedy in EXAMPLES:
        kind = type(error)
        first = " ".join((kind.__doc__ or "").partition("\n\n")[0].split())
        bases = ", ".join(
            base.__name__ for base in kind.__bases__ if base is not errors.FraclinkError
        )
        lines.append(
            f"| `{kind.__name__}` ({bases}) | {cell(first)} | {exit_code(error)} | {cell(remedy)} |"
        )
    lines += ["", "What they look like:", "", "```text"]
    lines += [f"{type(error).__name__}: {error}" for error, _ in EXAMPLES]
    lines += [
        "```",
        "",
        "An `OSError` (no such file, disk full) is exit code 2, anything else is a defect of fraclink and",
        "exit code 70 ([exit codes](command-line.md#exit-codes)).",
        "",
        "## Codes of findings",
        "",
        "A finding does not stop the work. It is in `rig.warnings`, `log.findings`, `diagnose(log)`,",
        "`fit.findings`, `design.findings`, `twin.findings`, report and JSON, with its evidence",
        "in numbers. Codes keep their meaning across releases; … stands for what is known at run time.",
        "*info* is good to know, *warning* may mislead, *error* is a gate: nothing made from it can pass.",
    ]
    found = all_codes()
    for family, what in FAMILIES.items():
        rows = [code for code in found if code.code[1] == family]
        lines += ["", f"### W{family}xx: {what}", ""]
        if not rows:
            lines.append(
                "None yet: what a law refuses is an error or a flag of `law.h` ([the law](law.md))."
            )
            continue
        lines += ["| code | severity | what | what to do |", "|---|---|---|---|"]
        lines += [
            f"| **{row.code}** | {row.severity} | {cell(row.message)} | {cell(row.remedy)} |"
            for row in rows
        ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    write_text(PAGE, page())
    print(PAGE.relative_to(ROOT))
