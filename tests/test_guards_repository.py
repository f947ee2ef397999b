"""What the repository states outside its sources: one version, and workflows that match
the tests.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib

import fraclink
from guard_sources import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
WORKFLOWS = ROOT / ".github" / "workflows"


def test_the_version_is_one() -> None:
    # The version of the package itself is read from __init__.py by the build; the
    # others cannot be, and are compared here.
    prove = tomllib.loads((ROOT / "prove" / "pyproject.toml").read_text("utf-8"))[
        "project"
    ]
    citation = re.findall(
        r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE
    )
    recipe = (ROOT / "conda" / "recipe.yaml").read_text("utf-8")
    recipes = re.findall(r'^  version: "(.*)"$', recipe, re.MULTILINE)
    changes = re.findall(
        r"^## (\d\S*)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE
    )
    assert PROJECT["dynamic"] == ["version"]
    others = [prove["version"], *citation, *recipes, changes[0]]
    assert others == [fraclink.__version__] * 4


def test_the_conda_recipe_asks_for_what_the_package_asks_for() -> None:
    recipe = (ROOT / "conda" / "recipe.yaml").read_text("utf-8")
    rows = {
        row.replace(" ", "") for row in re.findall(r"^    - (\S+ >=.*)$", recipe, re.M)
    }
    build = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"]
    assert rows == {*PROJECT["dependencies"], *build["requires"]}


def test_the_matrix_has_every_python_that_is_classified() -> None:
    (listed,) = re.findall(
        r"python: \[(.*)\]", (WORKFLOWS / "ci.yml").read_text("utf-8")
    )
    (built,) = re.findall(
        r'CIBW_BUILD: "(.*)"', (WORKFLOWS / "wheels.yml").read_text("utf-8")
    )
    classified = [
        row.rpartition(" ")[2]
        for row in PROJECT["classifiers"]
        if re.search(r":: 3\.\d+$", row)
    ]
    assert re.findall(r"3\.\d+", listed) == classified
    assert re.findall(r"cp(\d+)-", built) == [
        version.replace(".", "") for version in classified
    ]
    assert PROJECT["requires-python"] == f">={classified[0]}"


def test_a_wheel_is_tested_with_what_its_test_imports() -> None:
    text = (WORKFLOWS / "wheels.yml").read_text("utf-8")
    (given,), (script,) = (
        re.findall(r'CIBW_TEST_REQUIRES: "(.*)"', text),
        re.findall(r"\{project\}/(tests/\w+\.py)", text),
    )
    needed, waiting = set(), [ROOT / script]
    while waiting:
        for node in ast.walk(ast.parse(waiting.pop().read_text("utf-8"))):
            names = (
                [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else []
            )
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in (full.partition(".")[0] for full in names):
                helper = ROOT / "tests" / f"{name}.py"
                if helper.exists():
                    waiting.append(helper)
                elif name not in sys.stdlib_module_names:
                    needed.add({"flint": "python-flint"}.get(name, name))
    with_the_wheel = {
        "fraclink",
        *(re.split(r"\W", row)[0] for row in PROJECT["dependencies"]),
    }
    assert set(given.split()) == needed - with_the_wheel


def test_what_runs_before_a_commit_is_what_make_lint_runs() -> None:
    hooks = re.findall(
        r"entry: \.venv/bin/(.*)$",
        (ROOT / ".pre-commit-config.yaml").read_text("utf-8"),
        re.M,
    )
    told = subprocess.run(
        ["make", "--dry-run", "lint"],  # noqa: S607
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    run = [
        line.removesuffix(" .")
        for line in re.findall(r"^\.venv/bin/((?:ruff|mypy).*)$", told, re.M)
    ]
    # The types of the tests take another minute: they are checked on the server and by
    # `make lint`.
    assert hooks == [line for line in run if "tests/mypy.ini" not in line]
