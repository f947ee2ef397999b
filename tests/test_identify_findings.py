"""Every finding of a fit at its threshold: what is said on either side, with which
numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fraclink._arm.experiment import Experiment
from fraclink._arm.link import LinkModel
from fraclink._identify import (
    Contest,
    Fit,
    aic,
    bic,
    coincidence_text,
    frequency_text,
)
from fraclink._identify.columns import (
    column_findings,
    lead_of,
    mains_of,
    motion_at_start,
)
from fraclink._identify.compare import (
    identify,
)
from fraclink._identify.findings import (
    signal_of,
)
from fraclink.findings import Finding
from identify_cases import PERIOD, made_log


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A fit without findings, to be changed."""
    return identify(made_log(noise=0.05, samples=2501), "UD-FOM", details=False)


def one(findings: Iterable[Finding]) -> Finding:
    (found,) = list(findings)
    return found


def codes(findings: Iterable[Finding]) -> list[str]:
    return [finding.code for finding in findings]


# --- the log's columns --------------------------------------------------------------------------------------


def columns(angle: Any, output: Any) -> list[Finding]:
    return list(
        column_findings(Experiment(period=PERIOD, motor_angle=angle, output=output))
    )


def test_a_copy_of_the_motor_is_told_by_the_variance_that_it_explains() -> None:
    rng = np.random.default_rng(0)
    angle, noise = 0.1 * rng.normal(size=(2, 20_000))
    noise -= noise @ angle / (angle @ angle) * angle
    for explained, told in ((0.985, True), (0.975, False)):
        output = 3.0 - 2.0 * (
            math.sqrt(explained) * angle / angle.std()
            + math.sqrt(1 - explained) * noise / noise.std()
        )
        found = columns(angle, output)
        assert codes(found) == ["W324"] * told
        if told:
            assert found[0].evidence == {
                "explained": pytest.approx(explained, abs=1e-3),
                "most": 0.98,
            }
            assert "the motor's angle times a constant" in found[0].message
            assert found[0].severity == "error"


def test_a_clock_and_a_counter_grow_by_one_step() -> None:
    rng = np.random.default_rng(0)
    angle, count = 1e-3 * np.cumsum(rng.normal(size=1000)), np.arange(1000)
    for output in (0.1 * count, count % 256.0, 5.0 - 0.2 * count):
        found = one(columns(angle, output))
        assert "grows steadily" in found.message
        assert found.evidence == {"first": output[0], "last": output[-1]}
    ramp = one(columns(3e-3 * count, rng.normal(size=1000)))
    assert "motor angle grows by one step" in ramp.message
    assert ramp.evidence == {"first": 0.0, "last": 3e-3 * 999}
    # A ramp for 92 % of the record is one, for 88 % none.
    for share, told in ((0.92, True), (0.88, False)):
        part = np.where(count < share * 1000, 1e-3 * count, 0.0)
        output = np.where(count < share * 1000, part, 2000 * rng.normal(size=1000))
        assert bool(columns(angle, output)) is told


def test_an_amplifier_at_its_stops() -> None:
    rng = np.random.default_rng(1)
    angle, wave = 1e-3 * np.cumsum(rng.normal(size=5000)), rng.normal(size=5000)
    for share, told in ((0.12, True), (0.08, False)):
        low, high = np.quantile(wave, [share / 2, 1 - share / 2])
        found = columns(angle, np.clip(wave, low, high))
        assert codes(found) == ["W325"] * told
        if told:
            assert found[0].evidence["share"] == pytest.approx(0.12, abs=1e-3)
            assert (found[0].evidence["low"], found[0].evidence["high"]) == (low, high)
            assert found[0].message.startswith("12 % of the samples")
    # A coarse converter has as many samples beside its extremes as at them: nothing
    # stands out.
    assert not columns(angle, np.round(np.clip(wave, -2, 2)))
    # Of two levels alone, all are extremes: a command.
    assert codes(columns(angle, np.sign(wave))) == ["W325"]


def test_a_log_that_begins_in_motion() -> None:
    assert [lead_of(np.zeros(n)) for n in (100, 1000, 1060, 5000)] == [10, 10, 11, 50]
    rest, swing = np.zeros(1000), np.zeros(1000)
    rest[500:] = 1.0
    assert motion_at_start(rest, swing, 1.0) is None
    assert (
        motion_at_start(np.linspace(0, 1, 1000), swing, 1.0) is None
    )  # 0.9 % in the first ten samples
    moving = rest.copy()
    moving[9] = 0.021
    assert motion_at_start(moving, swing, 1.0) == "the motor moves"
    moving[9] = 0.019
    assert motion_at_start(moving, swing, 1.0) is None
    for bent, told in (
        (0.51, "the link is bent"),
        (0.49, None),
        (-0.51, "the link is bent"),
    ):
        assert motion_at_start(rest, swing + bent, 1.0) == told


