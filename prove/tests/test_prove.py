"""`export_c(..., prove=True)`: what is proved holds, what is seeded is refuted, what is
missing is named.
"""

from __future__ import annotations

import json
import operator
import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import fraclink as fl
from fraclink._certify import certify
from fraclink._cli import main
from fraclink._design.completed import design_for
from fraclink._export import Proof, export_c
from fraclink._files import sha256_of
from fraclink._law import Law
from fraclink_prove import (
    eva,
    formulas,
    loop_claim,
    rounding,
    source,
    step,
    symbolic,
    tools,
)
from fraclink_prove.norms import worst_gain
from law_bench import law, with_pair
from law_bench import run as run_law
from needed_tools import tool
from test_export import run

SEEDED = (
    # (claim, text of law.c, what a slip would make of it)
    ("slew", "clamped(change, p->motor_step)", "change"),
    (
        "slew",
        "s->motor_reference = clamped(wanted, p->motor_limit);",
        "s->motor_reference = wanted + before;",
    ),
    (
        "outputs",
        "const law_real voltage = clamped(wanted, p->voltage_limit);",
        "const law_real voltage = wanted;",
    ),
    ("finite", "s->torque = clamped(s->torque, p->torque_limit);", ""),
)


def claim_of(name: str, folder: Path) -> step.Claim:
    made = law("single")
    if name == "outputs":
        return eva.commands_claim(made, folder)
    return {"slew": step.slew_claim, "finite": step.finite_claim}[name](made, folder)


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("design") / "design.json"
    design, _ = design_for(fl.Rig.named("paper-2023"))
    design.save(path)
    return path


@pytest.fixture(scope="module")
def proved(design: Path) -> Path:
    """A folder made by the command line, with every tool there."""
    for program in (tools.FRAMA_C, tools.SOLVERS[0], tools.GAPPA):
        tool(program.program, program.package)
    folder = design.parent / "firmware"
    code = main(["export", "c", str(design), "--out", str(folder), "--prove"])
    assert code == 0, Proof.load(folder / "proof.json")
    return folder


def test_everything_is_proved_and_the_page_says_so(proved: Path) -> None:
    proof = Proof.load(proved / "proof.json")
    assert proof.passed, str(proof)
    assert {claim.name for claim in proof.claims} == {
        "outputs",
        "finite",
        "slew",
        "rounding",
        "loop",
    }
    assert proof.law == Law.load(proved / "law.json").digest
    assert proof.sources == {
        name: sha256_of(proved / name) for name in ("law.h", "law.c", "law_data.h")
    }
    page = re.sub(r"\s+", " ", (proved / "README.md").read_text(encoding="utf-8"))
    assert "Not proved" not in page
    assert page.count("rad, all times") == 0  # the bound of the proof alone
    for claim in proof.claims:
        assert claim.statement in page
        assert claim.logs
        for file, digest in claim.logs:
            assert sha256_of(proved / file) == digest
            assert f"`{file}` {digest[:12]}" in page


def test_the_logs_tell_no_path_and_no_time(proved: Path) -> None:
    """The same files and tools give the same logs, so that their hashes can be
    compared.
    """
    for path in (proved / "proof").iterdir():
        text = path.read_text(encoding="utf-8")
        assert str(proved.parent) not in text
        assert re.search(r"\d\d:\d\d|/home|tmp", text) is None


def test_eva_bounds_the_commands_by_their_limits(proved: Path) -> None:
    limits = Law.load(proved / "law.json").limits
    for build in ("general", "exact"):
        text = (proved / "proof" / f"eva_{build}.log").read_text(encoding="utf-8")
        for output, bound in (
            ("motor_reference", limits.motor_limit),
            ("voltage", 10.0),
        ):
            found = re.search(
                rf"\.{output} ∈ \[(-?[\d.]+) \.\. (-?[\d.]+)\] or UNINIT", text
            )
            assert found is not None
            assert [float(x.rstrip(".")) for x in found.groups()] == pytest.approx(
                [-bound, bound], rel=1e-6
            )


@pytest.mark.parametrize(("name", "old", "new"), SEEDED)
def test_a_seeded_defect_is_refuted(
    name: str, old: str, new: str, tmp_path: Path
) -> None:
    tool(
        "frama-c" if name == "outputs" else "z3",
        "frama-c-base" if name == "outputs" else "z3",
    )
    export_c(law("single"), tmp_path)
    text = (tmp_path / "law.c").read_text(encoding="utf-8")
    assert text.count(old) == 1, f"the defect's pattern is gone: {old}"
    (tmp_path / "law.c").write_text(text.replace(old, new), encoding="utf-8")
    claim = claim_of(name, tmp_path)
    assert claim.status == "failed", claim
    assert claim.reason


def test_the_slew_bound_is_that_of_an_exact_difference() -> None:
    """motor_step (1 + 2^-22) alone is not enough: the sum with the step is rounded at
    the command's size.
    """
    made = law("single")
    step_size, limit = (
        np.float32(made.limits.motor_step),
        np.float32(made.limits.motor_limit),
    )
    before = np.float32(1) + np.spacing(np.float32(1)) * np.arange(
        2**16, dtype=np.float32
    )
    before = np.concatenate([before, before + np.float32(4), limit - before])
    moved = np.max(np.abs((before + step_size).astype(float) - before.astype(float)))
    assert float(step_size) * (1 + 2.0**-22) < moved <= step.slew_bound(made)


def exact_correction(errors: NDArray[np.float64]) -> list[Fraction]:
    """Ĉe with the coefficients of single precision, in rational numbers."""
    values = law("single").coefficients
    count = len(law("single").correction.poles)
    numbers = [Fraction(x) for x in values["real"][: 2 * count]]  # type: ignore[index]
    poles, gains = numbers[::2], numbers[1::2]
    # the law starts without a bump: its first change is zero
    states, before, out = [Fraction(0)] * count, Fraction(errors[0]), []
    for error in map(Fraction, errors.tolist()):
        change, before = error - before, error
        out.append(
            Fraction(values["direct"]) * change
            + sum(map(Fraction.__mul__, gains, states))
        )  # type: ignore[arg-type]
        states = [p * x + change for p, x in zip(poles, states, strict=True)]
    return out


