"""Modes 2 and 3 of a link with mass: their loop gain on the assembled twin, and the
filter that bounds it.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
from fraclink import Design, Rig, main
from fraclink._arm.beam import assumed_ratio, material_law, unmodelled_modes
from fraclink._law import modes
from fraclink._simulate import assemble
from fraclink._simulate.damping import Damping
from fraclink.errors import FieldError
from fraclink.extend import Beam, KelvinVoigt, PowerLaw, mode_gains
from fraclink.trials._setting import NominalLoop, law_filter, sampled

RIG = Rig.named("paper-2023-geared")
WANTED = {
    "payloads": (0.020, 0.040),
    "gain_crossover": 12.0,
    "phase_margin": fl.deg(50),
}
FREE = {"mode_gain": 100.0}  # the filter of the rule, whatever the modes


def with_mass(mass: float) -> Rig:
    rig = Rig.named("paper-2023")
    return replace(rig, link=replace(rig.link, mass=mass))


def on_the_twin(
    design: Design, payload: float, number: int, damping: Damping
) -> tuple[float, float]:
    """Loop gain of the shipped law at a mode of the twin, and the spectral radius of
    the whole loop.
    """
    stiffness, rig = design.model.stiffness, design.rig
    beam = Beam.from_rig(rig, payload=payload)
    plant = assemble(beam, damping, drive="servo", servo_pole=rig.motor_loop.pole)
    seen = sampled(
        plant, plant.outputs[0] - plant.outputs[3] / stiffness, rig.period, 1
    )
    shipped = law_filter(fl.discretize(design.controller, rig.period))
    mode = float(plant.modes.frequencies[number - 1])
    z = np.exp(
        1j
        * np.linspace(0.9 * mode, min(1.6 * mode, math.pi / rig.period), 3000)
        * rig.period
    )
    gain = float(np.abs(seen.response(z) * shipped.response(z)).max())
    return gain, NominalLoop(seen, rig.period, stiffness).radius(shipped)


@pytest.mark.slow
@pytest.mark.parametrize("mass", [0.00735, 0.0141])
@pytest.mark.parametrize("filter_time", [None, 0.04])
def test_the_gain_at_mode_two_is_that_of_the_sampled_loop_on_the_twin(
    mass: float, filter_time: float | None
) -> None:
    rig = with_mass(mass)
    design = fl.design(
        rig.model, rig, filter_time=filter_time, **WANTED, **FREE, law=False
    )
    second = mode_gains(design)[0]
    gain, _ = on_the_twin(design, second.at_payload, 2, PowerLaw(rig.model.order))
    assert second.achieved == pytest.approx(gain, rel=0.01)


@pytest.mark.slow
def test_a_viscous_link_has_its_own_damping_at_mode_two() -> None:
    rig = with_mass(0.00735)
    ratio, pole = 0.06, rig.natural_frequency(0.030)
    model = replace(
        rig.model, order=2.0, natural_frequency=pole, damping=2 * ratio * pole
    )
    design = fl.design(model, rig, **WANTED, law=False, procedure="published")
    second = mode_gains(design)[0]
    gain, _ = on_the_twin(design, second.at_payload, 2, KelvinVoigt(2 * ratio / pole))
    assert second.achieved == pytest.approx(gain, rel=0.03)


def test_less_damping_is_more_gain_and_an_undamped_model_is_given_some() -> None:
    rig = with_mass(0.00735)
    design = fl.design(rig.model, rig, **WANTED, **FREE, law=False)
    rough, fine = (
        mode_gains(design, damping_ratio=ratio)[0].achieved for ratio in (0.04, 0.02)
    )
    assert fine == pytest.approx(2.0 * rough, rel=0.05)
    bare = fl.design(
        replace(rig.model, order=2.0),
        rig,
        **(WANTED | FREE | {"gain_crossover": 13.0}),
        law=False,
    )
    assert mode_gains(bare) == mode_gains(bare, damping_ratio=0.02)


def test_the_papers_reading_of_a_link_with_mass_brings_a_finding_and_of_a_massless_one_does_not() -> (
    None
):
    codes = {}
    for mass in (0.0, 0.00735):
        rig = with_mass(mass)
        found = fl.design(
            rig.model, rig, **WANTED, margins="ideal", filter_time=0.0, law=False
        ).findings
        codes[mass] = {finding.code: finding for finding in found}
    assert "W405" not in codes[0.0]
    finding = codes[0.00735]["W405"]
    assert finding.evidence["loop_gain"] > 0.5 and "mode_gain=0.5" in finding.remedy


def test_a_mass_that_the_rig_states_bounds_the_gain_at_modes_that_no_log_showed() -> (
    None
):
    rig = with_mass(0.00735)
    made = fl.design(rig.model, rig, **WANTED, law=False)
    assert made.passed and mode_gains(made)[0].achieved <= 0.5
    assert "loop gain at mode 2" in {item.name for item in made.requirements}


@pytest.mark.slow
def test_the_shipped_law_is_looked_at_with_the_modes_of_the_links_mass() -> None:
    # A viscous link of 3 g: its second mode is damped too well for a log to show it,
    # and its gain is 2.4.
    rig = replace(
        RIG,
        link=replace(RIG.link, mass=0.0032),
        payloads=replace(RIG.payloads, nominal=0.0377),
    )
    model = fl.LinkModel(
        1.569, 9.794, 2.0, 0.1947, payload=0.03773, gauge_delay=0.00195
    )
    wanted = {
        "payloads": (0.0302, 0.0491),
        "gain_crossover": 14.3,
        "phase_margin": fl.deg(31.8),
    }
    free = fl.design(model, rig, **wanted, procedure="published")
    told = [finding for finding in free.findings if finding.code == "W404"]
    assert [one.severity for one in told] == ["error"] and "modes 2 and 3" in told[
        0
    ].message
    run = fl.simulate(
        free, fl.smooth_step(0.5, duration=0.5), arm=fl.Twin.from_rig(rig, model=model)
    )
    assert "the voltage does not come to rest" in run.verdict.reason
    massless = replace(rig, link=replace(rig.link, mass=0.0))
    assert not [
        one
        for one in fl.design(model, massless, **wanted, procedure="published").findings
        if one.severity == "error"
    ]


@pytest.mark.slow
def test_the_bound_is_kept_with_the_margin_that_was_asked_for() -> None:
    rig = with_mass(0.00735)
    design = fl.design(rig.model, rig, mode_gain=0.5, **WANTED, law=False)
    assert design.passed
    achieved = {row.name: row.achieved for row in design.requirements}
    assert achieved["loop gain at mode 3"] < achieved["loop gain at mode 2"] <= 0.5
    for payload in (0.020, 0.025, 0.030, 0.040):
        kept = design.sampled_at(payload, realisation="exact").phase_margin
        assert kept >= fl.deg(49.9)
    gain, radius = on_the_twin(design, 0.040, 2, PowerLaw(rig.model.order))
    assert gain < 0.51 and radius < 1.0 + 1e-9
    assert not {"W401", "W405"} & {finding.code for finding in design.findings}


@pytest.mark.slow
def test_the_heavier_link_is_unstable_by_the_rule_and_stable_by_the_bound() -> None:
    rig = with_mass(0.0141)
    ruled = fl.design(rig.model, rig, **WANTED, law=False, procedure="published")
    bounded = fl.design(rig.model, rig, mode_gain=0.9, **WANTED, law=False)
    law = PowerLaw(rig.model.order)
    assert on_the_twin(ruled, 0.040, 2, law)[1] > 1.001
    assert on_the_twin(bounded, 0.040, 2, law)[1] < 1.0 + 1e-9


@pytest.mark.slow
def test_what_no_filter_reaches_is_met_by_a_notch_and_holds_on_the_twin() -> None:
    rig = with_mass(0.0141)
    made = fl.design(rig.model, rig, mode_gain=0.3, **WANTED, law=False)
    assert made.passed and made.controller.notch is not None
    law = PowerLaw(rig.model.order)
    assert on_the_twin(made, 0.040, 2, law)[1] < 1.0 + 1e-9


@pytest.mark.parametrize("bound", [0.0, -1.0, math.nan, "0.5", 10**400])
def test_bad_bounds_are_refused(bound: object) -> None:
    rig = with_mass(0.00735)
    with pytest.raises(FieldError) as caught:
        fl.design(rig.model, rig, mode_gain=bound, **WANTED, law=False)  # type: ignore[arg-type]
    assert caught.value.field == "mode_gain"


def test_a_massless_link_has_no_mode_to_bound() -> None:
    rig = with_mass(0.0)
    with pytest.raises(FieldError, match="mass_kg"):
        fl.design(rig.model, rig, mode_gain=0.5, **WANTED, law=False)


@pytest.mark.slow
def test_the_command_line_bounds_the_mode(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "design.json"
    line = [
        "design",
        "--rig",
        "paper-2023",
        "--link-mass",
        "0.00735",
        "--out",
        str(place),
    ]
    assert main([*line, "--mode-gain", "100"]) == 0
    assert "loop gain at mode 2" in capsys.readouterr().out
    assert main([*line, "--json", "--force"]) == 0
    told = json.loads(capsys.readouterr().out)
    names = {item["name"]: item["achieved"] for item in told["requirements"]}
    assert names["loop gain at mode 2"] <= 0.5
    assert Design.load(place).rig.link.mass == 0.00735


# --- the numbers behind it, by the sum over the modes written out ----------------------------------------


def on_the_beam(rig: Rig, design: Design, payload: float, w: np.ndarray) -> np.ndarray:
    """|Ĉ · hold · M · Θ̂t/Θm| from the beam's modes and the model's damping law s^(2 −
    λ).
    """
    beam, s, model = Beam.from_rig(rig, payload=payload).modes(3), 1j * w, design.model
    answer = np.ones(w.shape, dtype=complex)
    for i in range(3):
        share = beam.participation[i] ** 2 * beam.frequencies[i] ** 2 / model.stiffness
        answer -= (
            share * s**2 / (s**2 + beam.frequencies[i] ** 2 * s ** (2 - model.order))
        )
    half = 0.5 * rig.period * w
    motor = np.abs(np.sin(half) / half) / np.abs(1 + s / 80.0) ** 2
    return np.abs(design.controller.response(w)) * motor * np.abs(answer)


@pytest.fixture(scope="module")
def massive() -> Design:
    rig = with_mass(0.00735)
    return fl.design(rig.model, rig, **WANTED, **FREE, law=False)


def test_the_gain_at_mode_two_is_the_peak_of_the_written_out_loop(
    massive: Design,
) -> None:
    second, third = mode_gains(massive, limit=0.7)
    peaks = {}
    for payload in (0.02, math.sqrt(0.02 * 0.04), 0.04):
        mode = Beam.from_rig(massive.rig, payload=payload).modes(2).frequencies[1]
        w = np.linspace(mode, 1.5 * mode, 4000)
        peaks[payload] = float(on_the_beam(massive.rig, massive, payload, w).max())
    at = max(peaks, key=lambda payload: peaks[payload])
    assert second.achieved == pytest.approx(peaks[at], rel=2e-3)
    assert second.at_payload == pytest.approx(at)
    assert (second.name, second.wanted, second.bound) == (
        "loop gain at mode 2",
        0.7,
        "at most",
    )
    assert third.name == "loop gain at mode 3" and third.achieved < second.achieved


def test_where_the_computer_sees_a_mode_beyond_nyquist() -> None:
    nyquist = math.pi / 0.004
    w = np.array(
        [100.0, nyquist - 10.0, nyquist + 10.0, 2 * nyquist - 30.0, 2 * nyquist + 30.0]
    )
    seen = modes._seen(w, 0.004)
    assert seen == pytest.approx([100.0, nyquist - 10.0, nyquist - 10.0, 30.0, 30.0])
    assert modes._seen(np.array([2 * nyquist]), 0.004)[0] == pytest.approx(
        1e-3 * nyquist
    )  # not zero
    loop = fl.design(RIG.model, RIG, **WANTED, **FREE, law=False).full_loop
    half = 0.5 * 0.004 * np.array([100.0, 1000.0])
    hold = np.abs(np.sin(half) / half)
    motor = 1 / np.abs(1 + 1j * np.array([100.0, nyquist]) / 80.0) ** 2
    assert np.exp(modes._rest(loop, np.array([100.0, 1000.0]), 0.004)) == pytest.approx(
        hold * motor
    )


def test_an_identified_second_mode_takes_the_place_of_the_beams(
    massive: Design,
) -> None:
    known = replace(massive.model, second_mode=fl.SecondMode(190.0, 0.03, 0.02))
    found = modes.higher_modes(known, massive.rig, massive.full_loop, (0.02, 0.04))
    assert found is not None and sorted(found.number.tolist()) == [2, 2, 2, 3, 3, 3]
    assert sorted(set(found.payload.tolist())) == pytest.approx(
        [0.02, math.sqrt(0.0008), 0.04]
    )
    second = found.frequency[found.number == 2]
    assert second.min() == pytest.approx(190.0 * math.exp(-0.02 * math.sinh(3.0)))
    assert second.max() == pytest.approx(190.0 * math.exp(0.02 * math.sinh(3.0)))
    broad = replace(known, second_mode=fl.SecondMode(190.0, 0.03, 0.5))
    wide = modes.higher_modes(broad, massive.rig, massive.full_loop, (0.02, 0.02))
    assert wide is not None
    assert wide.frequency[0].max() == pytest.approx(
        190.0 * math.exp(0.035 * math.sinh(3.0))
    )
    assert (
        modes.higher_modes(RIG.model, with_mass(0.0), massive.full_loop, (0.02, 0.04))
        is None
    )
    with pytest.raises(FieldError) as caught:
        mode_gains(massive, damping_ratio=0.0)
    assert caught.value.field == "mode_damping"


def test_a_law_of_damping_lays_the_peak_of_a_mode() -> None:
    """ω² = ω_i² Re D(jω): for s^(2 − λ) the peak is (ω_i² cos(π(2 − λ)/2))^(1/λ)."""
    model = fl.LinkModel(1.56, 11.0, order=1.92)
    w = modes._around(model, 180.0, None)
    peak = (180.0**2 * math.cos(0.04 * math.pi)) ** (1 / 1.92)
    assert w[30] == pytest.approx(peak, rel=1e-9)
    # arg D = (2 − λ)π/2, of which half is the damping ratio, limited to 3.5 %
    assert w[-1] / peak == pytest.approx(math.exp(0.035 * math.sinh(3.0)))
    sharp = modes._around(model, 180.0, 0.01)
    assert sharp[30] == pytest.approx(180.0) and sharp[-1] / 180.0 == pytest.approx(
        math.exp(0.01 * math.sinh(3.0)), rel=1e-4
    )
    viscous = fl.LinkModel(1.56, 11.0, damping=0.5)
    s = np.array([5j, 200j])
    assert material_law(viscous, s, 180.0, None) == pytest.approx(1 + 0.5 / 121 * s)
    assert material_law(model, s, 180.0, None) == pytest.approx(s**0.08)
    assert material_law(model, s, 180.0, 0.03) == pytest.approx(
        1 + 2 * 0.03 * s / 180.0
    )
    assert (
        assumed_ratio(model),
        assumed_ratio(viscous),
        assumed_ratio(fl.LinkModel(1.56, 11.0)),
    ) == (
        None,
        None,
        0.02,
    )


def test_modes_that_the_model_has_not_add_to_its_torque() -> None:
    rig, model = with_mass(0.00735), RIG.model
    beam = Beam.from_rig(rig, payload=0.03).modes(3)
    s = np.array([3.0 + 100j, 177j, 400j])

    def torque(kept: slice) -> np.ndarray:
        found = np.zeros(3, dtype=complex)
        for w, gamma in list(zip(beam.frequencies, beam.participation, strict=True))[
            kept
        ]:
            found += (
                gamma**2
                * w**2
                / model.stiffness
                * s**2
                / (s**2 + w**2 * s ** (2 - model.order))
            )
        return found

    extra = unmodelled_modes(model, rig, 0.03)
    assert extra is not None and extra(s) == pytest.approx(
        torque(slice(1, 3)), rel=1e-9
    )
    known = unmodelled_modes(
        replace(model, second_mode=fl.SecondMode(180.0, 0.05)), rig, 0.03
    )
    assert known is not None and known(s) == pytest.approx(
        torque(slice(2, 3)), rel=1e-9
    )
    undamped = unmodelled_modes(replace(model, order=2.0), rig, 0.03)
    assert undamped is not None
    w, gamma = beam.frequencies[1], beam.participation[1]
    peak = (
        gamma**2 * w**2 / model.stiffness * -1 / (0.04j)
    )  # −ω²/(2jζω²), ζ = 0.02, and mode 3 far above
    assert complex(undamped(np.array([1j * w]))[0]) == pytest.approx(
        complex(peak), rel=0.02
    )
