"""Whether the tests notice: random mutants of the C sources, each built and run.

    python tools/mutants_c.py run --seed 1 --count 60 --minutes 30   # again until all are judged
    python tools/mutants_c.py report --seed 1

Without a step: both. A mutant is drawn as those of Python are (tools/mutants.py): by
file, by the number of its places; then by operator, each equally likely; then by place.
It is compiled in a copy of the checkout, and killed when a test of the files named in
`TESTS` fails there. What does not compile is no mutant and another is drawn. Headers,
the board's sketch, the bindings and the page's engine are left out: what the page
computes is compared with these files to the bit.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLACE = ROOT / "results" / "mutants_c"
COPY = PLACE / "checkout"
SEED, COUNT = 1, 60
LIMIT = 420.0  # [s] of a run of tests, which without a mutant takes a quarter of it
# The tests that are nearest to each file.
LAW = "test_law test_law_exact test_law_guards test_law_payload test_loop test_export_gates"
TWIN = (
    "test_twin_beam test_twin_plant test_twin_loop test_twin_faults test_twin_numbers"
    " test_realtime_messages"
)
FIT = "test_identify_kernel test_identify test_identify_residual test_identify_shape"
LOOP = "test_loop test_motor test_simulate test_simulate_metrics test_law_exact"
REALTIME = (
    "test_realtime_messages test_realtime_line test_realtime test_realtime_cli"
    " test_arm_firmware test_estimator"
)
TESTS = {
    "law": LAW, "law_port": LAW, "arm_link": "test_arm_firmware",
    "payload_estimator": "test_estimator test_export_readme test_export_firmware",
    "figures": "test_solver test_shape test_design",
    "fit": FIT, "fit_pass": FIT, "fit_weights": FIT, "normal": FIT + " test_simulate",
    "weights": LOOP,
    "loop": LOOP, "minimax": "test_rational_approximation",
    "modes": "test_response_kernel test_response", "twin": TWIN, "twin_law": TWIN,
    "fmi3": "test_export_fmu_sources test_export_fmu_calls test_export_fmu",
}  # fmt: skip
# These compare or count the text of the sources, or what was built from them before.
READS_SOURCES = "not (seeded_defects or every_line or exports or csrc_compiles or fuzzer or checker_is_one)"
COMPARISONS = {
    "<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"),
    "==": ("!=",), "!=": ("==",),
}  # fmt: skip
ARITHMETIC = {
    "+": "-", "-": "+", "*": "/", "/": "*", "%": "/", "|": "&", "&": "|", "<<": ">>", ">>": "<<",
    "+=": "-=", "-=": "+=", "*=": "/=", "|=": "&=", "&=": "|=", "++": "--", "--": "++",
}  # fmt: skip
TOKEN = re.compile(
    r"(?P<number>\b(?:0[xX][0-9a-fA-F]+|\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)(?P<suffix>[uUlLfF]*)\b)"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<operator><<=|>>=|->|<<|>>|<=|>=|==|!=|&&|\|\||\+\+|--|[-+*/|&]=|[^\s\w])"
)
STATEMENT = re.compile(
    r"(?<=[;{}):])\s*(?P<statement>(?:\*?[a-z_]\w*(?:(?:->|\.)\w+|\[[^]]*\])*\s*(?:[-+*/|&^]?=)[^=;{}][^;{}]*"
    r"|[a-z_]\w*\([^;{}]*\)|break|continue|[a-z_]\w*(?:->|\.)[\w.>\[\]-]*(?:\+\+|--));)"
)


@dataclass(frozen=True)
class Site:
    kind: str
    start: int
    stop: int
    text: str  # replaces the text between them


def code_alone(text: str) -> str:
    """The text with comments, strings and lines of the preprocessor blanked."""
    blank = r"/\*.*?\*/|//[^\n]*|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])+'|^[ \t]*#(?:\\\n|[^\n])*"
    return re.sub(
        blank,
        lambda found: re.sub(r"[^\n]", " ", found.group()),
        text,
        flags=re.DOTALL | re.MULTILINE,
    )


def changed_number(word: str, suffix: str) -> list[str]:
    digits = word[: len(word) - len(suffix)]
    if digits.lower().startswith("0x") or not re.search(r"[.eE]", digits):
        value = int(digits, 0 if digits.lower().startswith("0x") else 10)
        near = [value + 1, value - 1] if value or "u" not in suffix.lower() else [1]
        return [f"{one}{suffix}" if one >= 0 else f"({one}{suffix})" for one in near]
    value = float(digits)
    others = {value + 1.0 if abs(value) < 100.0 else 10.0 * value, 2.0 * value or -1.0}
    return [f"{other!r}{suffix}" for other in sorted(others)]


def sites(text: str) -> list[Site]:
    code, found = code_alone(text), []
    before = ""
    for token in TOKEN.finditer(code):
        word, start, stop = token.group(), *token.span()
        spaced = code[start - 1].isspace() and code[stop : stop + 1].isspace()
        value_before = re.match(r"[\w)\]]", before[-1:]) and before != "return"
        if token["number"]:
            found += [
                Site("constant", start, stop, other)
                for other in changed_number(word, token["suffix"])
            ]
        elif word in COMPARISONS and spaced:
            found += [
                Site("comparison", start, stop, other) for other in COMPARISONS[word]
            ]
        elif word in ("&&", "||"):
            found.append(Site("boolean", start, stop, "||" if word == "&&" else "&&"))
        elif word == "!":
            found.append(Site("boolean", start, stop, ""))
        elif word in ("++", "--") or (word in ARITHMETIC and spaced and value_before):
            found.append(Site("arithmetic", start, stop, ARITHMETIC[word]))
        elif word == "-" and not spaced and not value_before:
            found.append(Site("arithmetic", start, stop, "+"))
        before = word
    found += [
        Site("removed statement", *statement.span("statement"), ";")
        for statement in STATEMENT.finditer(code)
    ]
    return found


def files() -> list[Path]:
    every = sorted((ROOT / "csrc").rglob("*.c"))
    return [
        path
        for path in every
        if not path.stem.endswith("_single") and path.parent.name != "web"
    ]


def draws(seed: int) -> list[tuple[Path, Site]]:
    """All places, in the order in which this seed takes them."""
    rng = random.Random(seed)  # noqa: S311
    places: dict[Path, dict[str, dict[int, list[Site]]]] = {}
    for path in files():
        kinds = places.setdefault(
            path, collections.defaultdict(lambda: collections.defaultdict(list))
        )
        for site in sites(path.read_text("utf-8")):
            kinds[site.kind][site.start].append(site)
    sizes = {
        path: sum(map(len, kinds.values())) for path, kinds in places.items() if kinds
    }
    order = []
    while sizes and len(order) < 1000:
        path = rng.choices(list(sizes), list(sizes.values()))[0]
        kind = rng.choice(sorted(places[path]))
        start = rng.choice(sorted(places[path][kind]))
        order.append((path, rng.choice(places[path][kind].pop(start))))
        if not places[path][kind]:
            del places[path][kind]
        if not places[path]:
            del sizes[path]
    return order


# --- building -----------------------------------------------------------------------------------------


def commands() -> list[str]:
    """The compiler's commands of an installed build, for the copy."""
    build = next((ROOT / "build").glob("*/build.ninja")).parent
    listed = subprocess.run(  # noqa: S603
        ["ninja", "-C", str(build), "-t", "commands", "_kernels", "_system_kernels"],  # noqa: S607
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    copied = listed.replace(str(ROOT / "csrc"), str(COPY / "csrc"))
    return copied.replace(str(build), str(COPY / "build")).splitlines()


def make_copy() -> None:
    shutil.rmtree(COPY, ignore_errors=True)
    for name in (
        "src",
        "csrc",
        "tests",
        "examples",
        "docs",
        "reproduce",
        "prove",
        "benchmarks",
    ):
        shutil.copytree(
            ROOT / name, COPY / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, COPY)
    build = next((ROOT / "build").glob("*/build.ninja")).parent
    shutil.copytree(build, COPY / "build")
    (COPY / "site").mkdir()
    (COPY / "site" / "sitecustomize.py").write_text(
        "import sys\n"
        "sys.meta_path[:] = [f for f in sys.meta_path"
        " if not type(f).__name__.startswith('ScikitBuild')]\n",
        "utf-8",
    )


def build(source: Path) -> bool:
    """Compile one source of the copy and link what contains it."""
    chosen = [
        line
        for line in commands()
        if f" -c {source}" in line
        or f" -c {source.with_name(source.stem + '_single.c')}" in line
    ]
    links = [line for line in commands() if line.startswith(": &&")]
    if not chosen:
        return True  # the tests compile it themselves
    for line in [*chosen, *links]:
        done = subprocess.run(  # noqa: S602
            line, shell=True, cwd=COPY / "build", capture_output=True, check=False
        )
        if done.returncode:
            return False
    for place, package in (("", "fraclink"), ("fracsys", "fracsys")):
        for library in (COPY / "build" / place).glob("_kernels*.so"):
            target = COPY / "src" / package / library.name
            target.unlink(missing_ok=True)
            shutil.copy(library, target)
    return True


def failed(tests: list[str], marks: str) -> str:
    """The first test that fails in the copy, or an empty text."""
    environment = os.environ | {
        "PYTHONPATH": f"{COPY / 'site'}{os.pathsep}{COPY / 'src'}"
    }
    line = [
        sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", "-p", "no:randomly",
        "--hypothesis-seed=0", "-m", marks, "-k", READS_SOURCES, *tests,
    ]  # fmt: skip
    with (PLACE / "output.txt").open("w+", encoding="utf-8") as output:
        child = subprocess.Popen(  # noqa: S603
            line, cwd=COPY, env=environment, stdout=output, stderr=output,
            start_new_session=True,
        )  # fmt: skip
        try:
            code = child.wait(LIMIT)
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
            return "out of time"
        output.seek(0)
        said = output.read()
    if code in (0, 5):  # 5: none of these tests has this mark
        return ""
    named = re.search(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
    return named[1] if named else f"the run ended with {code}"


def nearest(path: Path) -> list[str]:
    names = TESTS.get(path.stem, REALTIME).split()
    return [f"tests/{name}.py" for name in names]


def judge(path: Path, site: Site) -> tuple[str, str]:
    """("killed", "survived" or "no mutant", by which test)."""
    source = COPY / path.relative_to(ROOT)
    text = path.read_text("utf-8")
    source.write_text(text[: site.start] + site.text + text[site.stop :], "utf-8")
    try:
        check = subprocess.run(  # noqa: S603
            ["gcc", "-fsyntax-only", "-std=gnu11", f"-I{COPY / 'csrc'}", str(source)],  # noqa: S607
            capture_output=True, check=False,
        )  # fmt: skip
        if (check.returncode and path.stem != "fmi3") or not build(source):
            return "no mutant", "the compiler"
        by = failed(nearest(path), "not slow") or failed(nearest(path), "slow")
        return ("killed", by) if by else ("survived", "")
    finally:
        source.write_text(text, "utf-8")
        build(source)


def run(seed: int, count: int, minutes: float) -> None:
    place = PLACE / f"seed-{seed}.json"
    fates = json.loads(place.read_text("utf-8")) if place.exists() else {}
    make_copy()
    build(COPY / "csrc" / "law.c")
    end = time.monotonic() + 60.0 * minutes
    for path, site in draws(seed):
        key = f"{path.relative_to(ROOT)}:{site.start}:{site.text}"
        judged = sum(fate["fate"] != "no mutant" for fate in fates.values())
        if judged >= count or time.monotonic() > end:
            break
        if key in fates:
            continue
        text = path.read_text("utf-8")
        line = text.count("\n", 0, site.start) + 1
        begin = time.monotonic()
        fate, by = judge(path, site)
        fates[key] = {
            "file": str(path.relative_to(ROOT)), "line": line, "kind": site.kind, "fate": fate, "by": by,
            "change": f"{text[site.start : site.stop]}  ->  {site.text}",
            "text": text.splitlines()[line - 1].strip(), "seconds": round(time.monotonic() - begin, 1),
        }  # fmt: skip
        place.write_text(json.dumps(fates, indent=1), "utf-8")


def report(seed: int) -> None:
    """Print the shares by file, and every mutant that no test noticed."""
    every = json.loads((PLACE / f"seed-{seed}.json").read_text("utf-8")).values()
    fates = [fate for fate in every if fate["fate"] != "no mutant"]
    for name in sorted({fate["file"] for fate in fates}):
        ends = [fate["fate"] for fate in fates if fate["file"] == name]
        print(f"{name:36s} {ends.count('killed'):3d} of {len(ends):3d} killed")
    for fate in fates:
        if fate["fate"] == "survived":
            where = f"{fate['file']}:{fate['line']} {fate['kind']}"
            print(f"survived {where}: {fate['change']}   in: {fate['text']}")
    dead = sum(fate["fate"] == "killed" for fate in fates)
    mark = "ok  " if dead >= 0.9 * len(fates) else "MISS"
    print(
        f"{mark} mutants of C killed, seed {seed}   {dead} of {len(fates)}   wanted >= 90 %"
    )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("step", nargs="?", choices=("run", "report"))
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--minutes", type=float, default=60.0)
    given = parser.parse_args()
    PLACE.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if given.step != "report":
        run(given.seed, given.count, given.minutes)
    if given.step != "run":
        report(given.seed)


if __name__ == "__main__":
    main()