def test_the_rounding_stays_below_its_bound_and_a_slip_does_not(tmp_path: Path) -> None:
    """Measured against rational arithmetic; gains that are off by 1e-4 pass the bound."""
    tool("gappa")
    made = law("single", equipped=False)
    export_c(made, tmp_path)
    assert rounding.rounding_claim(made, tmp_path, error=0.02).status == "proved"
    answer = (tmp_path / "proof" / "rounding.log").read_text(encoding="utf-8")
    bound = rounding.rounding_bound(made, answer, worst_gain(made), 0.02)
    rng = np.random.default_rng(4)
    rows = np.zeros((4, 150))
    rows[3] = 1.56 * (
        0.01 * np.sin(0.05 * np.arange(150)) + 0.001 * rng.uniform(-1, 1, 150)
    )
    slipped = made.correction._replace(
        gains=tuple(1.0001 * gain for gain in made.correction.gains)
    )
    distances = []
    for run_by in (made, replace(made, correction=slipped)):
        out = run_law(run_by, rows)
        assert (out.mode == 1).all()
        assert (out.flags & 32 == 0).all()  # nothing was limited
        exact = np.array([float(x) for x in exact_correction(out.error)])
        distances.append(np.abs(out.motor_reference - exact).max())
    assert bound.correction / 1000 < distances[0] <= bound.correction < distances[1]


def test_the_rounding_of_complex_pairs_is_bounded_too(tmp_path: Path) -> None:
    tool("gappa")
    made = with_pair("single")
    export_c(made, tmp_path)
    claim = rounding.rounding_claim(made, tmp_path)
    assert claim.status == "proved", claim.reason
    assert "pair0_turned" in (tmp_path / "proof" / "rounding.gappa").read_text(
        encoding="utf-8"
    )


def test_a_new_export_takes_an_old_proof_away(tmp_path: Path) -> None:
    (tmp_path / "proof.json").write_text("{}", encoding="utf-8")
    export_c(law("single"), tmp_path, force=True)
    assert not (tmp_path / "proof.json").exists()


def test_another_form_of_the_law_is_not_proved_by_the_old_script(
    tmp_path: Path,
) -> None:
    tool("gappa")
    export_c(law("single"), tmp_path)
    text = (tmp_path / "law.c").read_text(encoding="utf-8")
    (tmp_path / "law.c").write_text(
        text.replace("sum += modes[i].gain * value", "sum -= modes[i].gain * value")
    )
    claim = rounding.rounding_claim(law("single"), tmp_path)
    assert claim.status == "not proved"
    assert "form" in claim.reason


