"""What a prompt and a notebook cell display for each result, as fraclink.view writes it;
without that package a result is displayed in one line.
"""

from __future__ import annotations

import math
import re
import sys
from dataclasses import replace
from typing import Any

import pytest

import fraclink as fl
from fraclink import Certificate

RIG = fl.Rig.named("paper-2023")


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    """One result of every class that a notebook can display."""
    log = fl.read_log(fl.bundled_log("pulse_30g"), rig=RIG)
    comparison = fl.compare_structures(log, details=False)
    design = fl.design(RIG.model, RIG, gain_crossover=12.0, phase_margin=fl.deg(50))
    run = fl.simulate(design, fl.smooth_step(0.2, duration=0.5), payload=0.030)
    refused = Certificate(
        None,  # type: ignore[arg-type]
        refusal="Not certified: <unstable> at 8 g",
    )
    made = (
        RIG,
        log,
        comparison.fits["UD-FOM"],
        comparison,
        design,
        design.law(),
        run,
        run.verdict,
        refused,
    )
    return {type(result).__name__: result for result in made}


NAMES = (
    "Rig",
    "Experiment",
    "Fit",
    "Comparison",
    "Design",
    "Law",
    "Run",
    "MoveVerdict",
    "Certificate",
)
DRAWN = {"Rig", "Experiment", "Fit", "Comparison", "Design", "Run"}


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_cell_shows_the_table_and_the_drawing(
    name: str, results: dict[str, Any]
) -> None:
    page, drawing = results[name]._repr_html_(), results[name]._repr_svg_()
    assert results[name].overview().state in page
    assert (drawing is not None) == (name in DRAWN)
    if drawing is not None:
        assert drawing.startswith("<svg") and drawing in page
    assert results[name]._repr_html_() == page


@pytest.mark.slow
def test_texts_are_escaped(results: dict[str, Any]) -> None:
    assert "&lt;unstable&gt;" in results["Certificate"]._repr_html_()
    page = replace(RIG, name="<script>alert(1)</script>")._repr_html_()  # type: ignore[attr-defined]
    assert "<script" not in page and "&lt;script&gt;" in page


@pytest.mark.slow
def test_a_drawing_needs_no_matplotlib(
    results: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "phase margin" in results["Design"]._repr_html_()
    assert "phase [°]" in results["Design"]._repr_svg_()


@pytest.mark.slow
def test_a_drawing_brings_the_colours_of_both_themes(results: dict[str, Any]) -> None:
    style = results["Design"]._repr_svg_().partition("</style>")[0]
    light, dark = style.split("@media (prefers-color-scheme: dark)")
    shown = [set(re.findall(r"#[0-9a-fA-F]{6}", theme)) for theme in (light, dark)]
    assert shown[0] and len(shown[0]) == len(shown[1]) and shown[0] != shown[1]
    assert "var(" not in style


@pytest.mark.slow
def test_a_certificate_and_its_statement_show_what_was_proved(
    results: dict[str, Any],
) -> None:
    certificate: Any = fl.certify(results["Design"], modulus_margin=0.3)
    assert results["Certificate"]._repr_svg_() is None
    drawing = certificate._repr_svg_()
    assert "phase margin" in drawing and "gain margin" in drawing
    statement = certificate.statement
    assert repr(statement).startswith("Statement(proved stable for every payload")
    assert "computation delay" in statement._repr_html_()
    assert statement.clearance in statement.sentence


@pytest.mark.slow
def test_what_a_certificate_says_is_never_more_than_it_proves(
    results: dict[str, Any],
) -> None:
    certificate = fl.certify(results["Design"], modulus_margin=0.3)
    for proved in (0.35, 0.33399, 0.29999):
        claim = replace(certificate.statement, modulus=proved)
        shown = " ".join(str(replace(certificate, statement=claim)).split())
        said = re.search(
            r"above ([\d.]+), which is at least ([\d.]+)° .* gain margin of ([\d.]+)",
            shown,
        )
        assert said is not None
        modulus, margin, gain = map(float, said.groups())
        exact = math.degrees(2.0 * math.asin(0.5 * proved))
        assert proved - 1e-3 < modulus <= proved
        assert exact - 0.2 < margin <= exact
        assert 1.0 / (1.0 - proved) - 0.02 < gain <= 1.0 / (1.0 - proved)
