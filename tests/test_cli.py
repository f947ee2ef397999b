"""The command line: complete output, exit codes, one line per error, no partial files."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer

from fraclink import Rig, __version__, main
from fraclink._cli.app import application


class Answer(NamedTuple):
    """Exit code and both streams."""

    code: int
    out: str
    err: str


Command = Callable[..., Answer]


@pytest.fixture
def fraclink(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Command:
    """Run the command line in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> Answer:
        code = main(arguments)
        streams = capsys.readouterr()
        return Answer(code, streams.out, streams.err)

    return run


DESIGN = (
    "design",
    "--rig",
    "paper-2023",
    "--payloads",
    "0.020",
    "0.040",
    "--gain-crossover",
    "12",
)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--gain-crossover", "twelve"), ("--gain-crossover", "twelve", "rad/s")),
        (("--payloads", "20 g", "40 g"), ("--payloads", "20 g", "kg")),
    ],
)
def test_a_text_that_is_no_number_is_named_with_its_option_and_range(
    fraclink: Command, words: tuple[str, ...], named: tuple[str, ...]
) -> None:
    code, out, line = fraclink("design", "--rig", "paper-2023", *words)
    assert (code, out, line.count("\n")) == (2, "", 1)
    assert all(word in line for word in named)


def test_ctrl_c_says_what_became_of_the_files(
    fraclink: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(path: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("fraclink._cli.models.inspect_log", interrupted)
    code, _, line = fraclink("inspect", "demo")
    assert code == 130
    assert line.startswith("interrupted; ")


def test_a_payload_in_grams_that_the_law_is_given_is_a_doubt(
    fraclink: Command,
) -> None:
    assert fraclink(*DESIGN).code == 0
    answer = fraclink("simulate", "design.json", "--payload", "0.03", "--told", "30")
    assert answer.code == 1
    assert "30 g is 0.030" in answer.out
    assert "next:" not in answer.err


def test_version_and_help(fraclink: Command) -> None:
    assert fraclink("--version") == Answer(0, f"fraclink {__version__}\n", "")
    answer = fraclink("--help")
    assert answer.code == 0
    for name in (
        "run",
        "inspect",
        "diagnose",
        "identify",
        "design",
        "simulate",
        "report",
        "certify",
    ):
        assert f"\n  {name} " in answer.out
    assert "Exit code: 0 passed, 1 failed or not shown, 2 bad input." in answer.out
    assert fraclink().out == answer.out


def test_the_first_page_is_one_screen_and_imports_no_command(fraclink: Command) -> None:
    lines = fraclink("--help").out.splitlines()
    assert len(lines) <= 30 and max(map(len, lines)) <= 80
    code = "import sys; from fraclink._cli import main; main(['--help']); print(*sys.modules)"
    answer = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    loaded = set(answer.stdout.splitlines()[-1].split())
    assert not {name for name in loaded if name.startswith("fraclink._cli.")} & {
        "fraclink._cli.models",
        "fraclink._cli.designs",
        "fraclink._cli.boards",
    }
    assert not loaded & {"scipy", "matplotlib", "jinja2", "fraclink._identify"}


def every_command() -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command with the words that invoke it."""
    top: Any = typer.main.get_command(application())
    context = typer.Context(top)
    for name in top.list_commands(context):
        command = top.get_command(context, name)
        if hasattr(command, "commands"):
            yield from (
                ((name, inner), found) for inner, found in command.commands.items()
            )
        else:
            yield (name,), command


@pytest.mark.slow
def test_every_command_has_an_example_that_it_understands(fraclink: Command) -> None:
    listed = fraclink("help").out
    for words, command in every_command():
        example = command.help.partition("\n\n$ ")[2]
        assert (
            example.startswith(" ".join(("fraclink", *words))) and "\n" not in example
        ), words
        # Printed in one piece for copying: the help is wrapped at 80 columns.
        assert f"  $ {example}\n" in fraclink("help", *words).out
        given = shlex.split(example)[1 + len(words) :]
        # raises for an option that does not exist
        command.make_context(words[-1], given)
        assert words[0] in listed


def test_no_command_passes_without_having_done_what_it_was_asked(
    fraclink: Command,
) -> None:
    """With the lowest version of typer declared earlier, every command printed the
    version and exited with code 0.
    """
    for words, _command in every_command():
        answer = fraclink(*words, "--no-such-option")
        assert answer.code == 2, (words, answer.out)
        assert "--no-such-option" in answer.err, (words, answer.err)


@pytest.mark.slow
def test_the_shell_completes_commands() -> None:
    given = {"COMP_WORDS": "fraclink des", "COMP_CWORD": "1"}
    environment = os.environ | given | {"_FRACLINK_COMPLETE": "complete_bash"}
    answer = subprocess.run(
        [sys.executable, "-m", "fraclink"],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert "design" in answer.stdout
    assert "inspect" not in answer.stdout


@pytest.mark.slow
def test_json_is_the_only_thing_on_standard_output(fraclink: Command) -> None:
    answer = fraclink(
        *DESIGN, "--phase-margin-deg", "50", "--filter-time", "0", "--json"
    )
    result = json.loads(answer.out)
    assert answer.out.count("\n") == 1
    assert result["passed"] is True
    assert result["controller"]["derivative_gain"] > 0
    assert {item["name"] for item in result["requirements"]} >= {
        "gain crossover",
        "phase margin",
        "phase margin, shipped law",
    }


@pytest.mark.slow
def test_an_existing_file_is_kept_without_force(
    fraclink: Command, tmp_path: Path
) -> None:
    place = tmp_path / "design.json"
    place.write_text("mine")
    answer = fraclink(*DESIGN)
    assert answer == Answer(
        2,
        "",
        "error: out: already there (got design.json); expected a new name. "
        "Choose another name or add --force.\n",
    )
    assert place.read_text() == "mine"
    assert fraclink(*DESIGN, "--force").code == 0
    assert place.read_text() != "mine"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "crossover", "margin"),
    # the law of the nearest loop of the second misses what its design keeps
    [("paper-2023", "30", "80"), ("paper-2023-geared", "60", "70")],
)
def test_an_infeasible_request_is_exit_code_1_and_writes_nothing(
    fraclink: Command, tmp_path: Path, rig: str, crossover: str, margin: str
) -> None:
    asked = ("--gain-crossover", crossover, "--phase-margin-deg", margin)
    arguments = ("design", "--rig", rig, *asked)
    answer = fraclink(*arguments)
    assert answer.code == 1
    # Which of the two requirements is reported depends on the search.
    refusal = r"✗ failed: (gain crossover|phase margin|loop gain at mode 2): at \d+ g at (mo|lea)st "
    assert re.match(refusal, answer.err)
    assert "nearest feasible: --gain-crossover" in answer.err
    assert answer.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
    nearest = answer.err.partition("nearest feasible: ")[2].split()
    assert {"--phase-margin-deg", "--gain-crossover"} <= set(nearest)
    again = fraclink("design", "--rig", rig, *nearest)  # pasted as printed
    assert again.out.startswith("✓ passed: ")
    (tmp_path / "design.json").unlink()
    told = json.loads(fraclink(*arguments, "--json").out)
    assert told["exit"] == 1
    assert 0 < told["error"]["nearest"]["phase_margin"] < 1.3963


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("design", "--rig", "paper-2032"),
            ("rig: unknown (got paper-2032)", "Did you mean 'paper-2023'?"),
        ),
        (("design", "--rig", "missing.toml"), ("missing.toml", "not a file")),
        (
            (*DESIGN, "--phase-margin-deg", "200"),
            ("phase_margin_deg: out of range (got 200.0)", "expected", "179"),
        ),
        (
            (*DESIGN, "--phase-margin-deg", "-5"),
            ("phase_margin_deg: out of range (got -5.0)", "expected"),
        ),
        (
            ("design", "--rig", "paper-2023", "--payloads", "0.04", "0.02"),
            ("payloads", "expected"),
        ),
        (
            ("design", "--rig", "paper-2023", "--payloads", "0", "0.02"),
            ("payloads", "expected"),
        ),
        (
            ("design", "--rig", "paper-2023", "--payloads", "nan", "0.02"),
            ("payloads", "expected"),
        ),
        (
            ("design", "--rig", "paper-2023", "--gain-crossover", "1e300"),
            ("gain_crossover", "expected"),
        ),
        (
            ("design", "--rig", "paper-2023", "--filter-order", "3"),
            ("filter_order", "expected"),
        ),
        (("design", "--rig", "paper-2023", "--payloads", "0.02"), ("--payloads",)),
        (("design", "--rig", "paper-2023", "--gain", "12"), ("--gain",)),
        (("design",), ("Missing option '--rig'",)),
        (("desing",), ("No such command 'desing'",)),
        (
            ("simulate", "nothing.json", "--payload", "0.02"),
            ("not there (got nothing.json)",),
        ),
        (("certify", "nothing.json"), ("not there (got nothing.json)",)),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    fraclink: Command,
    tmp_path: Path,
    arguments: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    answer = fraclink(*arguments)
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("error: ")
    assert answer.err.count("\n") == 1
    assert "Traceback" not in answer.err
    for word in words:
        assert word in answer.err
    assert list(tmp_path.iterdir()) == []


def test_errors_are_json_too_where_json_was_asked_for(fraclink: Command) -> None:
    answer = fraclink("design", "--rig", "paper-2032", "--json")
    told = json.loads(answer.out)
    assert answer.code == told["exit"] == 2
    assert told["error"]["field"] == "rig"
    assert told["error"]["value"] == "paper-2032"
    assert told["error"]["remedy"]


@pytest.mark.parametrize(
    "name",
    [
        "\x1b[31mred\x1b[0m",
        "\x1b]0;title\x07",
        "a\rb",
        "a\nb",
        "\u202etxt",
        "\x9b2J",
        "\x00",
    ],
)
def test_names_cannot_drive_the_terminal(fraclink: Command, name: str) -> None:
    answer = fraclink("design", "--rig", name)
    assert answer.code == 2
    line = answer.err.removesuffix("\n")
    assert line.isprintable()
    assert json.loads(fraclink("design", "--rig", name, "--json").out)["exit"] == 2


@pytest.mark.slow
def test_the_module_is_the_command() -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "fraclink", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout == f"fraclink {__version__}\n"


def test_a_rig_without_a_model_says_what_to_do(
    fraclink: Command, tmp_path: Path
) -> None:
    text = Rig.named("paper-2023")
    text.save(tmp_path / "rig.toml")
    kept = (tmp_path / "rig.toml").read_text().partition("[model]")
    rest = kept[2].partition("[design]")
    (tmp_path / "rig.toml").write_text(kept[0] + "[design]" + rest[2])
    answer = fraclink("design", "--rig", "rig.toml")
    assert answer.code == 2
    assert "Identify a log first" in answer.err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "simulate design.json --payload 0.03 --reference p.csv --amplitude 0",
            "amplitude: given beside --reference (got 0.0)",
        ),
        (
            "simulate design.json --on twin --reference p.csv --move-time 1",
            "move_time: given beside --reference (got 1.0)",
        ),
        (
            "run-realtime design.json --io udp:127.0.0.1:9 --reference p.csv --amplitude 1",
            "amplitude: given beside --reference (got 1.0)",
        ),
    ],
)
def test_an_option_without_effect_is_refused(
    fraclink: Command, tmp_path: Path, line: str, said: str
) -> None:
    assert fraclink(*DESIGN, "--out", "design.json").code == 0
    (tmp_path / "p.csv").write_text("time_s,angle_rad\n0,0\n0.7,1\n")
    answer = fraclink(*line.split())
    assert answer.code == 2
    assert said in " ".join(answer.err.split()) and "Leave out --" in answer.err
    assert [
        place.name
        for place in tmp_path.iterdir()
        if place.name not in ("design.json", "p.csv")
    ] == []