def test_what_is_missing_is_named_and_not_claimed(
    design: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Exit code 1, a list of what was proved and what was not, and a page that claims
    no more.
    """
    monkeypatch.setenv("PATH", str(tmp_path))
    folder = tmp_path / "firmware"
    assert (
        main(["export", "c", str(design), "--out", str(folder), "--prove", "--json"])
        == 1
    )
    told = json.loads(capsys.readouterr().out)
    assert told["passed"] is False
    assert {claim["name"]: claim["status"] for claim in told["claims"]} == {
        **dict.fromkeys(("outputs", "finite", "slew", "rounding"), "not proved"),
        "loop": "proved",
    }
    proof = Proof.load(folder / "proof.json")
    for claim, package in (
        ("outputs", "frama-c-base"),
        ("slew", "z3"),
        ("finite", "cvc5"),
        ("rounding", "gappa"),
    ):
        assert f"Debian package {package}" in proof[claim].reason
    page = re.sub(r"\s+", " ", (folder / "README.md").read_text(encoding="utf-8"))
    shown, rest = page.split("## Proved")[1].split("## Not proved")
    assert "undefined behaviour" not in shown
    assert rest.count(": not proved. ") == 4


def test_a_certificate_of_another_law_proves_nothing(tmp_path: Path) -> None:
    rig = fl.Rig.named("paper-2023")
    certificate = certify(law("double"), model=rig.model, rig=rig)
    assert loop_claim(law("double"), tmp_path, certificate).status == "proved"
    assert (
        "not about this one" in loop_claim(law("single"), tmp_path, certificate).reason
    )


@pytest.mark.parametrize(
    "text",
    [
        "for (i = 0U; i < 3U; i++) { x = i; }",
        "switch (x) { }",
        "x++;",
        "x = y ? 1U : 0U",
        "double z = 1.0;",
        "goto end;",
        "x = `y`;",
    ],
)
def test_what_the_reader_does_not_know_is_refused(text: str) -> None:
    function = source.Function("f", "void", (), text)
    with pytest.raises(source.Unreadable):
        function.body()


def test_the_formulas_compute_what_the_compiler_does(tmp_path: Path) -> None:
    """clamped, credible and limited as formulas, evaluated by a solver beside the
    compiled law.c.
    """
    solver = tool("z3")
    export_c(law("single"), tmp_path)
    preprocessed = run(
        tool("gcc"), "-E", "-P", "-std=c99", "-DLAW_SINGLE", "law.c", cwd=tmp_path
    ).stdout
    read = source.read_source(preprocessed)
    values = [
        float(np.float32(x)) for x in (0.0, -0.0, 1.5, -1.5, 3.0, -3.0, 1e-42, 3e38)
    ]
    program = '#include "law.c"\n#include <stdio.h>\nint main(void) { float v[8] = {0.0F, -0.0F, 1.5F, -1.5F, 3.0F,'
    program += (
        " -3.0F, 1e-42F, 3e38F}; for (int i = 0; i < 8; i++) "
        '{ printf("%a %u %a\\n", (double)clamped(v[i], 1.5F), credible(v[i], 1.5F), '
        "(double)limited(v[i], 1.5F)); } return 0; }\n"
    )
    (tmp_path / "try.c").write_text(program, encoding="utf-8")
    run(tool("gcc"), "-std=c99", "-DLAW_SINGLE", "try.c", "-o", "try", cwd=tmp_path)
    lines = run(tmp_path / "try").stdout.splitlines()
    executed = symbolic.Symbolic(read, "single", constants={}, tracked=frozenset())
    literal = formulas.real_literal
    goals = []
    for value, line in zip(values, lines, strict=True):
        clamped, credible, limited = line.split()
        given = tuple(
            formulas.Value("real", literal(x, "single")) for x in (value, 1.5)
        )
        for name, wanted in (("clamped", clamped), ("limited", limited)):
            answer = executed.call(name, given)
            assert answer is not None
            goals.append(
                f"(= {answer.term} {literal(float.fromhex(wanted), 'single')})"
            )
        answer = executed.call("credible", given)
        assert answer is not None
        goals.append(f"(= {answer.term} (_ bv{credible} 32))")
    for goal, wanted in (
        (f"(not (and {' '.join(goals)}))", "unsat"),
        (f"(and {' '.join(goals)})", "sat"),
    ):
        problem = [
            "(set-logic QF_BVFP)",
            *executed.lines,
            f"(assert {goal})",
            "(check-sat)",
        ]
        (tmp_path / "try.smt2").write_text("\n".join(problem), encoding="utf-8")
        assert run(solver, tmp_path / "try.smt2").stdout.strip() == wanted


EVA_LOG = """
[eva:summary] ====== ANALYSIS SUMMARY ======
  0 alarms generated by the analysis.
  Evaluation of the logical properties reached by the analysis:
    Assertions        {valid} valid     {unknown} unknown     {invalid} invalid      3 total
"""


@pytest.mark.parametrize(
    ("log", "complaints"),
    [
        (EVA_LOG.format(valid=3, unknown=0, invalid=0), []),
        (
            EVA_LOG.format(valid=2, unknown=1, invalid=0),
            ["not all 3 assertions are valid"],
        ),
        (
            EVA_LOG.format(valid=2, unknown=0, invalid=1),
            ["not all 3 assertions are valid"],
        ),
        (
            EVA_LOG.format(valid=2, unknown=0, invalid=0),
            ["not all 3 assertions are valid"],
        ),
        (
            EVA_LOG.format(valid=3, unknown=0, invalid=0).replace(
                "0 alarms", "12 alarms"
            ),
            ["the log does not end with 0 alarms"],
        ),
        ("", ["the log does not end with 0 alarms", "not all 3 assertions are valid"]),
        (
            "[eva:alarm] law.c:71: Warning: division by zero\n"
            + EVA_LOG.format(valid=3, unknown=0, invalid=0),
            ["[eva:alarm] law.c:71: Warning: division by zero"],
        ),
    ],
)
def test_whatever_speaks_against_the_claim_in_evas_log_is_found(
    log: str, complaints: list[str]
) -> None:
    assert eva._alarms(log, 3) == complaints


# --- without a tool: the terms and the script, evaluated here ---------------------------------------------


def evaluated(lines: list[str], goal: str, given: dict[str, object]) -> object:
    """A term of SMT-LIB over reals in single precision, words and conditions."""
    names = dict(given)
    reals = {
        "fp.add": np.add,
        "fp.sub": np.subtract,
        "fp.mul": np.multiply,
        "fp.div": np.divide,
    }
    tests = {
        "fp.lt": "lt",
        "fp.leq": "le",
        "fp.gt": "gt",
        "fp.geq": "ge",
        "fp.eq": "eq",
    }
    words = {
        "bvadd": "add",
        "bvsub": "sub",
        "bvmul": "mul",
        "bvand": "and_",
        "bvor": "or_",
        "bvxor": "xor",
    }
    orders = {"bvult": "lt", "bvule": "le", "bvugt": "gt", "bvuge": "ge", "=": "eq"}

    def value(parts: list[object] | str) -> object:
        if isinstance(parts, str):
            return (
                names[parts]
                if parts in names
                else {"true": True, "false": False}[parts]
            )
        sign, *rest = parts
        if sign == "_":  # (_ bv3 32)
            return int(str(rest[0])[2:])
        if sign == "fp":
            bits = "".join(str(part)[2:] for part in rest)
            return np.frombuffer(int(bits, 2).to_bytes(4, "big"), ">f4")[0].astype(
                np.float32
            )
        if sign == "ite":
            return value(rest[1]) if value(rest[0]) else value(rest[2])  # type: ignore[arg-type]
        if isinstance(sign, list):  # ((_ to_fp_unsigned 8 24) RNE word)
            return np.float32(value(rest[1]))  # type: ignore[arg-type]
        if sign in reals:
            a, b = (value(part) for part in rest[1:])  # type: ignore[arg-type]
            return np.float32(reals[str(sign)](a, b))
        found = [value(part) for part in rest]  # type: ignore[arg-type]
        if sign in ("fp.abs", "fp.neg", "not"):
            one: object = found[0]
            return not one if sign == "not" else abs(one) if sign == "fp.abs" else -one  # type: ignore[arg-type,operator]
        if sign in words:
            return getattr(operator, words[str(sign)])(*found) % 2**32
        return bool(getattr(operator, (tests | orders)[str(sign)])(*found))

    for line in lines:
        tree = nested(line)
        if tree[0] == "define-fun":
            names[str(tree[1])] = value(tree[-1])  # type: ignore[arg-type]
    return value(nested(goal)) if goal.startswith("(") else value(goal)


def nested(text: str) -> list[object]:
    stack: list[list[object]] = [[]]
    for part in re.findall(r"[()]|[^\s()]+", text):
        if part == "(":
            stack.append([])
        elif part == ")":
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(part)
    return stack[0][0]  # type: ignore[return-value]


REAL_SIGNS = {"+": np.add, "-": np.subtract, "*": np.multiply}
TEST_SIGNS = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}


@pytest.mark.parametrize("seed", range(40))
def test_a_formula_has_the_value_that_was_computed(seed: int) -> None:
    """Random steps of single precision, with choices, a bounded name and known
    constants among them.
    """
    random = np.random.default_rng(seed)
    constants = [np.float32(x) for x in (0.0, 0.5, 1.5, -1.5, 3.0, -0.25)]
    made = formulas.Formulas("single", [float(x) for x in constants])
    free = made.any("real", "x")
    command = made.any("real", "command")
    given = {
        free.term: np.float32(random.normal()),
        command.term: np.float32(random.uniform(-1.5, 1.5)),
    }
    made.bounded[command.term] = 1.5
    values: list[tuple[formulas.Value, np.float32]] = [
        (free, given[free.term]),
        (command, given[command.term]),
    ]
    values += [
        (formulas.Value("real", formulas.real_literal(float(x), "single")), x)
        for x in constants
    ]
    tests: list[tuple[formulas.Value, bool]] = [
        (formulas.TRUE, True),
        (formulas.FALSE, False),
    ]
    for _ in range(25):
        (a, x), (b, y) = (values[random.integers(len(values))] for _ in range(2))
        step = random.integers(6)
        if step == 0:
            sign = str(random.choice(list(REAL_SIGNS)))
            values.append(
                (made.operated(sign, a, b), np.float32(REAL_SIGNS[sign](x, y)))
            )
        elif step == 1:
            sign = str(random.choice(list(TEST_SIGNS)))
            tests.append((made.operated(sign, a, b), bool(TEST_SIGNS[sign](x, y))))
        elif step == 2:
            test, truth = tests[random.integers(len(tests))]
            values.append((made.choice(test, a, b), x if truth else y))
        elif step == 3:
            values.append((made.negative(a), -x))
        elif step == 4:
            values.append((made.magnitude(a), abs(x)))
        else:
            (one, p), (other, q) = (
                tests[random.integers(len(tests))] for _ in range(2)
            )
            sign = str(random.choice(["&&", "||"]))
            tests.append(
                (
                    made.joined(sign, [one, other]),
                    (p and q) if sign == "&&" else (p or q),
                )
            )
            tests.append((made.negated(one), not p))
    for formula, number in values:
        assert evaluated(made.lines, formula.term, given) == number
    for formula, truth in tests:
        assert (
            evaluated(made.lines, formula.term, given) is truth
            or evaluated(made.lines, formula.term, given) == truth
        )
    for formula, number in values[
        8:
    ]:  # what is asked for may be more than is true, never less
        limit = float(np.float32(random.uniform(0.1, 8.0)))
        asked = made.at_most(formula, limit)
        if evaluated(made.lines, asked.term, given):
            assert abs(number) <= limit
        chosen = made.relevant([asked.term])
        assert set(chosen) <= set(made.lines) | {
            line for line in chosen if "declare-const" in line
        }


def test_a_bound_is_met_by_its_parts() -> None:
    """A sum of two quarters, a product with the other factor small enough, and the
    literal limit itself.
    """
    made = formulas.Formulas("single", [2.0, 0.5])
    x, y = made.any("real", "x"), made.any("real", "y")
    two = formulas.Value("real", formulas.real_literal(2.0, "single"))
    total, product = made.operated("+", x, y), made.operated("*", x, two)
    for formula, met, inside in (
        (made.at_most(total, 4.0), "parts", lambda a, b: abs(a) <= 1 and abs(b) <= 1),
        (made.at_most(product, 4.0), "factor", lambda a, _: abs(a) <= 0.5),
    ):
        tree = str(formula.term)
        assert tree != "true" and met
        definition = next(line for line in made.lines if line.split()[1] == tree)
        *_, parts = re.findall(r"t\d+", definition)
        for a in (0.0, 0.4, -0.5, 0.6, 1.0, 1.1, -3.0):
            for b in (0.0, 0.9, -1.0, 1.1):
                given = {x.term: np.float32(a), y.term: np.float32(b)}
                assert evaluated(made.lines, parts, given) == inside(a, b), (met, a, b)


def test_what_is_set_free_is_a_sum_with_a_part_that_may_be_anything() -> None:
    made = formulas.Formulas("double", [])
    x, y = made.any("real", "x"), made.any("real", "y")
    total = made.operated("+", x, y)
    twice = made.operated("*", total, total)
    lines = made.relevant([twice.term])
    assert f"(declare-const {total.term} {made.real_sort})" in lines
    assert not any(x.term in line or y.term in line for line in lines)
    both = made.relevant([twice.term, f"(fp.leq {x.term} {y.term})"])
    assert any(
        line.startswith(f"(define-fun {total.term}") for line in both
    )  # x and y are used elsewhere
    assert made.relevant([twice.term], arithmetic=False) == [
        f"(declare-const {twice.term} {made.real_sort})"
    ]


def test_a_function_knows_its_loops_and_whether_it_is_pure() -> None:
    looped = source.Function(
        "f", "void", (("law_real", True, "x"),), "for (i = 0; i < 3; i++) { x[i] = 0; }"
    )
    plain = source.Function(
        "g", "law_real", (("law_real", False, "x"),), "return forty + x;"
    )
    assert looped.loops and not looped.pure
    assert plain.pure and not plain.loops


@pytest.mark.parametrize(
    "made", [law("single"), with_pair("double")], ids=["real", "pairs"]
)
def test_the_script_is_one_period_of_the_law(made: Law) -> None:
    """The exact formulas of the Gappa script, with rational samples, against complex
    arithmetic.
    """
    script = rounding._script(made, 0.5)
    formula = dict(re.findall(r"^(\w+)_exact = (.*);$", script, re.MULTILINE))
    limits = dict(re.findall(r"\|(\w+)\| <= (\S+)", script))
    random = np.random.default_rng(1)
    names = set(re.findall(r"\b[a-z]\w*\b", " ".join(formula.values()))) - {"rnd"}
    names = {name for name in names if not re.fullmatch(r"0x.*|p", name)}
    sample = {name: Fraction(int(random.integers(-99, 99)), 64) for name in names}

    def computed(name: str) -> Fraction:
        text = re.sub(
            r"-?0x[0-9a-f.]+p[+-]?\d+",
            lambda m: f"F({float.fromhex(m[0])!r})",
            formula[name],
        )
        return Fraction(eval(text, {"F": Fraction}, dict(sample)))  # noqa: S307

    values = made.coefficients
    one = {
        key: Fraction(values[key]) for key in ("direct", "forward_direct", "compliance")
    }  # type: ignore[arg-type]

    def grouped(key: str, width: int, count: int) -> list[list[Fraction]]:
        numbers = [Fraction(v) for v in values[key][: width * count]]  # type: ignore[index]
        return [numbers[k * width : (k + 1) * width] for k in range(count)]

    out = one["direct"] * sample["driven"]
    for k, (pole, gain) in enumerate(grouped("real", 2, len(made.correction.poles))):
        assert computed(f"real{k}") == pole * sample[f"x_real{k}"] + sample["driven"]
        out += gain * sample[f"x_real{k}"]
    for k, (pole, turn, gain, cross) in enumerate(
        grouped("pair", 4, len(made.correction.pair_poles))
    ):
        x, y = sample[f"x_pair{k}"], sample[f"y_pair{k}"]
        assert (
            computed(f"pair{k}") == pole * x - turn * y + sample["driven"]
        )  # Re (p + jt)(x + jy)
        assert computed(f"pair{k}_turned") == pole * y + turn * x
        out += gain * x - cross * y
    assert computed("sum_output") == out
    ahead = one["forward_direct"] * sample["acceleration"]
    for k, (pole, gain) in enumerate(
        grouped("forward", 2, len(made.feedforward.poles))
    ):
        assert (
            computed(f"ahead{k}")
            == pole * sample[f"x_ahead{k}"] + sample["acceleration"]
        )
        ahead += gain * sample[f"x_ahead{k}"]
    assert computed("ahead_output") == ahead
    assert computed("change") == sample["now"] - sample["before"]
    tip = sample["angle"] - sample["torque"] * one["compliance"]
    assert computed("error") == sample["reference"] - tip
    assert computed("offset") == sample["forwarded"] + sample["corrected"]
    assert computed("wanted") == sample["reference"] + sample["offset"]
    assert (
        float.fromhex(limits["now"]) == pytest.approx(0.5)
        and float.fromhex(limits["driven"]) >= 1.0
    )
    for name, key in (
        ("angle", "angle_limit"),
        ("torque", "torque_limit"),
        ("corrected", "sum_limit"),
    ):
        assert (
            float(values[key])
            <= float.fromhex(limits[name])
            <= float(values[key]) * 1.001
        )  # type: ignore[arg-type]
    assert ("ieee_32" in script) == (made.precision == "single")


@pytest.mark.parametrize(
    ("pole", "turn"), [(0.9, 0.0), (-0.6, 0.0), (0.0, 0.0), (0.7, 0.5), (-0.4, 0.6)]
)
def test_a_modes_largest_state_is_that_of_the_worst_input(
    pole: float, turn: float
) -> None:
    mode = rounding._Mode(
        "pair0" if turn else "real0", pole, 0.3, turn, -0.2 if turn else 0.0
    )
    p = complex(pole, turn)
    powers = p ** np.arange(4000)
    whole = np.abs(powers).sum() if turn else np.abs(powers.real).sum()
    assert 1.0 / float(mode.leak) == pytest.approx(whole, rel=1e-6)
    assert float(mode.size(Fraction(1), of_change=False)) == pytest.approx(
        whole, rel=1e-6
    )
    # Differences of errors of up to half the change: the response to (1 - 1/z).
    differences = np.diff(np.concatenate([[0.0], powers]))
    worst = 0.5 * np.abs(differences.real).sum()
    bound = float(mode.size(Fraction(1), of_change=True))
    assert bound >= worst * (1 - 1e-9)
    if not turn:
        assert bound == pytest.approx(worst, rel=1e-6)
    else:
        assert bound <= 2.0 * 0.5 * np.abs(differences).sum()
    assert mode.weight == abs(Fraction(0.3)) + abs(Fraction(mode.cross))


# --- the reader, the executed text and the bounds, each beside something that knows the answer -------------


def test_expressions_have_the_precedence_of_the_compiler(tmp_path: Path) -> None:
    """Random expressions of words, computed by the compiler and from the tree that was
    read.
    """
    random, shared = (
        np.random.default_rng(5),
        ["&", "|", "^", "<", "<=", ">", ">=", "==", "!=", "&&", "||"],
    )
    texts = []
    for k in range(80):
        # By a difference nothing can be shifted: it may be four thousand million.
        signs = [*shared, *(("+", "-", "*") if k % 2 else ("<<", ">>"))]
        words = [f"{random.integers(1, 9)}U"]
        for _ in range(int(random.integers(1, 5))):
            sign = str(random.choice(signs))
            words += [sign, f"{random.integers(1, 4 if sign in ('<<', '>>') else 9)}U"]
        if random.random() < 0.3:
            place = 2 * int(random.integers((len(words) + 1) // 2))
            words[place] = f"({words[place]} {random.choice(shared[:3])} 3U)"
        if random.random() < 0.2:
            words += ["?", "7U", ":", "2U"]
        texts.append(" ".join(words))
    lines = "".join(f'printf("%u\\n", (unsigned)({text}));' for text in texts)
    (tmp_path / "try.c").write_text(
        f"#include <stdio.h>\nint main(void) {{ {lines} return 0; }}\n"
    )
    run(tool("gcc"), "-std=c99", "-w", "try.c", "-o", "try", cwd=tmp_path)
    wanted = [int(line) for line in run(tmp_path / "try").stdout.split()]
    tests = {"<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge}
    tests |= {"==": operator.eq, "!=": operator.ne}
    words_of = {
        "+": operator.add,
        "-": operator.sub,
        "*": operator.mul,
        "&": operator.and_,
    }
    words_of |= {
        "|": operator.or_,
        "^": operator.xor,
        "<<": operator.lshift,
        ">>": operator.rshift,
    }

    def value(node: source.Node) -> int:
        kind = node[0]
        if kind == "number":
            return int(str(node[1]).rstrip("U"))
        if kind == "choice":
            return value(node[2]) if value(node[1]) else value(node[3])  # type: ignore[arg-type]
        assert kind == "binary"
        sign, left, right = str(node[1]), value(node[2]), value(node[3])  # type: ignore[arg-type]
        if sign in ("&&", "||"):
            return (
                int(bool(left) and bool(right))
                if sign == "&&"
                else int(bool(left) or bool(right))
            )
        return (
            int(tests[sign](left, right))
            if sign in tests
            else words_of[sign](left, right) % 2**32
        )

    for text, number in zip(texts, wanted, strict=True):
        ((kind, tree),) = source.Function("f", "uint32_t", (), f"return {text};").body()
        assert kind == "return"
        assert value(tree) == number, text  # type: ignore[arg-type]


SMALL = """
# 1 "law.c"
typedef struct {
    law_real x;
    law_real y;
    uint32_t mode;
    law_real list[4];
} law_state;
typedef struct {
    law_real limit;
    uint32_t count;
} law_params;
/* a comment with { a brace */
static law_real clamped(law_real v, law_real limit)
{
    law_real found = v;
    if (v > limit) { found = limit; } else if (v < -limit) { found = -limit; }
    return found;
}
static void raise(law_state *s, law_real *place, law_real by)
{
    *place = *place + by;
    s->mode |= 2U;
}
static void fill(law_state *s, law_real by)
{
    for (uint32_t i = 0U; i < 4U; i++) { s->list[i] += by; }
}
static void both(law_state *s, law_real by)
{
    fill(s, by);
    s->y = by;
}
law_real stepped(law_state *s, const law_params *p, law_real u)
{
    law_real sum = clamped(u, p->limit) * (law_real)2.0F;
    if ((s->mode == 1U) && (u > (law_real)0.0F)) {
        raise(s, &s->x, sum);
    } else {
        s->y -= sum / (law_real)4.0F;
        s->mode = (s->mode == 5U) ? 1U : s->mode;
    }
    sum += s->x;
    return sum;
}
"""


def test_what_a_call_may_change_is_what_its_text_assigns() -> None:
    read = source.read_source(SMALL)
    assert read.members == {
        "x": "law_real", "y": "law_real", "mode": "uint32_t", "list": "law_real", "limit": "law_real",
        "count": "uint32_t",
    }  # fmt: skip
    assert set(read.functions) == {"clamped", "raise", "fill", "both", "stepped"}
    assert read.effects("clamped") == frozenset()
    assert read.effects("raise") == {("law_state", "mode")}
    assert read.effects("fill") == {("law_state", "list")}
    assert read.effects("both") == {("law_state", "list"), ("law_state", "y")}
    assert read.effects("stepped") == {
        ("law_state", name) for name in ("x", "y", "mode")
    }
    assert read.functions["clamped"].pure and not read.functions["raise"].pure
    assert read.functions["fill"].loops and not read.functions["both"].loops
    assert read.functions["stepped"].parameters == (
        ("law_state", True, "s"), ("law_params", True, "p"), ("law_real", False, "u")
    )  # fmt: skip
    for text, words in (
        ("void f(law_state *s) { f(s); }", "calls itself"),
        (
            "typedef struct {\n law_real a;\n} one;\ntypedef struct {\n uint32_t a;\n} two;",
            "two types",
        ),
        ("void f(void) { if (", "does not end"),
    ):
        with pytest.raises(source.Unreadable, match=words):
            source.read_source(text).effects("f")
    for assignment in (
        "s->x++;",
        "s->x--;",
        "s->x ^= 1U;",
        "s->x /= (law_real)2.0F;",
        "g(&s->x);",
    ):
        assert source.read_source(f"void f(law_state *s) {{ {assignment} }}").effects(
            "f"
        ) == {("law_state", "x")}
    assert not source.read_source("void f(law_state *s) { y = s->x == 1U; }").effects(
        "f"
    )


@pytest.mark.parametrize("mode", [0, 1, 5])
@pytest.mark.parametrize("u", [-3.0, -0.7, 0.0, 0.4, 2.5])
def test_the_executed_text_computes_what_the_text_says(mode: int, u: float) -> None:
    """`stepped` of the small law above, in Python's words and single precision."""
    one = np.float32
    x, y, limit = one(0.3), one(-1.7), one(1.5)
    kept = {("law_state", name) for name in ("x", "y", "mode")}
    run_ = symbolic.Symbolic(
        source.read_source(SMALL),
        "single",
        constants={"limit": 1.5},
        tracked=frozenset(kept),
    )
    free = {name: run_.load(("law_state", name)) for name in ("x", "y", "mode")}
    given = run_.any("real", "u")
    states = (
        formulas.Value("pointer", "law_state"),
        formulas.Value("pointer", "law_params"),
    )
    answer = run_.call("stepped", (*states, given))
    assert answer is not None and answer.kind == "real"
    names = {
        free["x"].term: x,
        free["y"].term: y,
        free["mode"].term: mode,
        given.term: one(u),
    }
    total = one(max(min(one(u), limit), -limit) * one(2))
    if mode == 1 and u > 0:
        x, mode = one(x + total), mode | 2
    else:
        y, mode = one(y - total / one(4)), 1 if mode == 5 else mode
    assert evaluated(run_.lines, answer.term, names) == one(total + x)
    for name, wanted in (("x", x), ("y", y), ("mode", mode)):
        assert (
            evaluated(run_.lines, run_.memory["law_state", name].term, names) == wanted
        )


def test_what_is_not_followed_may_leave_anything() -> None:
    read = source.read_source(SMALL)
    run_ = symbolic.Symbolic(
        read, "single", constants={}, tracked=frozenset({("law_state", "y")})
    )
    before = run_.load(("law_state", "x"))
    state, by = formulas.Value("pointer", "law_state"), run_.any("real", "by")
    run_.call("both", (state, by))
    assert run_.memory["law_state", "y"] == by  # followed, as it writes what is tracked
    assert run_.memory["law_state", "list"].term.startswith(
        "any_list"
    )  # its loop is not
    assert run_.load(("law_state", "x")) == before
    place = formulas.Value("pointer", "law_state.x")
    run_.call(
        "raise", (state, place, by)
    )  # writes nothing tracked: its effects are anything
    assert run_.memory["law_state", "mode"].term.startswith("any_mode")
    assert run_.memory["law_state", "x"].term.startswith("any_written")
    assumed = symbolic.Symbolic(
        read,
        "single",
        constants={},
        tracked=frozenset(),
        assumed={"clamped": formulas.ZERO},
    )
    assert assumed._call_node(("call", "clamped", ()), "here") == formulas.ZERO
    with pytest.raises(source.Unreadable, match="text is not here"):
        assumed._call_node(("call", "unknown", ()), "here")
    with pytest.raises(source.Unreadable, match="given something else"):
        run_.call("both", (by, by))
    with pytest.raises(source.Unreadable, match="read before it is written"):
        run_.load(("law_state", "nothing"))


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("if (u > (law_real)0.0F) { return u; } return u;", "inside a branch"),
        ("return u; u = (law_real)1.0F;", "before its end"),
        ("return 1.0;", "double precision"),
        ("return (law_real)(u > (law_real)0.0F);", "bool as"),
        ("return u + 1U;", r"real \+ word"),
        ("return u & u;", "real & real"),
        ("return (u > (law_real)0.0F) ? u : 1U;", "between two types"),
        ("list[0] = u; return u;", "after 'element'"),
        ("u = clamped(u, u) = u; return u;", "where ';' was expected"),
        ("return (set(&u) > 0U) && (u > (law_real)0.0F) ? u : u;", "effect inside"),
    ],
)
def test_a_form_that_is_not_read_is_named(body: str, words: str) -> None:
    text = (
        SMALL + "static uint32_t set(law_real *v) { *v = (law_real)1.0F; return 1U; }\n"
    )
    read = source.read_source(text + f"law_real tried(law_real u) {{ {body} }}\n")
    run_ = symbolic.Symbolic(read, "single", constants={}, tracked=frozenset())
    with pytest.raises(source.Unreadable, match=words):
        run_.call("tried", (run_.any("real", "u"),))