# --- is there a signal --------------------------------------------------------------------------------------


def test_the_signal_is_twice_the_log_likelihood_over_an_arm_at_rest(fit: Fit) -> None:
    count = fit.fitted_samples
    output = (fit.predicted + fit.residual)[:count]
    wanted = count * math.log(np.var(output) / np.mean(fit.residual[:count] ** 2))
    assert signal_of(fit) == pytest.approx(wanted, rel=1e-9)
    coloured = replace(fit, effective_parameters=3.0 * len(fit.standard_errors))
    assert signal_of(coloured) == pytest.approx(wanted / 3, rel=1e-9)
    assert signal_of(replace(fit, effective_parameters=1.0)) == pytest.approx(
        wanted, rel=1e-9
    )
    assert signal_of(replace(fit, mse=1e9)) == 0.0


def test_mains_are_told_by_their_line() -> None:
    rng = np.random.default_rng(0)
    time = PERIOD * np.arange(4001)

    def mains(output: Any, part: slice = slice(None)) -> float | None:
        log = Experiment(period=PERIOD, motor_angle=time[part], output=output[part])
        return mains_of(log)

    for hertz, told in (
        (50.0, 50.0),
        (50.4, 50.0),
        (49.6, 50.0),
        (60.0, 60.0),
        (59.7, 60.0),
    ):
        assert (
            mains(np.sin(2 * np.pi * hertz * time) + 0.3 * rng.normal(size=4001))
            == told
        )
    for hertz in (16.0, 48.0, 52.0, 55.0, 58.0, 62.0, 100.0):
        assert mains(np.sin(2 * np.pi * hertz * time)) is None
    assert mains(np.sin(2 * np.pi * 50 * time) + 2 * rng.normal(size=4001)) is None
    # A tenth of a second tells frequencies no better than to 10 Hz.
    assert mains(np.sin(2 * np.pi * 51.0 * time), slice(26)) == 50.0


# --- does it predict ----------------------------------------------------------------------------------------


# --- the optimum --------------------------------------------------------------------------------------------


# --- units, sign and delay ----------------------------------------------------------------------------------


def test_an_angle_of_more_than_a_turn() -> None:
    noise = np.random.default_rng(0).normal(size=300)
    assert columns(1.0 + np.linspace(0.0, 6.28**2, 300) ** 0.5, noise) == []
    found = one(columns(1.0 - np.linspace(0.0, 6.29**2, 300) ** 0.5, noise))
    assert (found.code, found.severity) == ("W323", "error")
    assert found.evidence == {
        "largest_angle": pytest.approx(6.29),
        "if_degrees": pytest.approx(0.10978, rel=1e-4),
    }


# --- the residual -------------------------------------------------------------------------------------------


# --- a fit in words -----------------------------------------------------------------------------------------


def test_criteria_written_out() -> None:
    assert aic(0.5, 100, 3) == pytest.approx(6.0 + 100 * math.log(0.5))
    assert bic(0.5, 100, 3) == pytest.approx(3 * math.log(100) + 100 * math.log(0.5))
    assert aic(0.0, 100, 3) == bic(0.0, 100, 3) == -math.inf


def test_a_natural_frequency_of_zero_is_a_dash_with_its_meaning(fit: Fit) -> None:
    edge = replace(fit, model=LinkModel(1.5, 0.0, damping=81.0, damping_order=0.3))
    assert (frequency_text(edge), frequency_text(fit)) == (
        "–",
        f"{fit.model.natural_frequency:.4f}",
    )
    assert coincidence_text({"UD-FOM": fit}) == []
    (line,) = coincidence_text({"UD-FOM": fit, "D-FOM": edge})
    assert (
        line
        == "– D-FOM ended at ω₀ = 0: it is UD-FOM with λ = 2 − α = 1.7000, ω₀ = √μ = 9.0000."
    )


# --- which structure ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("advantage", "preferred"), [(7.9, None), (-7.9, None), (8.0, "B"), (-8.0, "A")]
)
def test_a_contest_is_decided_at_eight(advantage: float, preferred: str | None) -> None:
    assert Contest("A", "B", advantage).preferred == preferred
