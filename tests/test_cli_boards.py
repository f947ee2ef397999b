"""Boards, arms, campaigns: each option reaches the call that it is for, and the next
command is named.

The work itself is left out: in its place stands a function that keeps what it was
called with.
"""

from __future__ import annotations

import io
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from command_line import RIG, Found, Line, made_design, prepared
from fraclink import _kernels
from fraclink._cli import console, main
from fraclink._reading.reading import bundled_log
from fraclink.errors import LogError
from fraclink.lab._connections import Udp


@pytest.fixture
def line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Line:
    """The command line in a folder with a design and a log."""
    return prepared(monkeypatch, capsys, tmp_path)


# --- boards ----------------------------------------------------------------------------------------------


def test_an_fmu_has_a_library_of_each_compiler_or_none(line: Line) -> None:
    written = line.hear("boards.export_fmu", Path("a.fmu"))
    assert line("export fmu design.json --out a.fmu") == (0, "a.fmu\n", "")
    assert written.given[0].drive is not None and written.given[1] == Path("a.fmu")
    assert written.last == {
        "precision": "single",
        "compilers": ("cc",),
        "force": False,
    }
    line(
        "export fmu design.json --precision single --compiler gcc --compiler clang --force"
    )
    assert written.last == {
        "precision": "single",
        "compilers": ["gcc", "clang"],
        "force": True,
    }
    line("export fmu design.json --source --compiler gcc")
    assert written.last["compilers"] == ()


def test_a_replay_takes_the_arms_log_or_two_columns(line: Line) -> None:
    found = Found()
    replayed = line.hear("boards.replay_log", found)
    read = line.hear("boards.load_log", "log")
    told = line("replay f log.csv --column torque=x --allow-changed")
    assert told == (0, "", "f/law.c was compiled and run on this computer\n")
    assert (
        read.given[0] == "log.csv"
        and read.given[1].name == "paper-2023"
        and read.given[2] == ["torque=x"]
    )
    assert replayed.given == (Path("f"), "log") and replayed.last == {
        "allow_changed": True
    }
    recorded = line.hear("boards.read_recording", "recording")
    found.passed = False
    assert line("replay f log.csv --input r --output y").code == 1
    assert recorded.given == (Path("log.csv"), "r", "y")
    assert replayed.given[1] == "recording" and replayed.last == {
        "allow_changed": False
    }
    assert line("replay f log.csv --output y").code == 2


realtime = pytest.mark.skipif(
    not _kernels.REALTIME, reason="the real-time loop is Linux's"
)


class Run(Found):
    """A run in real time that was granted nothing."""

    scheduling, memory, lost = "refused (Operation not permitted)", "locked", False

    def __init__(self, saved: str) -> None:
        super().__init__()
        self.saved = saved  # type: ignore[assignment]

    def experiment(self) -> Found:
        if self.lost:
            raise LogError(
                "run", "9 of 99 samples", "lost", allowed="1 %", remedy="run it again"
            )
        return Found()


@realtime
def test_an_arm_is_served_as_asked(line: Line) -> None:
    served = Run("")
    asked = line.hear("boards.lab.serve_arm", served)
    saved = line.hear("boards.saved", Path("a.npz"))
    words = "serve-arm design.json --io udp:127.0.0.1:5005 --duration 9 --watchdog 5 --once --seed 3 --priority 20"
    told = line(f"{words} --payload 0.025 --link-mass 0.008 --out a.npz")
    arm, way, period = asked.given
    assert (arm.beam.payload, arm.beam.link_mass, way, period) == (
        0.025,
        0.008,
        Udp("127.0.0.1", 5005),
        RIG.period,
    )
    wanted = {"duration": 9.0, "watchdog": 5, "once": True, "seed": 3, "priority": 20}
    assert asked.last.items() >= wanted.items()
    assert (
        f"an arm at udp:127.0.0.1:5005, {1e3 * RIG.period:g} ms\n" in told.err
        and told.err.endswith("written: a.npz\n")
    )
    assert saved.given == (served, Path("a.npz")) and saved.last == {}
    served.passed = False
    assert (
        line("serve-arm design.json --io udp:127.0.0.1:5005").code == 1
        and len(saved) == 1
    )
    usual = {"duration": 600.0, "watchdog": 10, "once": False, "seed": 0}
    assert asked.last.items() >= (usual | {"priority": 70}).items()


# --- tuning ----------------------------------------------------------------------------------------------