def test_known_comparisons_need_no_solver() -> None:
    """|command| ≤ 1.5 is assumed: what follows from that is decided, and nothing else."""
    made = formulas.Formulas("single", [0.0, 1.0, 1.5, 2.0, -1.5, -2.0])
    command, other = made.any("real", "command"), made.any("real", "x")
    made.bounded[command.term] = 1.5

    def number(value: float) -> formulas.Value:
        return formulas.Value("real", formulas.real_literal(value, "single"))

    decided = {
        ("<=", 2.0): True, ("<=", 1.5): True, (">", 2.0): False, (">", 1.5): False, ("<", -2.0): False,
        ("<", -1.5): False, ("<=", 1.0): None, (">", 1.0): None, ("<", 1.5): None, ("<", 2.0): None,
        ("<=", -2.0): None, (">", -2.0): None, (">=", -2.0): None, ("<", 0.0): None,
    }  # fmt: skip
    truths = {True: formulas.TRUE, False: formulas.FALSE}
    for (sign, limit), known in decided.items():
        found = made.operated(sign, command, number(limit))
        assert (
            (found == truths[known])
            if known is not None
            else found.term.startswith("t")
        ), (sign, limit)
        assert made.operated(sign, other, number(limit)).term.startswith("t")
    assert made.operated("==", command, command) == formulas.TRUE
    assert made.operated("==", other, other).term.startswith("t")  # it may be NaN
    assert made.operated("!=", command, command) == formulas.FALSE
    size = made.magnitude(command)
    assert made.operated("<=", size, number(1.5)) == formulas.TRUE
    word = formulas.Value("word", "(_ bv3 32)")
    assert made.operated("==", word, word) == formulas.TRUE
    assert made.operated("==", word, formulas.ZERO) == formulas.FALSE
    assert made.operated("==", made.any("word", "w"), formulas.ZERO).term.startswith(
        "t"
    )


