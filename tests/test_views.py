"""What people read of a result: every word and number of its headline, tables and
notes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import fraclink as fl
from fraclink._campaign.faults import Case, Check, FaultTable, Outcome
from fraclink._design import Requirement
from fraclink._show import tables, words
from fraclink._show.records import plain, to_json
from fraclink._show.text import (
    Table,
    View,
    degrees,
    folded,
    grams,
    marked,
    milli,
    number,
    option,
    plain_text,
    quantity,
    sentence,
    table_text,
    uncertain,
)
from fraclink._show.views import faults_page, repeated, rival_sentences, view
from fraclink.findings import Finding, Scope, Verdict

RIG = fl.Rig.named("paper-2023")
WARNED = Finding(
    "W210", "warning", "the gauge has an offset", {"offset": 0.1}, "subtract it"
)
TOLD = Finding("W305", "info", "the residual is not white", {"share": 0.5})
WRONG = Finding("W399", "error", "the model predicts nothing", {}, "record again")


def made(kind: str, /, **attributes: Any) -> Any:
    """A result of a class of that name, with only what is shown of it."""
    return type(kind, (SimpleNamespace,), {})(**attributes)


# --- numbers ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("shown", "wanted"),
    [
        (number(0.001), "0.001"),
        (number(0.0009996), "9.996×10⁻⁴"),
        (number(-0.00012345678, 3), "−1.23×10⁻⁴"),
        (number(1000.0, 2), "1×10³"),
        (number(99999.0), "1×10⁵"),
        (number(-math.inf), "−∞"),
        (number(2.5e-12, 1), "2×10⁻¹²"),
        (uncertain(116.4, 12.0), "116 ± 12"),
        (uncertain(116.4, 9.6), "116.4 ± 9.6"),
        (uncertain(5.0, 5.0), "undetermined"),
        (uncertain(-5.0, 4.999), "−5.0 ± 5.0"),
        (uncertain(5.0, 0.0), "5"),
        (uncertain(5.0, -1.0), "5"),
        (uncertain(1.0, 1e-8), "1.000000000 ± 0.000000010"),
        (uncertain(1.0, 1e-9), "1 ± 1×10⁻⁹"),
        (uncertain(1e6, 10.0), "1×10⁶ ± 10"),
        (uncertain(999999.0, 10.0), "999999 ± 10"),
        (grams(None), "–"),
        (grams(0.020), "20 g"),
        (milli(None), "–"),
        (milli(math.inf), "–"),
        (milli(-0.04), "−40.0"),
        (degrees(None), "–"),
        (degrees(-math.radians(0.04)), "0.0°"),  # what rounds to nothing has no sign
        (degrees(-math.radians(0.06)), "−0.1°"),
        (number(-0.0), "0"),
        (degrees(math.nan), "–"),
        (degrees(-math.pi, 0), "−180°"),
        (quantity(0.5, ""), "0.5"),
        (quantity(None, "rad"), "–"),
        (option("mode_gain", 0.5), "--mode-gain 0.501"),
        (option("noise_gain", 2.1001), "--noise-gain 2.101"),
        (sentence(""), ""),
        (sentence("why?"), "Why?"),
        (sentence("as follows:"), "As follows:"),
        (sentence("fraclink is silent"), "fraclink is silent."),
        (sentence("end. of it"), "End. of it."),
        (sentence(" gain_crossover is missing "), "gain_crossover is missing."),
        (marked("missed"), "✗ missed"),
        (marked("not shown"), "! not shown"),
        (marked("missing"), "! missing"),
        (marked("not run"), "– not run"),
        (marked("undecided"), "undecided"),
    ],
)
def test_a_quantity_is_written_as_people_read_it(shown: str, wanted: str) -> None:
    assert shown == wanted


# --- tables and views as text -----------------------------------------------------------------------------


def test_a_view_is_its_verdict_its_tables_and_its_notes() -> None:
    table = Table(
        ("what", "value", "verdict"),
        (("gain", "1.5", "passed"), ("margin", "−20.0°", "missed")),
    )
    judged = replace(table, judged=True)
    assert judged.shown == (
        ("gain", "1.5", "✓ passed"),
        ("margin", "−20.0°", "✗ missed"),
    )
    assert table.shown == table.rows
    shown = View(
        "two of two", (judged, Table(("a",), ())), ("a note", "another"), "failed"
    )
    assert str(shown) == (
        "✗ failed: two of two\n\n"
        "what     value  verdict\n"
        "gain       1.5  ✓ passed\n"
        "margin  −20.0°  ✗ missed\n\n"
        "a note\nanother"
    )
    assert plain_text(View(state="passed")) == "✓ passed"
    assert plain_text(View("only words")) == "only words"
    assert plain_text(View()) == ""
    assert plain_text(View("a b c", state="passed"), 12) == "✓ passed: a\n  b c"


def test_a_view_of_a_doubtful_input_shows_nothing() -> None:
    shown = View("done", notes=("kept",), state="passed")
    assert shown.doubted(()) is shown
    doubted = shown.doubted((WRONG,))
    assert (doubted.headline, doubted.state) == (
        "the input is in doubt; done",
        "not shown",
    )
    assert doubted.notes == (
        "W399 error: the model predicts nothing; record again",
        "kept",
    )


def test_a_notebook_gets_the_same_escaped() -> None:
    table = Table(("a<b", "verdict"), (("1 & 2", "passed"),), judged=True)
    assert View("x > y", (table,), ("<i>",), "failed")._repr_html_() == (
        "<p><b>✗ failed</b> x &gt; y</p>\n"
        "<table><tr><th>a&lt;b</th><th>verdict</th></tr>"
        "<tr><td>1 &amp; 2</td><td>✓ passed</td></tr></table>\n"
        "<p>&lt;i&gt;</p>"
    )


def test_lines_fold_between_words_and_are_indented_below_themselves() -> None:
    assert (
        folded("one two three\n  four five six", 11)
        == "one two\n  three\n  four five\n    six"
    )
    assert (
        folded("a/very/long-path/that-stays x", 10)
        == "a/very/long-path/that-stays\n  x"
    )


def test_a_table_that_is_too_wide_folds_its_sentences_and_then_its_columns() -> None:
    words_ = "one two three four five six seven eight nine ten"
    text = table_text(Table(("name", "why"), (("short", words_), ("b", "12"))), 40)
    assert text.splitlines() == [
        "name   why",
        "short  one two three four five six seven",
        "       eight nine ten",
        "b      12",
    ]
    wide = Table(tuple("abcd"), (tuple(12 * letter for letter in "wxyz"),))
    parts = [
        part.splitlines()[1].split() for part in table_text(wide, 34).split("\n\n")
    ]
    assert parts == [
        [12 * "w", 12 * other] for other in "xyz"
    ]  # behind the first column again
    heads = [
        part.splitlines()[0].split() for part in table_text(wide, 34).split("\n\n")
    ]
    assert heads == [["a", "b"], ["a", "c"], ["a", "d"]]
    assert [line.split() for line in table_text(wide, 54).splitlines()][1] == [
        12 * each for each in "wxyz"
    ]
    parts = [
        part.splitlines()[1].split() for part in table_text(wide, 53).split("\n\n")
    ]
    assert parts == [[12 * each for each in "wxy"], [12 * "w", 12 * "z"]]


def test_heads_take_the_room_there_is_from_left_to_right() -> None:
    table = Table(("name", "phase margin", "gain margin"), (("a", "1", "2"),))
    assert table_text(table, 80).splitlines() == [
        "name  phase margin  gain margin",
        "a                1            2",
    ]
    narrow = table_text(table, 24).splitlines()
    assert (
        narrow[-1].startswith("a") and len(narrow) > 2 and max(map(len, narrow)) <= 24
    )
    assert " ".join(" ".join(line.split()) for line in narrow[:-1]).count("margin") == 2


def test_no_escape_of_a_page_reaches_a_terminal() -> None:
    text = table_text(Table(("value",), (("1.92 ±\N{NO-BREAK SPACE}0.01",),)))
    assert text.splitlines()[1] == "1.92 ± 0.01"


# --- rig, log and models ----------------------------------------------------------------------------------


def test_the_rig_is_told_quantity_by_quantity() -> None:
    assert {row[0]: row[2] for row in tables.rig_table(RIG).rows} == {
        "Motor inertia": "6.87×10⁻⁵ kg·m²",
        "Motor viscous friction": "0.001041 N·m·s",
        "Motor torque constant": "0.21 N·m/V",
        "Gear ratio": "1",
        "Coulomb torque": "0.02 N·m",
        "Voltage limit": "10 V",
        "Link length": "0.65 m",
        "Flexural rigidity": "0.26 N·m²",
        "Link stiffness": "1.56 N·m/rad",
        "Link mass": "0 g",
        "Payload range, nominal": "20 to 40 g, 30 g",
        "Encoder": "100000 counts per turn",
        "Gauge noise, offset": "0.01 N·m, 0 N·m",
        "Motor loop: double pole": "80 rad/s",
        "Computation delay": "1 sample",
        "Sampling period": "4 ms",
    }
    bare = replace(
        RIG,
        encoder=replace(RIG.encoder, counts_per_revolution=None),
        motor_loop=replace(RIG.motor_loop, delay_samples=2),
        link=replace(RIG.link, mass=0.00735),
    )
    told = {row[0]: row[2] for row in tables.rig_table(bare).rows}
    assert (told["Encoder"], told["Computation delay"]) == ("exact", "2 samples")
    assert told["Link mass"] == "7.35 g"


def test_the_log_is_told_by_its_file_its_clock_and_its_notes() -> None:
    log = fl.Experiment(
        period=0.004,
        motor_angle=np.zeros(501),
        output=np.zeros(501),
        output_kind="deflection",
        payload=0.03,
        source="C:\\logs\\mine.csv",
        sha256=64 * "a",
        notes=(("title", "one"), ("simulated", "yes"), ("secret", "no")),
    )
    assert tables.source_name(log) == "mine.csv"
    assert (
        tables.source_name(None)
        == tables.source_name(replace(log, source=""))
        == "unnamed log"
    )
    assert tables.log_table(log).rows == (
        ("Samples", "501 in 2 s, one every 4 ms"),
        ("Output", "deflection angle [rad]"),
        ("Payload", "30 g"),
        ("SHA-256 of the file", 64 * "a"),
        ("Title", "one"),
        ("Simulated", "yes"),
    )
    unknown = tables.log_table(
        replace(log, payload=None, sha256="", notes=(), output_kind="torque")
    )
    assert unknown.rows[1:] == (
        ("Output", "base torque [N·m]"),
        ("Payload", "not stated"),
    )
    assert str(view(log)).startswith("mine.csv\n\nlog")


def fit(name: str = "UD-FOM", **more: Any) -> Any:
    """A fit with round numbers."""
    model = fl.LinkModel(
        stiffness=1.56, natural_frequency=10.02, order=1.92, payload=0.03
    )
    usual: dict[str, Any] = {
        "structure": name,
        "model": model,
        "standard_errors": {"natural_frequency": 0.02, "order": 0.003},
        "delay": 0.00212,
        "mse": 0.00012345,
        "aic": -123.46,
        "heldout_nmse": 0.0149,
        "gain": 1.001,
        "offset": -0.0005,
        "findings": (WARNED, TOLD),
        "passed": True,
    }
    return made("Fit", **(usual | more))


def test_a_fit_is_told_with_its_errors_and_its_warnings() -> None:
    shown = view(fit())
    assert (shown.headline, shown.state) == ("UD-FOM, held-out error 1.5 %", "passed")
    assert shown.notes == (str(WARNED),)  # what is only good to know is not repeated
    assert shown.tables[0] == Table(
        ("UD-FOM", "value"),
        (
            ("ω₀ [s^(−λ/2)]", "10.020 ±\N{NO-BREAK SPACE}0.020"),
            ("λ", "1.9200 ±\N{NO-BREAK SPACE}0.0030"),
            ("gauge delay [ms]", "2.12"),
            ("gain", "1.001"),
            ("offset", "−5×10⁻⁴"),
            ("mean squared error", "1.234×10⁻⁴"),
            ("AIC", "−123.5"),
            ("held-out error (NMSE)", "0.0149"),
        ),
    )
    alone = view(fit(heldout_nmse=None, passed=False, findings=()))
    assert (alone.headline, alone.state) == ("UD-FOM, nothing held out", "not shown")
    assert alone.tables[0].rows[-1] == ("held-out error (NMSE)", "nothing held out")


def test_structures_stand_beside_one_another() -> None:
    both = {"UD-FOM": fit(), "D-IOM": fit("D-IOM", heldout_nmse=None)}
    whole, brief = tables.fits_table(both), tables.fits_table(both, brief=True)
    assert whole.header == (
        "structure",
        "ω₀ [s^(−λ/2)]",
        "λ",
        "μ [s^(α−λ)]",
        "α",
        "delay [ms]",
        "MSE",
        "AIC",
        "held-out NMSE",
    )
    assert brief.header == (
        "structure",
        "ω₀ [s^(−λ/2)]",
        "λ",
        "delay [ms]",
        "AIC",
        "held-out NMSE",
    )
    assert [len(row) for row in (*whole.rows, *brief.rows)] == [9, 9, 6, 6]
    assert whole.rows[0][3:7] == ("–", "–", "2.12", "1.234×10⁻⁴")
    assert (whole.rows[1][2], whole.rows[1][-1]) == (
        "1.92",
        "–",
    )  # held fixed, and nothing held out
    compared = view(made("Comparison", fits=both, verdict="UD-FOM is preferred"))
    assert compared.headline == "UD-FOM is preferred"
    assert compared.notes == (f"UD-FOM: {WARNED}", f"D-IOM: {WARNED}")


def test_a_model_by_two_names_is_told_by_both() -> None:
    at_bound = fl.LinkModel(
        stiffness=1.0,
        natural_frequency=0.0,
        order=2.0,
        damping=110.25,
        damping_order=0.08,
    )
    assert tables.coincidence({"D-FOM": fit("D-FOM", model=at_bound)}) == [
        "– D-FOM ended at ω₀ = 0: it is UD-FOM with λ = 2 − α = 1.9200, ω₀ = √μ = 10.5000."
    ]
    assert (
        tables.coincidence({"D-FOM": fit("D-FOM")})
        == tables.coincidence({"UD-FOM": fit()})
        == []
    )


def test_a_first_model_of_a_log_says_what_to_check() -> None:
    guess = SimpleNamespace(
        part="time", value="t [s]", certainty="sure", evidence="it rises"
    )
    start = made(
        "Start",
        fit=fit(),
        guesses=(guess, guess),
        uncertain=(guess,),
        findings=(WRONG, WARNED),
        passed=False,
    )
    shown = view(start)
    assert shown.headline == "UD-FOM, held-out error 1.5 %; 1 of 2 guesses to check"
    assert shown.tables[0] == Table(
        ("log", "taken as", "certainty", "evidence"),
        2 * (("time", "t [s]", "sure", "it rises"),),
    )
    assert (shown.notes, shown.state) == ((str(WRONG), str(WARNED)), "not shown")
    start.uncertain, start.passed = (), True
    assert (view(start).headline, view(start).state) == (
        "UD-FOM, held-out error 1.5 %",
        "passed",
    )


def test_findings_are_counted_by_their_severity() -> None:
    shown = view((WRONG, WARNED, WARNED, TOLD, TOLD))
    assert (shown.headline, shown.state) == ("1 error, 2 warnings, 2 info", "failed")
    assert (
        shown.notes[-1] == "W305 info: the residual is not white"
    )  # its numbers are left to the JSON
    assert (
        shown.notes[1]
        == "W210 warning: the gauge has an offset (offset 0.1); subtract it"
    )
    assert (view((TOLD,)).headline, view((TOLD,)).state) == ("1 info", "passed")
    assert (view(()).headline, view(()).state) == ("no findings", "passed")
    assert view((WARNED,)).state == "not shown"


def test_several_payloads_are_told_with_the_parameters_that_are_free() -> None:
    links = tuple(
        fl.LinkModel(
            stiffness=1.5,
            natural_frequency=10.0 + m,
            order=1.9,
            damping=0.5,
            damping_order=0.9,
            payload=m,
        )
        for m in (0.02, 0.04)
    )
    joint = made(
        "JointFit",
        structure="D-FOM",
        models=links,
        mse=(1e-4, 2e-4),
        alone_mse=(0.9e-4, 1e-4),
        verdict="both",
    )
    shown = view(joint)
    assert shown.headline == "both"
    assert shown.tables[0].header == (
        "payload",
        "ω₀ [s^(−λ/2)]",
        "λ",
        "μ",
        "α",
        "MSE together",
        "MSE alone",
    )
    assert shown.tables[0].rows == (
        ("20 g", "10.02", "1.9", "0.5", "0.9", "1×10⁻⁴", "9×10⁻⁵"),
        ("40 g", "10.04", "1.9", "0.5", "0.9", "2×10⁻⁴", "1×10⁻⁴"),
    )
    joint.structure = "UD-FOM"
    assert view(joint).tables[0].rows[0][3:5] == ("–", "–")


def test_a_motor_is_told_in_the_units_of_its_model() -> None:
    motor = made(
        "MotorFit",
        gain=3057.0,
        decay=15.2,
        coulomb_voltage=0.31,
        coulomb_torque=0.0651,
        dead_zone=0.02,
        delay=0.0041,
        standard_errors={"gain": 12.0, "decay": 0.4, "coulomb_voltage": 0.02},
        passed=True,
        findings=(WARNED, TOLD),
    )
    shown = view(motor)
    assert shown.tables[0].rows == (
        ("K/J [rad/(V·s²)]", "3057 ± 12"),
        ("ν/J [1/s]", "15.20 ± 0.40"),
        ("Coulomb friction [V]", "0.310 ± 0.020"),
        ("Coulomb torque [N·m]", "0.0651"),
        ("dead zone [V]", "0.02"),
        ("delay [ms]", "4.1"),
    )
    assert (shown.headline, shown.state, shown.notes) == ("", "", (str(WARNED),))
    motor.passed = False
    assert view(motor).state == "not shown"


def test_modes_of_a_frequency_response_are_counted() -> None:
    seen = made(
        "SpectrumFit",
        order=1.95,
        resonances=(12.0, 80.0),
        anti_resonances=(10.0,),
        delay=0.002,
        gain=0.5,
        fit=97.125,
        outliers=(1, 2, 3),
        findings=(),
        passed=False,
        standard_errors={"order": 0.01, "resonance 2": 0.5, "delay": 0.0001},
    )
    shown = view(seen)
    assert shown.tables[0].rows == (
        ("λ", "1.950 ± 0.010"),
        ("resonance 1 [rad/s]", "12"),
        ("resonance 2 [rad/s]", "80.00 ± 0.50"),
        ("anti-resonance 1 [rad/s]", "10"),
        ("delay [ms]", "2.00 ± 0.10"),
        ("gain", "0.5"),
        ("fit [%]", "97.12"),
    )
    assert (shown.notes, shown.state) == (
        ("3 frequencies set aside as outliers",),
        "not shown",
    )
    seen.outliers, seen.standard_errors, seen.passed = (), {}, True
    assert (view(seen).notes, view(seen).state) == ((), "")
    assert view(seen).tables[0].rows[4] == ("delay [ms]", "2")


def test_a_structure_of_ones_own_says_what_is_known_of_each_parameter() -> None:
    span = SimpleNamespace(low=1.9, high=2.1)
    own = made(
        "StructureFit",
        expression="k/(T*s + 1)",
        transfer_function="2/(0.7 s + 1)",
        nmse=0.0123,
        heldout_nmse=0.045,
        passed=True,
        findings=(TOLD, WARNED),
        fixed=("a",),
        at_bound=("b",),
        undetermined=("c",),
        parameters={"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0, "k": 2.0},
        intervals={"a": span, "b": span, "c": span, "k": span},
    )
    shown = view(own)
    assert (shown.headline, shown.state) == (
        "error 1.2 %, held-out error 4.5 %",
        "passed",
    )
    assert shown.tables[0].header == ("k/(T*s + 1)", "value", "95 % interval")
    assert shown.tables[0].rows == (
        ("a", "1", "given"),
        ("b", "2", "at a bound of its range"),
        ("c", "3", "not determined"),
        ("d", "4", "not determined"),
        ("k", "2", "1.9 to 2.1"),
    )
    assert shown.notes == ("G(s) = 2/(0.7 s + 1)", str(WARNED))
    own.heldout_nmse, own.passed = None, False
    assert (view(own).headline, view(own).state) == (
        "error 1.2 %, nothing held out",
        "not shown",
    )


def test_a_link_with_its_motor_names_what_its_output_shows() -> None:
    span = SimpleNamespace(low=1.9, high=1.94)
    inner = SimpleNamespace(
        parameters={
            "l": 1.92,
            "z": 10.5,
            "m": 22.0,
            "B": 15.0,
            "A": 3000.0,
            "k": 66.0,
            "T": 0.004,
        },
        intervals={"l": span, "z": span},
        undetermined=("z",),
        nmse=0.02,
    )
    found = made(
        "DrivenLinkFit",
        fit=inner,
        output="motor_angle",
        peak=14.25,
        passed=True,
        findings=(TOLD,),
    )
    shown = view(found)
    assert (shown.headline, shown.state, shown.notes) == ("error 2 %", "passed", ())
    assert shown.tables[0].rows == (
        ("λ", "1.92", "1.9 to 1.94"),
        ("anti-resonance [rad/s]", "10.5", "not determined"),
        ("peak [rad/s]", "14.25", ""),
        ("c/J [1/s²]", "22", "not determined"),
        ("ν/J [1/s]", "15", "not determined"),
        ("K/J [rad/(V·s²)]", "3000", "not determined"),
        ("delay [s]", "0.004", "not determined"),
    )
    found.output, found.peak, found.passed = "torque", None, False
    rows = view(found).tables[0].rows
    assert rows[1][0] == "link, motor held [rad/s]" and rows[2][1] == "–"
    assert (
        rows[5] == ("K c/J", "66", "not determined")
        and view(found).state == "not shown"
    )


def test_data_are_told_by_their_size_and_range() -> None:
    record = made(
        "Recording",
        input=np.array([-1.0, 2.0]),
        output=np.array([0.5, 4.0]),
        period=0.05,
        source="x/r.csv",
    )
    assert view(record).headline == "r.csv"
    assert view(record).tables[0].rows == (
        ("samples", "2"),
        ("period [s]", "0.05"),
        ("input", "−1 to 2"),
        ("output", "0.5 to 4"),
    )
    measured = made(
        "FrequencyResponse",
        band=(0.5, 60.0),
        frequency=np.ones(7),
        coherence=np.array([0.9, 0.75]),
        source="",
    )
    assert view(measured).headline == "unnamed log"
    assert view(measured).tables[0].rows == (
        ("lines", "7"),
        ("band [rad/s]", "0.5 to 60"),
        ("coherence", "0.75 or more"),
    )
    measured.coherence = None
    assert view(measured).tables[0].rows[2] == ("coherence", "–")
    plan = made(
        "ExperimentDesign",
        kind="prbs",
        amplitude=0.3,
        bit=0.08,
        band=(1.0, 40.0),
        duration=20.0,
        standard_error=0.001,
        peak_deflection=0.12,
        peak_voltage=None,
    )
    assert view(plan).tables[0].rows == (
        ("kind", "prbs"),
        ("amplitude [rad]", "0.3"),
        ("bit [s]", "0.08"),
        ("band [rad/s]", "1 to 40"),
        ("duration [s]", "20"),
        ("standard error of λ", "0.001"),
        ("peak deflection [rad]", "0.12"),
    )


# --- the design -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def design() -> fl.Design:
    return fl.design(
        RIG.model, RIG, gain_crossover=12.0, phase_margin=fl.deg(50), filter_time=0.0
    )


def test_a_requirement_says_its_bound_its_payload_and_its_slack() -> None:
    rows = tables.requirements_table(
        [
            Requirement.at_least(
                "phase margin", math.radians(50), math.radians(48.5), "rad", 0.02
            ),
            Requirement.at_most("noise gain", 2.0, 1.5, "", 0.04),
            Requirement.at_least(
                "gain crossover", 12.0, 12.0 * (1 + 1e-12), "rad/s", 0.04
            ),
            Requirement.at_least(
                "gain crossover", 12.0, 12.0 * (1 + 1e-8), "rad/s", 0.04
            ),
        ]
    ).rows
    assert rows[0] == ("phase margin", "≥ 50.0°", "48.5°", "20 g", "−1.5°", "missed")
    assert rows[1] == ("noise gain", "≤ 2", "1.5", "40 g", "0.5", "passed")
    assert rows[2][4] == "0 rad/s"  # rounding is no slack
    assert rows[3][4] == "1.2×10⁻⁷ rad/s"
    little = Requirement.at_most("mode gain", 0.5, 0.5 - 1.5e-9, "", 0.04)
    assert (
        tables.requirements_table([little]).rows[0][4] == "1.5×10⁻⁹"
    )  # of a small one, 1e-9 at the most


@pytest.mark.slow
def test_a_design_is_told_by_its_controller(design: fl.Design) -> None:
    shown = view(design)
    assert shown.headline == "controller k_d = 0.069876, β = 0.6122, no filter"
    assert (shown.state, len(shown.notes)) == ("passed", len(design.findings))
    filtered = replace(
        design,
        controller=replace(design.controller, filter_time=0.0125, filter_order=2),
    )
    assert view(filtered).headline.endswith(", filter δ = 0.0125 s, n = 2")
    missed = Requirement.at_least("gain crossover", 12.0, 11.0, "rad/s", 0.04)
    for findings, requirements, state in (
        ((WRONG,), design.requirements, "not shown"),
        ((WRONG,), (missed,), "failed"),
        ((), (missed,), "failed"),
    ):
        assert (
            view(replace(design, findings=findings, requirements=requirements)).state
            == state
        )
    controller = {row[1]: row[2] for row in tables.controller_table(filtered).rows}
    assert controller["filter"] == "0.0125 s, 2" and len(controller) == 4
    rows = tables.controller_table(design, design.law()).rows
    assert rows[2] == ("δ", "filter", "none") and rows[4][2] == "6"
    decibel, degree = design.law().correction_error
    assert rows[5][1:] == (
        "its error from 0.05 to 300 rad/s",
        f"{decibel:.2g} dB, {degree:.2g}°",
    )


@pytest.mark.slow
def test_margins_are_told_of_both_loops(design: fl.Design) -> None:
    (row,) = tables.margins_table(design, [0.02]).rows
    here, sampled = design.at(0.02), design.sampled_at(0.02)
    assert row == (
        "20 g",
        f"{here.gain_crossover:.4g}",
        "50.0°",
        f"{sampled.gain_crossover:.4g}",
        f"{math.degrees(sampled.phase_margin):.1f}°",
        f"{sampled.modulus_margin:.3g}",
    )
    without = replace(design, findings=(Finding("W410", "error", "no law follows it"),))
    assert tables.margins_table(without, [0.02]).rows[0][3:] == (
        "no law",
        "no law",
        "no law",
    )


def test_a_law_is_told_by_its_states_and_what_it_drives(design: fl.Design) -> None:
    law = design.law()
    shown = view(law)
    assert shown.headline == "6 states, one step every 4 ms, with its motor loop"
    assert shown.notes == (f"SHA-256 {law.digest}",)
    fake = made(
        "Law",
        correction=SimpleNamespace(poles=(1, 2), pair_poles=(3,)),
        period=0.002,
        drive=None,
        has_gauge=True,
        digest="ab",
    )
    assert (
        view(fake).headline
        == "4 states, one step every 2 ms, for a robot with its own servo"
    )
    fake.has_gauge = False
    assert view(fake).headline == "4 states, one step every 2 ms, a fractional PID"


def test_an_optimisation_shows_what_it_tried(design: fl.Design) -> None:
    steps = (
        SimpleNamespace(structure="n = 1", value=2.5, taken=True),
        SimpleNamespace(structure="n = 2", value=math.nan, taken=False),
    )
    found = made(
        "Optimised", goal="noise", steps=steps, design=design, pays=True, least=0.05
    )
    shown = view(found)
    assert shown.tables[0] == Table(
        ("structure", "worst noise gain", ""),
        (("n = 1", "2.5", "taken"), ("n = 2", "none found in the bounds", "")),
    )
    assert shown.tables[1:] == view(design).tables and shown.notes == view(design).notes
    found.goal, found.pays = "crossover", False
    assert view(found).tables[0].header[1] == "smallest crossover [rad/s]"
    assert (
        view(found).notes[0]
        == "no structure is better by 5 %: the closed-form design is kept"
    )


def rival(name: str, order: float, **more: Any) -> Any:
    usual = {"stable": True, "gain_crossover": 12.0, "noise_gain": 2.0}
    return SimpleNamespace(
        name=name, controller=SimpleNamespace(order=order), **(usual | more)
    )


def test_rivals_are_rated_against_the_designs_own_controller() -> None:
    own = rival("C", 0.612)
    others = (
        rival("PD", 1.0, gain_crossover=15.0, noise_gain=26.0),
        rival("slow", 1.2, gain_crossover=0.0),
        rival("printed", 1.3, stable=False),
    )
    assert rival_sentences((own, *others)) == (
        "PD (β = 1) crosses at 1.25 times the crossover of C (β = 0.612), with 13.00 times its noise",
        "slow (β = 1.2) has no gain crossover at this Ms",
        "printed: unstable for some payload of the range",
    )


def test_an_assessment_tells_margins_budget_and_tolerances() -> None:
    tolerated = SimpleNamespace(
        delay=0.0491,
        payload_low=0.00362,
        payload_high=math.inf,
        stiffness_low=0.0,
        stiffness_high=1.891,
        motor_pole=0.0,
    )
    found = made(
        "Assessment",
        payloads=np.array([0.04, 0.028284, 0.02]),
        modes=(),
        tolerances=tolerated,
        passed=False,
        max_sensitivity=1.5449,
        rivals=(rival("C", 0.6), rival("printed", 1.3, stable=False)),
        budget=(
            SimpleNamespace(element="link", phase=-math.pi),
            SimpleNamespace(element="lead", phase=1.0),
        ),
        curves=(
            SimpleNamespace(kind="loop", phase_margin=np.radians([64.7, 57.6, 50.0])),
        ),
    )
    shown = view(found)
    assert (shown.headline, shown.state) == ("stable with 49.1 ms more delay", "failed")
    assert shown.tables[1] == Table(
        ("phase at 20 g", "share"), (("link", "−180.00°"), ("lead", "57.30°"))
    )
    assert shown.tables[2] == Table(
        ("phase margin", "40 g", "28.3 g", "20 g"),
        (("loop", "64.70°", "57.60°", "50.00°"),),
    )
    assert shown.tables[3].rows == (
        ("delay", "49.1 ms more"),
        ("lighter payload", "3.62 g"),
        ("heavier payload", "no limit found"),
        ("softer link", "no limit found"),
        ("stiffer link", "1.89 of the stiffness"),
        ("slower motor loop", "no limit found"),
    )
    assert shown.notes == (
        "at equal worst-case Ms = 1.545, the paper's printed controllers as they are:",
        "printed: unstable for some payload of the range",
        "higher modes: none, as the link has no mass; give --link-mass [kg]",
    )
    found.modes, found.passed = (
        (Requirement.at_most("loop gain at mode 2", 0.5, 0.4, "", 0.04),),
        True,
    )
    assert len(view(found).notes) == 2 and view(found).state == "passed"
    assert view(found).tables[0].rows[0][0] == "loop gain at mode 2"


def test_a_map_and_a_certificate_say_their_share_and_their_reason() -> None:
    assert view(
        made("FeasibilityMap", feasible=np.array([[True, False], [False, False]]))
    ).headline == ("25 % of the map is feasible")
    states = [
        view(made("FeasibilityMap", feasible=np.array([flag]))).state
        for flag in (True, False)
    ]
    assert states == ["passed", "failed"]
    refused = view(
        made("Certificate", verdict="Not certified: because of 8 g", passed=False)
    )
    assert (refused.headline, refused.state) == ("because of 8 g", "failed")


# --- moves ------------------------------------------------------------------------------------------------


def run(**more: Any) -> Any:
    metrics = SimpleNamespace(
        overshoot=0.0299,
        settling_time=0.744,
        residual_vibration=0.0684,
        steady_state_error=-0.00034,
        peak_voltage=1.756,
        motor_reference_noise=0.00271,
    )
    usual = {
        "payload": 0.03,
        "metrics": metrics,
        "verdict": made("V", passed=True, reason=""),
        "findings": (WARNED,),
        "about": {},
        "extras": {"payload_estimate": np.array([0.0, 0.0321])},
    }
    return made("Run", **(usual | more))


def test_a_move_is_told_by_its_metrics_and_what_the_law_knew_of_the_payload() -> None:
    (row,) = tables.moves_table([run()]).rows
    assert row == ("30 g", "3.0", "0.74", "68.4", "−0.34", "1.76", "2.7", "passed")
    assert tables.moves_table([]).header == (
        "payload",
        "overshoot [%]",
        "settles to 2 % [s]",
        "residual vibration [mrad]",
        "final error [mrad]",
        "peak voltage [V]",
        "reference noise [mrad]",
        "verdict",
    )
    for given, shown in (
        ("told", "30 g, given"),
        (0.03, "30 g, given"),
        (0.025, "30 g, given 25 g"),
        ("estimated", "30 g, estimated 32.1 g"),
        (0.0, "30 g"),
    ):
        assert (
            tables.moves_table([run(about={"payload_given": given})]).rows[0][0]
            == shown
        )
    unknown = run(
        about={"payload_given": "estimated"},
        extras={"payload_estimate": np.array([0.5, 0.0])},
    )
    assert tables.moves_table([unknown]).rows[0][0] == "30 g, estimated not yet"
    never = run(verdict=made("V", passed=False, reason="it swings"))
    never.metrics.settling_time = math.inf
    assert tables.moves_table([never]).rows[0][2::5] == ("never", "failed")
    assert (view(never).headline, view(never).state) == ("it swings", "failed")
    assert (view(run()).headline, view(run()).state, view(run()).notes) == (
        "move settled",
        "passed",
        (str(WARNED),),
    )


def measured(name: str, **more: Any) -> Any:
    usual = {
        "name": name,
        "predicted": 0.4567,
        "duration": 0.4,
        "settling_time": 0.5123,
        "largest_error": 0.0123,
        "residual_vibration": 0.0046,
        "peak_voltage": 7.654,
        "limited": 0.125,
    }
    return SimpleNamespace(**(usual | more))


def test_a_shaped_move_stands_beside_its_rivals() -> None:
    ours, rest = (
        measured("fraclink"),
        measured("bang-bang", settling_time=math.inf, limited=1.0),
    )
    shaped = made(
        "ShapedMove",
        shaped=ours,
        measured=(ours, rest),
        target=None,
        payloads=(0.02, 0.04),
        amplitude=0.5,
        told=False,
        voltage=8.0,
        passed=True,
        findings=(TOLD,),
    )
    shown = view(shaped)
    assert (
        shown.headline
        == "0.5 rad with 20 g to 40 g, payload not given: settles in 0.512 s, 7.65 V of 8 V"
    )
    assert shown.tables[0].header == (
        "reference",
        "promised [s]",
        "settles to 2 % [s]",
        "residual vibration [mrad]",
        "peak voltage [V]",
        "guards act [% of runs]",
    )
    assert shown.tables[0].rows == (
        ("fraclink", "0.457", "0.512", "4.6", "7.65", "12"),
        ("bang-bang", "0.457", "never", "4.6", "7.65", "100"),
    )
    assert (shown.notes, shown.state) == (
        ("W305 info: the residual is not white",),
        "passed",
    )
    shaped.shaped, shaped.payloads, shaped.told, shaped.passed = (
        rest,
        (0.03, 0.03),
        True,
        False,
    )
    assert (
        view(shaped).headline
        == "0.5 rad with 30 g, payload given: does not settle, 7.65 V of 8 V"
    )
    assert view(shaped).state == "failed"
    shaped.target = object()
    along = view(shaped)
    assert "the tip stays within 12.3 mrad of the path" in along.headline
    assert along.tables[0].header[1:4] == (
        "promised [mrad]",
        "lasts [s]",
        "farthest [mrad]",
    )
    assert along.tables[0].rows[0] == (
        "fraclink",
        "456.7",
        "0.400",
        "12.3",
        "7.65",
        "12",
    )


def test_a_fractional_pid_shows_what_was_asked_for_and_reached() -> None:
    tuned = made(
        "PidTuning",
        kept=(
            ("phase margin [rad]", math.radians(60), math.radians(60.0000001), True),
            ("gain margin", 2.0, 1.5, False),
        ),
        margins=SimpleNamespace(gain_margin=1.5, sensitivity_peak=2.25),
        itae=0.123,
        horizon=12.0,
        delay=0.0025,
        stable=False,
        passed=False,
        findings=(WARNED,),
        controller=SimpleNamespace(formula="k_p + k_i/s"),
    )
    shown = view(tuned)
    assert (shown.headline, shown.state) == ("k_p + k_i/s", "failed")
    assert shown.tables[0] == Table(
        ("what", "asked for", "achieved", ""),
        (
            ("phase margin [°]", "60", "60", "kept"),
            ("gain margin", "2", "1.5", "not kept"),
            ("sensitivity peak", "–", "2.25", ""),
        ),
    )
    assert shown.notes == (
        "ITAE 0.123 s² over 12 s after a unit step",
        "2.5 ms of the delay in the loop are those of the sampling",
        "the closed loop is not stable",
        "computed, not proved: certificates know the loop of an arm, and no other plant",
        str(WARNED),
    )
    tuned.delay, tuned.stable, tuned.passed, tuned.kept = 0.0, True, True, ()
    assert (len(view(tuned).notes), view(tuned).state) == (3, "passed")
    assert view(tuned).tables[0].rows[0] == ("gain margin", "–", "1.5", "")


def tuning(**more: Any) -> Any:
    errors = {"gain": 11.0, "decay": 0.4, "coulomb_voltage": 0.02}
    motor = SimpleNamespace(
        gain=3057.0, decay=15.2, coulomb_voltage=0.31, dead_zone=0.02, delay=0.0041
    )
    first = SimpleNamespace(
        fit=SimpleNamespace(**vars(motor), standard_errors=errors),
        loop=SimpleNamespace(pole=80.0),
    )
    link = fl.LinkModel(
        stiffness=1.56,
        natural_frequency=10.5,
        order=1.92,
        payload=0.03,
        gauge_delay=0.0021,
    )
    fitted = SimpleNamespace(
        model=link,
        standard_errors={"natural_frequency": 0.02, "order": 0.003, "gain": 0.01},
    )
    move = SimpleNamespace(
        amplitude=math.radians(30),
        duration=0.5,
        promised_settling=0.9,
        measured_settling=0.951,
        promised_residual=0.0101,
        measured_residual=0.0123,
        jump=0.00023,
        peak_voltage=3.21,
    )
    usual = {
        "wiring": SimpleNamespace(evidence=("the encoder counts up",)),
        "motor": first,
        "moves": (move,),
        "link": SimpleNamespace(
            fit=fitted,
            motor=SimpleNamespace(
                fit=SimpleNamespace(**vars(motor) | {"gain": 3100.0})
            ),
        ),
        "verdict": Verdict(
            Scope("passed"), Scope("failed", ("a", "b")), Scope("not run")
        ),
        "stopped": "",
        "attempts": 3,
        "arm_time": 61.4,
        "computing": 2.34,
    }
    return made("Tuning", **(usual | more))


def test_a_tuning_shows_what_was_measured_and_the_moves_beside_their_promise() -> None:
    shown = view(tuning())
    assert (
        shown.headline
        == "3 experiments on the link, 61 s of the arm, 2.3 s of computing"
    )
    assert (shown.notes, shown.state) == (("the encoder counts up",), "failed")
    found, moves, scopes = shown.tables
    assert found.rows == (
        ("K/J [rad/(s²·V)]", "3100", "11"),
        ("ν/J [1/s]", "15.2", "0.4"),
        ("friction [V]", "0.33", "0.02"),
        ("delay of the voltage [ms]", "4.1", ""),
        ("motor loop [rad/s]", "80", ""),
        ("ω₀ [s^(−λ/2)]", "10.5", "0.02"),
        ("λ", "1.92", "0.003"),
        ("torque over bend [N·m/rad]", "1.56", "0.01"),
        ("delay of the gauge [ms]", "2.1", "–"),
    )
    assert moves.rows == (
        ("30° in 0.5 s", "0.90 / 0.95", "10.1 / 12.3", "0.23", "3.21"),
    )
    assert moves.header[3:] == ("hand-over [mrad]", "peak [V]")
    assert scopes.rows == (
        ("promise", "passed", ""),
        ("model", "failed", "a; b"),
        ("reality", "not run", ""),
    )
    early = view(tuning(link=None, moves=(), stopped="the gauge is dead"))
    assert early.headline == "stopped: the gauge is dead"
    assert [row[0] for row in early.tables[0].rows][-1] == "motor loop [rad/s]" and len(
        early.tables
    ) == 2
    assert early.tables[0].rows[0] == ("K/J [rad/(s²·V)]", "3057", "11")
    assert len(view(tuning(wiring=None, moves=())).tables) == 1
    late = tuning()
    late.link.fit.standard_errors |= {"delay": 0.0004, "damping": 0.1}
    late.link.fit.model = replace(
        late.link.fit.model,
        damping=0.7,
        second_mode=fl.SecondMode(frequency=90.0, damping_ratio=0.01, gain=0.1),
    )
    rows = view(late).tables[0].rows
    assert ("delay of the gauge [ms]", "2.1", "0.4") in rows and (
        "μ",
        "0.7",
        "0.1",
    ) in rows
    assert rows[-1] == ("second mode [rad/s]", "90", "")


def test_a_watch_says_what_has_changed() -> None:
    changes = (
        SimpleNamespace(
            name="natural_frequency",
            was=10.5,
            now=9.8,
            standard_error=0.05,
            changed=True,
        ),
        SimpleNamespace(
            name="gain", was=1.0, now=1.01, standard_error=0.012, changed=False
        ),
    )
    seen = made(
        "Watch",
        changes=changes,
        due=("natural_frequency", "gain"),
        motion=31.6,
        residual=0.0123,
        expected=0.01,
        passed=False,
    )
    shown = view(seen)
    assert shown.headline == "a retune is due: natural frequency, gain"
    assert shown.tables[0].rows == (
        ("natural frequency", "10.5", "9.8", "0.05", "changed"),
        ("gain", "1", "1.01", "0.012", "as before"),
    )
    assert shown.notes == ("the fit leaves 0.012 N·m, the gauge's noise was 0.01 N·m",)
    assert shown.state == "failed"
    seen.due, seen.passed = (), True
    assert (view(seen).headline, view(seen).state) == (
        "as it was tuned, by 32 s of motion",
        "passed",
    )


# --- many runs and real time ------------------------------------------------------------------------------


def outcomes() -> tuple[Outcome, ...]:
    good, bad = (
        Check("peak", 1.0, 1.1, passed=True),
        Check("peak over clean", 1.3, 1.1, passed=False),
    )
    return (
        Outcome(
            Case("F09", 1, 0.02, "mid", 1), (good,), 0.1, 0.1, 0.0, "run", "none", 0
        ),
        Outcome(
            Case("F11", 2, 0.03, "start", 7),
            (good, bad),
            0.1,
            0.1,
            0.0,
            "run",
            "none",
            0,
            "bit 3",
        ),
    )


def test_a_fault_campaign_lists_what_misses_first_and_how_to_repeat_it() -> None:
    table = FaultTable(
        outcomes(), {"command": "fraclink campaign faults", "law_sha256": 64 * "b"}
    )
    shown = view(table)
    assert (
        shown.headline == "1 of 2 faults meet their requirement in every run, 2 runs"
        and shown.state == "failed"
    )
    missed, met = shown.tables[0].rows
    assert (missed[0][:4], missed[1:]) == ("F11 ", ("1", "1", "failed"))
    assert (met[0][:4], met[1:]) == ("F09 ", ("1", "–", "passed"))
    assert len(shown.notes) == 1 and shown.notes[0].startswith(
        "F11: peak over clean: 1.3 (limit 1.1) (F11-2-30g-start-7"
    )
    command = (
        "fraclink campaign faults --only F11 --severity 2 --payload 0.03 --phase start --seed 7 "
        "--out F11-2-30g-start-7"
    )
    assert repeated(table, outcomes()[1]) == command
    page = faults_page(table)
    assert page.startswith(
        "# Fault campaign\n\nlaw bbbbbbbbbbbbbbbb, `fraclink campaign faults`\n\n| fault"
    )
    assert page.endswith(
        f"## Failed\n\n- F11-2-30g-start-7: bit 3: peak over clean: 1.3 (limit 1.1)\n  `{command}`\n"
    )
    fine = FaultTable(outcomes()[:1], {"command": "c", "law_sha256": 64 * "b"})
    assert (
        "Failed" not in faults_page(fine)
        and view(fine).state == "passed"
        and view(fine).notes == ()
    )
    told = to_json(table)
    assert (told["passed"], told["runs"]) == (False, 2)
    assert told["faults"] == {
        "F09": {"runs": 1, "failed": 0},
        "F11": {"runs": 1, "failed": 1},
    }
    assert told["failures"] == [
        {
            "name": "F11-2-30g-start-7",
            "detail": "bit 3",
            "failed": ["peak over clean: 1.3 (limit 1.1)"],
            "replay": command,
        }
    ]


def summary(**more: Any) -> Any:
    def metric(name: str, *values: float) -> Any:
        quantiles = tuple(
            SimpleNamespace(probability=p, value=v, low=v, high=v)
            for p, v in zip((0.5, 0.95), values, strict=True)
        )
        drivers = (("payload", -0.734), ("gauge_delay", 0.04))
        return SimpleNamespace(
            name=name,
            quantiles=quantiles,
            drivers=drivers,
            worst=((7, math.inf), (3, 1.5)),
        )

    usual = {
        "metrics": (
            metric("settling_time", 0.6, math.inf),
            metric("overshoot", 0.0123, 0.1),
        ),
        "failure": SimpleNamespace(
            sentence="2 of 10 fail", runs=10, count=2, estimate=0.2, low=0.1, high=0.3
        ),
        "trips": ((2, 1, 4),),
        "left_out": "",
        "damaged": (),
        "given": "payload given",
        "passed": False,
        "failed": (3, 7),
    }
    return made("Summary", **(usual | more))


def replace_drivers(metric: Any, correlation: float) -> Any:
    return SimpleNamespace(
        **(vars(metric) | {"drivers": (("payload", correlation), ("noise", 0.0))})
    )


def test_a_campaign_tells_quantiles_in_their_units_and_what_drives_them() -> None:
    from fraclink._law import MODES, REASONS

    shown = view(summary())
    assert (shown.headline, shown.state) == ("2 of 10 fail", "failed")
    assert shown.tables[0] == Table(
        ("metric", "50 %", "95 %", "driven by"),
        (
            ("settling time [s]", "0.6", "never", "payload −0.73"),
            ("overshoot [%]", "1.23", "10", "payload −0.73"),
        ),
    )
    # What is one value for all arms is driven by nothing, and no word says that it is.
    weak, strong = (replace_drivers(summary().metrics[0], r) for r in (-0.149, 0.15))
    rows = view(summary(metrics=(weak, strong))).tables[0].rows
    assert [row[-1] for row in rows] == ["–", "payload +0.15"]
    assert shown.notes == ("payload given", f"4 runs: {MODES[2]} ({REASONS[1]})")
    assert view(summary(left_out="1 part", trips=(), passed=True)).notes == (
        "1 part",
        "payload given",
    )
    told = to_json(summary())
    assert told["metrics"]["settling_time"]["quantiles"] == [
        [0.5, 0.6, 0.6, 0.6],
        [0.95, "inf", "inf", "inf"],
    ]
    assert told["metrics"]["settling_time"]["worst"] == [[7, "inf"], [3, 1.5]]
    assert told["metrics"]["overshoot"]["drivers"] == {
        "payload": -0.734,
        "gauge_delay": 0.04,
    }
    assert (told["runs"], told["failures"], told["probability"]) == (
        10,
        2,
        [0.2, 0.1, 0.3],
    )
    assert told["trips"] == [{"mode": 2, "reason": 1, "runs": 4}] and told[
        "failed"
    ] == [3, 7]
    assert (told["passed"], told["left_out"], told["given"]) == (
        False,
        "",
        "payload given",
    )


def test_a_tournament_is_its_verdicts() -> None:
    result = made(
        "Tournament",
        verdicts=lambda: ("one", "two"),
        winners=lambda: {"noise": "a"},
        standings=(SimpleNamespace(passed=True), SimpleNamespace(passed=False)),
    )
    assert (
        str(view(result)) == "✓ passed: one\n  two"
        or view(result).headline == "one\ntwo"
    )
    assert view(result).state == "passed"
    assert to_json(result) == {"verdicts": ["one", "two"], "winners": {"noise": "a"}}


def realtime(**more: Any) -> Any:
    from collections import namedtuple

    spread = namedtuple("spread", "least mean most largest")
    usual = {
        "tick": range(250),
        "period": 0.004,
        "missed": 1,
        "overruns": 2,
        "lost_samples": 3,
        "lost_commands": 4,
        "latencies": spread(1e-6, 2.25e-6, 3e-6, 4e-6),
        "works": spread(5e-6, 6e-6, 7e-6, 8e-6),
        "findings": (WARNED,),
        "scheduling": "SCHED_FIFO",
        "memory": "locked",
        "first_difference": None,
        "passed": True,
        "problem": "",
        "stopped": False,
        "mode": np.array([1, 2]),
    }
    return made("RealtimeRun", **(usual | more))


def test_a_run_in_real_time_tells_its_times_in_microseconds() -> None:
    shown = view(realtime())
    assert shown.headline == "250 periods of 4 ms, 1 missed, 2 overruns, 3 lost samples"
    assert shown.tables[0] == Table(
        ("time [µs]", "min", "mean", "99.9 %", "max"),
        (
            ("wake-up latency", "1.0", "2.2", "3.0", "4.0"),
            ("computing time", "5.0", "6.0", "7.0", "8.0"),
        ),
    )
    assert shown.notes == (
        str(WARNED),
        "scheduling SCHED_FIFO, memory locked",
        "the record replays through the law to the last bit",
    )
    ended = view(realtime(passed=False, problem="the link broke", first_difference=3))
    assert ended.notes[2:] == ("stopped: the link broke",) and ended.state == "failed"
    told = to_json(realtime())
    assert told["latency_s"] == {
        "least": 1e-6,
        "mean": 2.25e-6,
        "most": 3e-6,
        "largest": 4e-6,
    }
    assert (
        told["periods"],
        told["last_mode"],
        told["replays"],
        told["lost_commands"],
    ) == (250, 2, True, 4)
    nothing = realtime(mode=np.array([]), first_difference=0)
    nothing.works = nothing.works._replace(mean=math.nan)
    told = to_json(nothing)
    assert (told["last_mode"], told["replays"], told["work_s"]) == (None, False, None)


def test_an_arm_that_was_served_and_a_replay_tell_their_counts() -> None:
    served = made(
        "ServedArm",
        voltage=np.zeros(9),
        late=1,
        controllers=2,
        silences=3,
        rejected=4,
        passed=True,
        tip_angle=np.array([0.0, 0.25]),
    )
    assert str(view(served)).replace("\n ", "") == (
        "✓ passed: periods 9, late 1; controllers 2, left without a stop 3; messages rejected 4"
    )
    assert to_json(served) == {
        "passed": True,
        "late": 1,
        "controllers": 2,
        "silences": 3,
        "rejected": 4,
        "periods": 9,
        "last_tip_angle": 0.25,
    }
    served.tip_angle = np.array([])
    assert to_json(served)["last_tip_angle"] is None
    same = made(
        "Replay",
        passed=True,
        mode=np.array([1, 3]),
        first_difference=None,
        largest_difference=0.0,
    )
    assert (view(same).headline, view(same).state) == (
        "2 periods agree to the last bit",
        "passed",
    )
    assert to_json(same) == {
        "passed": True,
        "first_difference": None,
        "largest_difference": 0.0,
        "periods": 2,
        "last_mode": 3,
    }
    other = made(
        "Replay",
        passed=False,
        mode=np.array([1]),
        first_difference=5,
        largest_difference=1e-7,
    )
    assert (
        view(other).headline == "first difference in period 5, largest 1e-07"
        and view(other).state == "failed"
    )


# --- what programs read -----------------------------------------------------------------------------------


def test_a_record_has_plain_values_under_the_names_of_the_attributes() -> None:
    assert plain(
        {1: np.array([1.0, math.nan]), "a": np.int64(3), "b": (True, None)}
    ) == {
        "1": [1.0, None],
        "a": 3,
        "b": [True, None],
    }
    assert plain(-math.inf) is None and plain(np.float64(2.0)) == 2.0
    assert plain(RIG.motor)["inertia"] == 6.87e-5  # any other dataclass: by its fields
    assert to_json(WARNED) == {
        "code": "W210",
        "severity": "warning",
        "message": "the gauge has an offset",
        "evidence": {"offset": 0.1},
        "remedy": "subtract it",
    }
    assert to_json((WARNED,)) == {"findings": [to_json(WARNED)]}
    told = to_json(
        made(
            "JointFit",
            structure="UD-FOM",
            common=("order",),
            mse=(1.0,),
            standard_errors={},
            stiffness=1.5,
            models=(RIG.model, replace(RIG.model, order=1.5)),
            test=SimpleNamespace(p_value=0.25),
            verdict="v",
        )
    )
    assert (
        told["orders"] == [1.92, 1.5]
        and told["p_value"] == 0.25
        and told["stiffness"] == 1.5
    )
    chart = made("FeasibilityMap", feasible=np.array([True, True, False, True]))
    assert to_json(chart) == {"feasible": 0.75}
    certificate = made(
        "Certificate",
        passed=True,
        verdict="v",
        payload=0.02,
        frequency=3.0,
        sha256="ab",
    )
    assert to_json(certificate) == {
        "passed": True,
        "verdict": "v",
        "payload": 0.02,
        "frequency": 3.0,
        "sha256": "ab",
    }
    certificate.passed = False
    assert to_json(certificate)["sha256"] is None


def test_a_run_and_a_study_are_recorded_with_their_verdicts() -> None:
    told = to_json(run(verdict=made("V", passed=False, reason="it swings")))
    assert (told["payload"], told["passed"], told["reason"]) == (
        0.03,
        False,
        "it swings",
    )
    study = fl.Study(rig=RIG, findings=(WARNED,), assumptions=("one",))
    told = to_json(study)
    assert told["passed"] is False and told["verdict"]["state"] == study.verdict.state
    assert set(told["verdict"]) >= {"state", "promise", "model", "reality", "remarks"}
    assert (
        told["findings"][0]["code"] == "W210"
        and told["fits"] == []
        and told["design"] is None
    )
    assert (
        told["assumptions"] == ["one"]
        and told["runs"] == []
        and told["reasons"] == list(study.verdict.reasons)
    )


# --- sentences --------------------------------------------------------------------------------------------


def test_the_arm_is_told_as_a_person_would_say_it() -> None:
    """Of an oscillator of 2 Hz with 5 % damping the amplitude falls to 5 % in −ln
    0.05/(2π ζ/√(1 − ζ²)).
    """
    zeta, w = 0.05, 2 * math.pi * 2.0 / math.sqrt(1 - 0.05**2)
    damped = fl.LinkModel(
        stiffness=1.5,
        natural_frequency=w,
        order=2.0,
        damping=2 * zeta * w,
        damping_order=1.0,
        payload=0.025,
        gauge_delay=0.0031,
        second_mode=fl.SecondMode(
            frequency=2 * math.pi * 14.5, damping_ratio=0.01, gain=0.1
        ),
    )
    swings = -math.log(0.05) / (2 * math.pi * zeta / math.sqrt(1 - zeta**2))
    said = words.arm_sentences(RIG, damped)
    assert said == [
        "It carries 20 to 40 g on a link of 0.65 m.",
        f"With the motor held, it swings with 25 g at 2 Hz; after {swings:.2g} swings the "
        "amplitude is down to 5 %.",
        "It has a second mode at 14.5 Hz; the design bounds the loop gain there.",
        "The gauge is 3.1 ms late.",
        "The motor follows within 50 ms; the law runs every 4 ms.",
    ]
    early = replace(damped, gauge_delay=-0.002, second_mode=None, payload=None)
    assert words.arm_sentences(RIG, early)[1].startswith(
        "With the motor held, it swings at 2 Hz"
    )
    assert words.arm_sentences(RIG, early)[2] == "The gauge is 2 ms early."
    prompt = replace(early, gauge_delay=1e-6)
    assert len(words.arm_sentences(RIG, prompt)) == 3  # a microsecond is none
    undamped = replace(early, damping=0.0)
    assert words.arm_sentences(RIG, undamped)[1] == (
        "With the motor held, it swings at 2 Hz, undamped in this model."
    )
    creeping = replace(early, natural_frequency=5.0, damping=30.0)
    assert (
        words.arm_sentences(RIG, creeping)[1]
        == "The link does not oscillate: it creeps back."
    )
    assert len(words.arm_sentences(RIG, None)) == 2
    assert words.sketch_notes(RIG, damped) == (
        "follows within 50 ms",
        "3.1 ms late",
        "20 to 40 g",
    )
    assert words.sketch_notes(RIG, early)[1] == words.sketch_notes(RIG, None)[1] == ""


def test_a_refusal_is_told_with_the_command_that_asks_for_less() -> None:
    refused = SimpleNamespace(
        asked={"gain_crossover": 9.0, "phase_margin": math.radians(50)},
        nearest={
            "gain_crossover": 10.5,
            "phase_margin": math.radians(48.5),
            "noise_gain": 2.0,
        },
    )
    log = SimpleNamespace(source="C:\\logs\\my log.csv")
    study = SimpleNamespace(rig=RIG, refused=refused, experiment=log, design=None)
    command = (
        "fraclink run --rig paper-2023 --log 'my log.csv' --gain-crossover 10.5 --phase-margin-deg 48.5 "
        "--noise-gain 2.001"
    )
    assert words.nearest_command(study) == command  # type: ignore[arg-type]
    assert words.steps(study) == [("Request the nearest feasible design", command)]  # type: ignore[arg-type]
    assert words.refusal_sentence(study) == (  # type: ignore[arg-type]
        "Requested: a crossover of 9 rad/s and a phase margin of 50.00°. Nearest feasible request: "
        "a crossover of 10.5 rad/s and a phase margin of 48.50° and noise gain 2."
    )
    study.rig = replace(RIG, name="our arm")  # not bundled: the file beside the report
    assert words.nearest_command(study).startswith("fraclink run --rig rig.toml --log ")  # type: ignore[arg-type]
    study.experiment = None
    assert " --log LOG --" in words.nearest_command(study)  # type: ignore[arg-type]
    study.refused = None
    assert words.nearest_command(study) == words.refusal_sentence(study) == ""  # type: ignore[arg-type]
    assert words.steps(study) == []  # type: ignore[arg-type]


def test_what_to_do_next_follows_what_was_done(design: fl.Design) -> None:
    study = fl.Study(rig=RIG, design=design)
    proof, faults = (
        "fraclink certify design.json",
        "fraclink campaign faults --design design.json --out .",
    )
    always = [
        "fraclink export c design.json --out firmware",
        "fraclink share . --out arm.html",
    ]
    assert [command for _, command in words.steps(study)] == [proof, faults, *always]
    done = SimpleNamespace(
        design=design,
        certificate=object(),
        faults=object(),
        arms=SimpleNamespace(failed=(7, 9)),
        refused=None,
    )
    assert [command for _, command in words.steps(done)] == [  # type: ignore[arg-type]
        "fraclink campaign replay arms --run 7",
        *always,
    ]
    done.arms.failed = ()
    assert [command for _, command in words.steps(done)] == always  # type: ignore[arg-type]


def test_the_first_power_on_goes_from_the_heaviest_to_the_lightest(
    design: fl.Design,
) -> None:
    said = words.power_on(design)
    assert len(said) == 6
    assert "(2 V of 10 V)" in said[2]
    assert said[3].startswith("Link on, 40 g, the heaviest") and said[4].startswith(
        "The same with 20 g, the"
    )
    endless = replace(
        design, rig=replace(RIG, motor=replace(RIG.motor, voltage_limit=math.inf))
    )
    assert words.power_on(endless)[2].startswith("Voltage limited to a fifth, link off")


@pytest.mark.slow
def test_a_study_in_short_has_a_row_for_all_that_was_done(design: fl.Design) -> None:
    good, late = run(), run()
    late.metrics.settling_time = 0.9162
    whole = SimpleNamespace(
        fit=fit(),
        design=replace(
            design, controller=replace(design.controller, filter_time=0.0123)
        ),
        certificate=SimpleNamespace(statement=SimpleNamespace(modulus=0.35)),
        runs=(good, late),
        arms=summary(),
        faults=FaultTable(outcomes(), {}),
    )
    rows = dict(tables.summary_rows(whole))  # type: ignore[arg-type]
    assert rows["Model"] == "UD-FOM: λ = 1.92, ω₀ = 10.02, held-out error 1.5 %"
    assert rows["Controller"] == "k_d = 0.06988, β = 0.6122, δ = 12.3 ms"
    assert rows["Proved for every payload and delay"] == "|1 + L| > 0.35"
    assert rows["The tip settles to 2 %"] == "within 0.92 s"
    assert rows["Arms that differ"] == "8 of 10 passed"
    assert (
        rows["Faults on the twin"]
        == "1 of 2 faults meet their requirement in every run, 2 runs"
    )
    margins = rows["Phase margin of the sampled loop"].split(" and ")
    assert [part.rpartition(" at ")[2] for part in margins] == ["20 g", "40 g"]
    late.metrics.settling_time = math.inf
    assert (
        dict(tables.summary_rows(whole))["The tip settles to 2 %"]
        == "not for every payload"
    )  # type: ignore[arg-type]
    assert tables.summary_rows(fl.Study()) == []


@pytest.mark.slow
def test_the_scopes_of_a_verdict_are_told_with_their_reasons() -> None:
    verdict = Verdict(Scope("passed"), Scope("failed", ("a", "b")), Scope("not run"))
    assert tables.verdict_table(verdict).rows == (
        ("promise", "requirements and proof", "–", "passed"),
        ("model", "simulated moves of the model", "a; b", "failed"),
        ("reality", "arms that differ, on the twin", "–", "not run"),
    )
    assert tables.verdict_table(verdict).judged
    assert tables.scopes(verdict)[1] == (
        "model",
        "simulated moves of the model",
        verdict.model,
    )
    study = fl.Study(rig=RIG, findings=(WARNED, TOLD))
    shown = view(study)
    assert shown.headline == tables.verdict_sentence(study.verdict)
    assert f"W210: {WARNED.message}" in shown.notes and not any(
        "W305" in note for note in shown.notes
    )
    assert (shown.state, len(shown.tables)) == (study.verdict.state, 1)