LIMITS = "--angle-deg 30 --speed 3 --torque 2 --voltage 8"


@realtime
def test_a_tuning_is_planned_from_the_options_and_moves_after_a_yes(line: Line) -> None:
    found = fl.lab.Tuning(
        fl.MotionLimits(0.5, 3.0, 2.0, 8.0),
        0.03,
        (0.02, 0.04),
        0.004,
        stopped="by hand",
    )
    asked = line.hear("tunings.tune_arm", found)
    words = f"tune --io udp:127.0.0.1:5005 --payload 0.03 --payloads 0.02 0.04 {LIMITS} --rig paper-2023 --out t"
    told = line(f"{words} --period-ms 5 --yes --no-moves --force")
    way, plan = asked.given
    assert way == Udp("127.0.0.1", 5005)
    limits = fl.MotionLimits(
        angle=math.radians(30.0), speed=3.0, torque=2.0, voltage=8.0
    )
    assert plan == fl.TuningPlan(limits, 0.03, (0.02, 0.04), 0.005, RIG)
    begin = asked.last.pop("begin")
    assert begin is console.tell
    assert asked.last == {
        "out": Path("t"),
        "resume": False,
        "force": True,
        "moves": False,
    }
    assert told.code == 1 and plan.text in told.err
    assert told.err.endswith(
        "next: fraclink tune --io udp:127.0.0.1:5005 --out t --resume\n"
    )
    line(f"tune --io udp:127.0.0.1:5005 --payload 0.03 {LIMITS} --yes --out u")
    plan = asked.given[1]
    assert (plan.payloads, plan.period, plan.rig) == (None, None, None)
    assert asked.last["moves"] is True and asked.last["out"] == Path("u")

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    before = len(asked)
    line.patch.setattr(sys, "stderr", Terminal())
    line.patch.setattr(sys, "stdin", Terminal("no\n"))
    assert (
        main(
            ["tune", "--io", "udp:127.0.0.1:5005", "--payload", "0.03", *LIMITS.split()]
        )
        == 1
    )
    assert len(asked) == before  # nothing was moved
    line.patch.setattr(sys, "stdin", Terminal("3\n2\n8\n0.03\ny\n"))
    assert main(["tune", "--io", "udp:127.0.0.1:5005", "--angle-deg", "30"]) == 1
    assert asked.given[1] == fl.TuningPlan(limits, 0.03)


@realtime
def test_a_tuning_that_is_there_is_kept_or_resumed(line: Line) -> None:
    limits = fl.MotionLimits(
        angle=math.radians(30.0), speed=3.0, torque=2.0, voltage=8.0
    )
    before = fl.lab.Tuning(limits, 0.03, (0.02, 0.04), 0.004, rig=RIG)
    Path("t").mkdir()
    fl.save(before, Path("t/tuning.json"))
    asked = line.hear("tunings.tune_arm", before)
    told = line(f"tune --io udp:127.0.0.1:5005 --payload 0.03 {LIMITS} --yes --out t")
    assert told.code == 2 and "already there" in told.err and not asked
    told = line("tune --io udp:127.0.0.1:5005 --yes --out t --resume --speed 2")
    wanted = replace(limits, speed=2.0)
    assert asked.given[1] == fl.TuningPlan(wanted, 0.03, (0.02, 0.04), None, RIG)
    assert asked.last["resume"] is True and "of these only" not in told.err
    told = line(
        "tune --io udp:127.0.0.1:5005 --yes --out t --resume --payload 0.035 --payloads 0.03 0.05"
    )
    assert asked.given[1].payload == 0.035 and asked.given[1].payloads == (0.03, 0.05)
    assert "of these only the wiring and the first moves, with 35 g" in told.err
    assert f"written: {Path('t/tuning.json')}" in told.err


@realtime
def test_a_record_is_watched_against_the_tuning_of_its_folder(line: Line) -> None:
    log = fl.read_log(bundled_log("prbs_30g"), rig=RIG)
    fl.save(log, Path("log.npz"))
    before = fl.lab.Tuning(
        fl.MotionLimits(0.5, 3.0, 2.0, 8.0), 0.03, (0.02, 0.04), 0.004
    )
    Path("t").mkdir()
    fl.save(before, Path("t/tuning.json"))
    seen = Found()
    watched = line.hear("tunings.watch_arm", seen)
    for place in ("t", "t/tuning.json"):
        assert line(f"watch log.npz --tuned {place}") == (0, "", "")
        assert np.array_equal(watched.given[0].motor_angle, log.motor_angle)
        assert watched.given[1].payload == 0.03
    seen.passed = False
    told = line("watch log.npz --tuned t")
    assert (told.code, told.err) == (
        1,
        "next: fraclink tune --io ADDRESS --payload KG --out retuned\n",
    )
    told = line("watch design.json --tuned t")
    assert (
        told.code == 2
        and "record: neither (got design.json); expected a run in real time, or a log"
        in told.err
    )