def test_numbers_and_conversions_of_c() -> None:
    made = formulas.Formulas("double", [])
    assert made.number("0x10") == formulas.Value("word", "(_ bv16 32)")
    assert made.number("7U") == formulas.Value("word", "(_ bv7 32)")
    tenth = made.converted("law_real", made.number("0.1F"))
    assert tenth.term == formulas.real_literal(float(np.float32(0.1)), "double")
    assert made.converted(
        "law_real", made.negative(made.number("0.1F"))
    ).term == formulas.real_literal(-float(np.float32(0.1)), "double")
    assert made.converted("law_real", formulas.ZERO).term == formulas.real_literal(
        0.0, "double"
    )
    word = made.any("word", "w")
    turned = made.converted("law_real", word)
    assert (
        made.lines[-1]
        == f"(define-fun {turned.term} () {made.real_sort} ((_ to_fp_unsigned 11 53) RNE {word.term}))"
    )
    assert (
        made.truth(word).kind == "bool" and made.truth(formulas.TRUE) == formulas.TRUE
    )
    for bad in (
        lambda: made.number("1.5"),
        lambda: made.truth(turned),
        lambda: made.converted("int", word),
    ):
        with pytest.raises(source.Unreadable):
            bad()  # type: ignore[no-untyped-call]
    for value in (0.1, -2.5, 1e-310, 3e300):
        bits = "".join(re.findall(r"#b([01]+)", formulas.real_literal(value, "double")))
        assert np.frombuffer(int(bits, 2).to_bytes(8, "big"), ">f8")[0] == value


