"""How a command is declared, what it says where, and the options that several share."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict, Unpack

import numpy as np
import pytest
import typer

from command_line import RIG, made_design
from fraclink._cli import console, options
from fraclink._cli.app import group
from fraclink._cli.command import Answer, Declared, Default, Writes, command
from fraclink._identify import identify
from fraclink._reading.reading import bundled_log, read_log
from fraclink.errors import FieldError
from fraclink.findings import Finding
from fracsys.checks import Between

# --- the decorator ---------------------------------------------------------------------------------------


class Extra(TypedDict):
    """Options that stand in a group."""

    flag: Annotated[bool, "A flag"]
    usual: Annotated[float | None, "With a default of its own", Default(2.5)]
    none: Annotated[str | None, "Left out"]


def application(seen: dict[str, Any], answer: Answer) -> Callable[..., int]:
    """A command with an option of every kind."""
    app = group()

    @command(app)
    def sample(
        place: Annotated[Path, typer.Argument(metavar="PLACE"), "A place"],
        size: Annotated[float, Between(0.0, 10.0, "m"), "Its size."] = 1.0,
        kind: Annotated[Literal["a", "b"], "One of two"] = "a",
        many: Annotated[list[str] | None, "Words"] = None,
        on: Annotated[bool, "On by default"] = True,
        out: Annotated[Path | None, "Folder", Writes(("one", "two"))] = None,
        **extra: Unpack[Extra],
    ) -> Answer:
        """Do nothing."""
        seen.update(
            place=place, size=size, kind=kind, many=many, on=on, out=out, **extra
        )
        return answer

    def run(*words: str) -> int:
        work = lambda: typer.main.get_command(app)(  # noqa: E731
            args=list(words), standalone_mode=False
        )
        return console.guarded(work, as_json="--json" in words)

    return run


def test_a_parameter_is_an_option_with_help_range_and_default(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    seen: dict[str, Any] = {}
    run = application(seen, Answer(text="done"))
    assert run("p") == 0
    usual = {
        "place": Path("p"),
        "size": 1.0,
        "kind": "a",
        "many": None,
        "on": True,
        "out": None,
    }
    assert seen == usual | {"flag": False, "usual": 2.5, "none": None}
    assert (
        run(
            "p",
            "--no-on",
            "--flag",
            "--many",
            "x",
            "--many",
            "y",
            "--kind",
            "b",
            "--none",
            "n",
        )
        == 0
    )
    assert seen["on"] is False and seen["flag"] is True
    assert (seen["many"], seen["kind"], seen["none"]) == (["x", "y"], "b", "n")
    capsys.readouterr()
    assert run("p", "--size", "11") == 2
    assert (
        "size: out of range (got 11.0); expected 0 to 10 m" in capsys.readouterr().err
    )
    assert run("p", "--size", "10") == 0 and seen["size"] == 10.0
    (tmp_path / "two").touch()
    capsys.readouterr()
    assert run("p", "--out", str(tmp_path)) == 2
    assert "already there" in capsys.readouterr().err
    assert run("p", "--out", str(tmp_path), "--force") == 0
    (tmp_path / "two").rename(tmp_path / "three")
    assert run("p", "--out", str(tmp_path)) == 0
    capsys.readouterr()
    run("--help")
    shown = " ".join(capsys.readouterr().out.split())
    for words in (
        "Its size, 0 to 10 m.",
        "Words; may be repeated.",
        "--on --no-on",
        "On by default.",
    ):
        assert words in shown.replace(" / ", " ").replace("|", ""), words
    assert "--flag" in shown and "--no-flag" not in shown


def test_a_declared_parameter_knows_its_marks() -> None:
    plain = Declared("x", int, int, 3)
    assert plain.mark(str) is None and not plain.ranged
    kind = Annotated[float, "Text", Between(0.0, 1.0)]
    ranged = Declared("long_name", float, kind, 0.5)
    assert ranged.mark(str) == "Text" and ranged.ranged and ranged.mark(Writes) is None
    parameter = ranged.parameter
    assert (parameter.name, parameter.default, parameter.kind.name) == (
        "long_name",
        0.5,
        "KEYWORD_ONLY",
    )
    info = parameter.annotation.__metadata__[0]
    assert info.param_decls == ("--long-name",) and info.help.startswith("Text, ")
    flag = Declared(
        "wide_open", bool, Annotated[bool, "F"], True
    ).parameter.annotation.__metadata__[0]
    assert flag.param_decls == ("--wide-open/--no-wide-open",)


def test_what_is_said_goes_to_its_stream_in_order(
    capsys: pytest.CaptureFixture[str],
) -> None:
    answer = Answer(
        text="result",
        remarks=("note",),
        written=(Path("a"), Path("b")),
        following="fraclink next",
        values={"x": 1},
    )
    application({}, answer)("p")
    told = capsys.readouterr()
    assert told == ("result\n", "note\nwritten: a\nwritten: b\nnext: fraclink next\n")
    application({}, answer)("p", "--json")
    told = capsys.readouterr()
    assert told.err == "" and json.loads(told.out) == {"x": 1, "out": ["a", "b"]}
    application({}, replace(answer, written=(Path("a"),)))("p", "--json")
    assert json.loads(capsys.readouterr().out) == {"x": 1, "out": "a"}
    application({}, replace(answer, values={"out": "mine"}))("p", "--json")
    assert json.loads(capsys.readouterr().out)["out"] == "mine"
    application({}, Answer())("p")
    assert capsys.readouterr() == ("", "")
    application({}, Answer())("p", "--json")
    assert json.loads(capsys.readouterr().out) == {}
    finding = Finding("W100", "error", "bad", {}, "mend it")
    application({}, Answer(result=(finding,), doubts=(finding,)))("p", "--json")
    assert [one["code"] for one in json.loads(capsys.readouterr().out)["findings"]] == [
        "W100"
    ] * 2


# --- shared options --------------------------------------------------------------------------------------


def test_options_are_repeated_as_the_shell_reads_them() -> None:
    given = {
        "payload": 0.03,
        "column": ["motor_angle=th [deg]", "torque=-g"],
        "keep": (1.5, 20.0),
        "resample": True,
        "interpolate": False,
        "other": None,
        "some_zero": 0.0,
    }
    assert options.as_stated(given) == (
        " --payload 0.03 --column 'motor_angle=th [deg]' --column torque=-g --keep 1.5 20 --resample"
        " --some-zero 0"
    )
    assert options.as_stated({"column": None}) == ""


def test_a_margin_in_degrees_becomes_one_in_radians() -> None:
    made = options.in_radians({"phase_margin_deg": 90.0, "gain_crossover": 12.0})
    assert made == {"phase_margin": math.pi / 2, "gain_crossover": 12.0}
    assert options.in_radians({"phase_margin_deg": None}) == {"phase_margin": None}


def test_a_model_comes_from_a_model_or_a_design(tmp_path: Path) -> None:
    place = tmp_path / "design.json"
    other = replace(made_design(), model=replace(made_design().model, order=1.8))
    other.save(place)
    assert options.load_link_model(None) is None
    assert options.load_link_model(place) == other.model
    assert options.load_rig("paper-2023", model=place).model == other.model
    assert options.load_doubts(None) == () == options.load_doubts(place)
    # A design carries its model, and another one is put into its rig.
    assert options.load_design(place).rig.model == RIG.model
    assert options.load_design(place, model=place).rig.model == other.model
    # A fit of a deflection does not know the stiffness: the rig does, for every command
    # that takes both.
    log = read_log(bundled_log("prbs_30g"), rig=RIG)
    angles = replace(log, output=log.output / 1.6, output_kind="deflection")
    fit = identify(angles, "UD-FOM", details=False)
    fitted = tmp_path / "model.json"
    fit.save(fitted)
    assert options.load_link_model(fitted) == fit.model and fit.model.stiffness == 1.0
    assert options.load_link_model(fitted, RIG) == replace(fit.model, stiffness=1.56)
    assert options.load_rig("paper-2023", model=fitted).model.stiffness == 1.56  # type: ignore[union-attr]
    bare = tmp_path / "bare.json"
    replace(other, rig=replace(RIG, model=None)).save(bare)
    assert options.load_design(bare).rig.model == other.model
    assert options.load_design(place).rig.motor.gear_ratio == RIG.motor.gear_ratio
    assert (
        options.load_design(place, gear=50.0).rig.motor.gear_ratio
        == 50.0 * RIG.motor.gear_ratio
    )
    arm = options.load_arm(
        place, {"payload": 0.025, "link_mass": 0.007, "gear": None, "model": None}
    )[1]
    assert (arm.beam.payload, arm.beam.link_mass) == (0.025, 0.007)


def test_a_payload_in_grams_is_doubted_once() -> None:
    made = made_design()
    assert options.doubts_of_move(made, 0.03, None) == ()
    assert len(options.doubts_of_move(made, 30.0, 30.0, 0.03)) == 1


def test_a_move_is_that_of_the_file_or_the_usual_one(tmp_path: Path) -> None:
    usual = options.reference_of(None, None, None)
    assert (usual.duration, float(usual.angle(np.array([5.0]))[0])) == (1.0, 1.0)
    assert options.reference_of(None, None, None, usual_time=0.5).duration == 0.5
    given = options.reference_of(None, 0.0, 0.7)
    assert (given.duration, float(given.angle(np.array([5.0]))[0])) == (0.7, 0.0)
    (tmp_path / "p.csv").write_text("time_s,angle_rad\n0,0\n0.7,1\n")
    assert options.reference_of(
        tmp_path / "p.csv", None, None
    ).duration == pytest.approx(0.7)
    with pytest.raises(FieldError, match="move_time: given beside --reference"):
        options.reference_of(tmp_path / "p.csv", None, 0.0)
    with pytest.raises(
        FieldError,
        match=r"link_mass: given beside --on \(got a\.csv\).*--link-mass or --on",
    ):
        options.refuse_beside("--on", "nothing", gear=None, link_mass=Path("a.csv"))


def test_a_payload_is_told_or_estimated() -> None:
    made = made_design()
    assert options.told_or_estimated(made, 0.03, False) == 0.03
    assert options.told_or_estimated(made, 0.0, True) == made.estimator()
    with pytest.raises(FieldError, match="told: given beside --estimate"):
        options.told_or_estimated(made, 0.03, True)


def test_a_recording_needs_both_columns_and_demo_is_the_bundled_log() -> None:
    assert options.named_channels("u", "y") == ("u", "y")
    for given, name in ((("u", None), "output"), ((None, "y"), "input")):
        with pytest.raises(FieldError, match=f"{name} is required"):
            options.named_channels(*given)
    assert options.log_path("demo") == bundled_log("prbs_30g")
    assert options.log_path("demo.csv") == Path("demo.csv")
    log = options.load_log(
        "demo",
        RIG,
        [
            "time=time_s [s]",
            "motor_angle=motor_angle_rad [rad]",
            "torque=-torque_Nm [Nm]",
        ],
        0.04,
    )
    right = options.load_log("demo", RIG)
    assert log.payload == 0.04 and np.array_equal(log.output, -right.output)