# --- the others ------------------------------------------------------------------------------------------


def test_a_move_is_shaped_as_asked(line: Line) -> None:
    move = Found()
    move.reference, move.period, move.payloads = "reference", 0.004, (0.02, 0.04)  # type: ignore[attr-defined]
    shaped = line.hear("moves.shape_move", move)
    table = line.hear("moves.export_reference", Path("m.csv"))
    words = "shape design.json --amplitude 0.5 --payloads 0.01 0.03 --told --voltage 8 --speed 3 --torque 2"
    told = line(
        f"{words} --reserve 0.3 --gauge-offset 0.01 --seeds 4 --table m.csv --out s.json --link-mass 0.007"
    )
    assert (
        shaped.given == (made_design(), 0.5)
        and shaped.last.pop("arm").beam.link_mass == 0.007
    )
    assert shaped.last == {
        "on": "twin", "payloads": (0.01, 0.03), "told": True, "voltage": 8.0, "speed": 3.0, "torque": 2.0,
        "reserve": 0.3, "gauge_offset": 0.01, "seeds": 4,
    }  # fmt: skip
    assert table.given == ("reference", Path("m.csv")) and table.last == {
        "period": 0.004,
        "force": True,
    }
    following = "fraclink campaign montecarlo --design design.json --reference s.json --told --out moves"
    assert told == (0, "", f"written: s.json\nwritten: m.csv\nnext: {following}\n")
    told = line("shape design.json --payload 0.025 --on model --force --out s.json")
    assert shaped.last["payloads"] == (0.025, 0.025) and shaped.last["arm"] is None
    assert (
        shaped.given[1] == 1.0
        and shaped.last["told"] is False
        and "--told" not in told.err
        and len(table) == 1
    )
    move.payloads = (30.0, 30.0)  # type: ignore[attr-defined]
    assert line("shape design.json --force --out s.json").code == 1
    for more, said in (
        (
            "--payload 0.02 --payloads 0.01 0.03",
            "payload: given beside payloads (got 0.02)",
        ),
        (
            "--on model --model design.json",
            "model: given beside --on model (got design.json)",
        ),
    ):
        told = line(f"shape design.json --force {more}")
        assert told.code == 2 and said in told.err


def test_the_manual_is_installed_where_man_looks(line: Line) -> None:
    assert (
        line("man --out fraclink.1").err
        == "written: fraclink.1\nnext: man -l fraclink.1\n"
    )
    Path("man1").mkdir()
    assert (
        line("man --out man1/fraclink.1").err
        == "written: man1/fraclink.1\nnext: man fraclink\n"
    )
    page = json.loads(line("man --json").out)["page"]
    assert page == Path("fraclink.1").read_text("utf-8") == line("man").out
    lines = page.splitlines()
    sentence = "from the log of a flexible\\-link robot to the fractional\\-order controller on its board"
    assert lines[3] == f"fraclink \\- {sentence}"
    at = {
        line.removeprefix(".SH ").removeprefix(".SS "): k
        for k, line in enumerate(lines)
    }
    assert (
        at["NAME"]
        < at["SYNOPSIS"]
        < at["DESCRIPTION"]
        < at["COMMANDS"]
        < at["EXIT STATUS"]
        < at["ENVIRONMENT"]
    )
    assert lines[at["EXIT STATUS"] + 1 : at["EXIT STATUS"] + 4] == [
        ".TP",
        ".B 0",
        "what was asked for passed",
    ]
    assert lines[at["SEE ALSO"] + 1].startswith("fraclink help all")
    inspect = lines[at['"fraclink inspect LOG"'] :]
    assert inspect[1] == ".PP" and inspect[2].startswith(
        "List a log's channels, rates and ranges"
    )
    assert inspect[3:7] == [".PP", ".EX", "$ fraclink inspect log.csv", ".EE"]
    assert '"fraclink export c DESIGN"' in at