GAPPA = """Results:
  real0_computed - real0_exact in [-3b-30 {-2.8e-09, -2^(-28.4)}, 1b-30 {9.3e-10, 2^(-30)}]
  change_computed - change_exact in [-1b-40, 1b-41]
"""


def test_answers_of_gappa_are_read_to_the_last_bit() -> None:
    assert rounding._answers(GAPPA) == {
        "real0": Fraction(3, 2**30),
        "change": Fraction(1, 2**40),
    }
    assert [rounding._dyadic(text) for text in ("5", "-7b2", "3b-1")] == [
        5,
        -28,
        Fraction(3, 2),
    ]
    with pytest.raises(ValueError, match="no bounds: Error: nothing"):
        rounding._answers("Error: nothing\nmore\n")


@pytest.mark.parametrize(
    "made", [law("single"), with_pair("double")], ids=["real", "pairs"]
)
def test_the_bound_for_all_time_is_the_sum_of_what_each_rounding_may_become(
    made: Law,
) -> None:
    """An error in each period, of a size of its own for each place, through the
    filters' l1 norms.
    """
    asked = re.findall(r"(\w+)_computed - \w+ in \?", rounding._script(made, 0.5))
    sizes = {name: 2.0 ** -(40 + k % 5) for k, name in enumerate(asked)}
    answer = "\n".join(
        f"  {name}_computed - {name}_exact in [-1b{int(np.log2(size))}, 1b-99]"
        for name, size in sizes.items()
    )
    largest = worst_gain(made)
    found = rounding.rounding_bound(made, answer, largest, 0.5)
    values = made.coefficients

    def filtered(key: str, width: int, count: int, tag: str) -> tuple[float, float]:
        """What the errors of the states become at the output, and the l1 norm from a
        drive to there.
        """
        total = norm = 0.0
        for k in range(count):
            row = values[key][width * k : width * (k + 1)]  # type: ignore[index]
            pole, gain, turn, cross = (
                (row[0], row[1], 0.0, 0.0)
                if width == 2
                else (row[0], row[2], row[1], row[3])
            )
            entering = sizes[f"{tag}{k}"] + sizes.get(f"{tag}{k}_turned", 0.0)
            lasting = 1.0 / (1.0 - abs(complex(pole, turn)))
            total += (abs(gain) + abs(cross)) * entering * lasting
            norm += (abs(gain) + abs(cross)) * lasting
        return total, norm

    real, norm = filtered("real", 2, len(made.correction.poles), "real")
    pair, more = filtered("pair", 4, len(made.correction.pair_poles), "pair")
    ahead, _ = filtered("forward", 2, len(made.feedforward.poles), "ahead")
    own = (
        sizes["sum_output"]
        + real
        + pair
        + (abs(values["direct"]) + norm + more) * sizes["change"]
    )  # type: ignore[arg-type]
    assert found.correction == pytest.approx(own, rel=1e-6)
    forward = sizes["ahead_output"] + ahead
    whole = own + forward + largest * sizes["error"] + sizes["offset"] + sizes["wanted"]
    assert found.command == pytest.approx(whole, rel=1e-6) and found.error == 0.5
    with pytest.raises(ValueError, match="grows beyond"):
        rounding.rounding_bound(made, answer.replace("[-1b-40", "[-1b-2"), largest, 0.5)


def test_a_tool_runs_in_its_folder_and_is_stopped_for_time(tmp_path: Path) -> None:
    shell = tools.Tool("sh", "dash")
    answer = shell.run(("-c", "pwd; echo $PWD; echo lost >&2; exit 3"), tmp_path)
    assert answer == tools.Answer(
        f"{tmp_path.resolve()}\n{tmp_path.resolve()}\nlost\n", 3
    )
    assert shell.run(("-c", "exec sleep 20"), tmp_path, seconds=0.2) == tools.Answer(
        "sh: no answer within 0.2 s\n", None
    )
    gone = tools.Tool("no-such-prover", "none")
    assert gone.path is None
    assert gone.missing == "no-such-prover is not installed (Debian package none)"
    (tmp_path / "prover").write_text("#!/bin/sh\necho the prover 4.7 of 2026\n")
    (tmp_path / "prover").chmod(0o755)
    assert (
        tools.Tool(str(tmp_path / "prover"), "p").name == f"{tmp_path / 'prover'} 4.7"
    )


class Canned:
    """A prover whose answers are known: what it was asked is kept."""

    program, name, path, missing = "canned", "canned 1", "/canned", "canned is missing"

    def __init__(self, *answers: str) -> None:
        self.answers, self.asked = list(answers), []  # type: list[str], list[tuple[str, ...]]

    def run(
        self, arguments: tuple[str, ...], folder: Path, **_: object
    ) -> tools.Answer:
        self.asked.append(tuple(arguments))
        return tools.Answer(
            self.answers[min(len(self.asked), len(self.answers)) - 1], 0
        )


@pytest.mark.parametrize("precision", ["single", "double"])
def test_eva_is_asked_about_both_builds(
    precision: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = law(precision)
    count = eva.driver().count("/*@ assert")
    good = EVA_LOG.format(valid=count, unknown=0, invalid=0)
    for answers, status in (
        ((good,), "proved"),
        ((good, good.replace("0 alarms", "1 alarms")), "failed"),
    ):
        asked = Canned(*answers)
        monkeypatch.setattr(eva, "FRAMA_C", asked)
        claim = eva.commands_claim(made, tmp_path)
        assert claim.status == status and claim.tools == ("canned 1",)
        assert [log for log, _ in claim.logs] == [
            "proof/eva_general.log",
            "proof/eva_exact.log",
        ]
        general, exact = asked.asked
        assert ("-DLAW_SINGLE" in general[1]) is (precision == "single")
        assert len(exact[1]) > len(general[1])  # the flags of the design's own build
        assert (
            general[-1] == "law.c" and general[general.index("-main") + 1] == "eva_main"
        )
        if status == "failed":
            assert claim.reason.startswith("exact build: ")
    limit = tools.at_most(made.limits.motor_limit)
    assert f"|motor_reference| ≤ {limit} rad and |voltage| ≤ " in claim.statement
    without = eva.commands_claim(law(precision, equipped=False), tmp_path)
    assert "voltage" not in without.statement


@pytest.mark.parametrize(
    ("answers", "status", "words"),
    [
        (("unsat\n",), "proved", ""),
        (
            ("sat\n(model)",),
            "failed",
            "canned 1 found a step that breaks it (proof/slew_1.smt2)",
        ),
        (("unsat", "sat"), "failed", "(proof/slew_2.smt2)"),
        (("unknown\n",), "not proved", "proof/slew_1.smt2: no solver decided it"),
        (("(error) unsat",), "not proved", "no solver decided it"),
    ],
)
def test_what_a_solver_answers_decides_the_claim(
    answers: tuple[str, ...],
    status: str,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tool("cc", "gcc")
    made = law("single")
    export_c(made, tmp_path)
    monkeypatch.setattr(step, "SOLVERS", (Canned(*answers),))
    claim = step.slew_claim(made, tmp_path)
    assert claim.status == status and words in claim.reason
    problem = (tmp_path / "proof" / "slew_1.smt2").read_text(encoding="utf-8")
    assert problem.startswith("(set-logic QF_BVFP)\n") and problem.endswith(
        "(check-sat)\n"
    )
    # The command is within its range, one of the modes is on, and the goal is denied.
    assert problem.count("(assert ") == 3 and problem.count("(assert (not ") == 1
    for mode in (1, 2, 3, 4):
        assert f"(_ bv{mode * 0x01010101} 32)" in problem
    assert claim.logs[0] == ("proof/slew_1.smt2", tools.sha256_of_text(problem))
    if status == "proved":
        assert claim.tools == ("canned 1",) and len(claim.logs) == 2
        extra = step.slew_bound(made) - made.limits.motor_step
        assert f"motor_step + {tools.at_most(extra, 3)} rad" in claim.statement


def test_without_a_solver_or_a_compiler_nothing_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = tools.Tool("no-such-solver", "none")
    monkeypatch.setattr(step, "SOLVERS", (gone, gone))
    claim = step.finite_claim(law("single"), tmp_path)
    assert (claim.status, claim.reason) == (
        "not proved",
        f"{gone.missing} and {gone.missing}; one is enough",
    )
    monkeypatch.setattr(step, "SOLVERS", (gone, Canned("unsat")))
    monkeypatch.setattr(step, "COMPILER", gone)
    assert step.finite_claim(law("single"), tmp_path).reason == gone.missing


@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_slew_bound_is_one_rounding_of_a_sum_above_the_step(precision: str) -> None:
    made = law(precision)
    kind = np.float32 if precision == "single" else np.float64
    size, limit = kind(made.limits.motor_step), kind(made.limits.motor_limit)
    unit = float(np.spacing(limit))
    assert (
        float(size) + unit
        <= step.slew_bound(made)
        <= float(size) * (1 + 8 * float(np.finfo(kind).eps)) + 2 * unit
    )


def test_a_certificate_is_no_claim_where_it_is_none(tmp_path: Path) -> None:
    made = law("double")
    assert loop_claim(made, tmp_path, None).reason == (
        "no certificate was given (`fraclink certify` makes one from the design)"
    )
    rig = fl.Rig.named("paper-2023")
    failed = certify(made, model=rig.model, rig=rig, modulus_margin=0.95)
    claim = loop_claim(made, tmp_path, failed)
    assert (claim.status, claim.reason) == ("failed", failed.verdict)
    assert not (tmp_path / "proof").exists()


@pytest.mark.parametrize(
    "made", [law("single"), with_pair("double")], ids=["real", "pairs"]
)
def test_the_worst_gain_is_the_norm_of_the_impulse_response(made: Law) -> None:
    c = made.correction
    poles = np.array([*c.poles, *c.pair_poles], dtype=complex)
    gains = np.array([*c.gains, *c.pair_gains], dtype=complex)
    inner = (gains[:, None] * poles[:, None] ** np.arange(30_000)).real.sum(axis=0)
    whole = np.abs(np.diff(np.concatenate([[c.direct], inner]), prepend=0.0)).sum()
    assert worst_gain(made) == pytest.approx(whole, rel=1e-3)
