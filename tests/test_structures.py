"""Arbitrary fractional structures: expressions, recovery without initial values,
intervals, and what must be refused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
import fracsys
from fraclink.errors import FieldError, LogError, NotConvergedError

LAG = "k/(s**a + w)"
TWO_TERMS = "1/(a2*s**n2 + a1*s**n1 + a0)"
TRUTH = {"a2": 0.8, "n2": 2.2, "a1": 0.5, "n1": 0.9, "a0": 1.0}


def function_of(
    expression: str, values: Mapping[str, float]
) -> fracsys.FractionalTransferFunction:
    """The transfer function that Python makes of the text."""
    names = {"s": fracsys.s, "exp": lambda x: (fracsys.s**0).delayed(-x(1.0).real)}
    return eval(expression, names | dict(values))  # noqa: S307


def recording(
    expression: str,
    truth: dict[str, float],
    *,
    samples: int = 2500,
    period: float = 0.02,
    noise: float = 0.02,
    seed: int = 0,
) -> fl.extend.Recording:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 40 + 1), 40)[:samples]
    y = fracsys.time_response(function_of(expression, truth), u, period).output
    return fl.extend.Recording(
        period, u, y + 0.3 + noise * y.std() * rng.standard_normal(samples)
    )


def lines(
    expression: str, truth: dict[str, float], *, noise: float = 0.02, seed: int = 0
) -> fl.FrequencyResponse:
    rng = np.random.default_rng(seed)
    w = np.geomspace(0.05, 50.0, 80)
    h = function_of(expression, truth)(1j * w)
    error = rng.standard_normal((2, w.size)) / np.sqrt(2)
    return fl.FrequencyResponse(w, h * (1 + noise * (error[0] + 1j * error[1])))


# --- recovery -----------------------------------------------------------------------------------------------


# In the second case no start leads to the truth if starts are ranked as if the arm had
# been at rest before the cut; in the third case none if they are drawn on that
# assumption.
@pytest.mark.slow
@pytest.mark.parametrize(("seed", "late"), [(3, 700), (3, 1300), (7, 1300)])
def test_a_log_that_was_cut_in_mid_motion_is_recovered_with_the_angle_before(
    seed: int, late: int
) -> None:
    truth = {"k": 1.56, "a": 1.92, "w": 100.0, "T": 0.004}
    text, period = "k*s**a/(s**a + w)*exp(-T*s)", 0.004
    levels = np.random.default_rng(seed).uniform(-0.5, 0.5, 26)
    levels[0] = 0.0
    # A servo with 12 ms: smooth enough for linear interpolation between the samples.
    angle = (
        fracsys.time_response(
            1 / (0.012 * fracsys.s + 1) ** 2, np.repeat(levels, 100), period
        ).output
        + 0.7
    )
    torque = fracsys.time_response(
        function_of(text, truth), angle - 0.7, period, hold="first"
    ).output
    noise = 0.02 * torque.std() * np.random.default_rng(4).standard_normal(torque.size)
    cut = fl.Experiment(
        period=period,
        motor_angle=angle[late:],
        output=(torque + noise)[late:] + 0.3,
        earlier_angle=angle[:late],
    )
    fit = fl.identify_structure(cut, text, details=False)
    for name, value in truth.items():
        assert abs(fit.parameters[name] - value) < 4 * fit.standard_errors[name], name
    # Over the whole log after the cut, including the held-out part: no part of the
    # response is missing at the cut.
    assert np.std(fit.predicted - 0.3 - torque[late:]) < 0.1 * noise.std()


@pytest.mark.slow
def test_a_ring_down_that_was_cut_from_a_move_is_driven_by_the_move() -> None:
    time = 0.004 * np.arange(1500)
    angle = 0.4 * np.clip((time - 0.1) / 0.2, 0, 1)
    torque = fracsys.time_response(
        1.5 * fracsys.s**1.9 / (fracsys.s**1.9 + 80), angle, 0.004, hold="first"
    ).output
    still = fl.Experiment(
        period=0.004,
        motor_angle=angle[100:],
        output=torque[100:],
        earlier_angle=angle[:100],
    )
    fit = fl.identify_structure(
        still, "k*s**a/(s**a + w)", hold="first", heldout=0.0, details=False
    )
    assert fit.parameters == pytest.approx({"k": 1.5, "a": 1.9, "w": 80.0}, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("expression", "truth"),
    [
        (TWO_TERMS, TRUTH),
        ("k*s**a/(s**a + w)*exp(-T*s)", {"k": 1.6, "a": 1.7, "w": 4.0, "T": 0.13}),
        ("k/((T*s)**a + 1)**2", {"k": 2.0, "T": 1.5, "a": 0.8}),
        ("k*w/(s**2 + 2*z*w**0.5*s + w)", {"k": 1.0, "w": 4.0, "z": 0.2}),
    ],
)
def test_recording_without_a_start(expression: str, truth: dict[str, float]) -> None:
    data = recording(expression, truth)
    fit = fl.identify_structure(data, expression, details=False)
    assert fit.passed, fit.findings
    for name, value in truth.items():
        assert abs(fit.parameters[name] - value) < 4 * fit.standard_errors[name], name
    assert fit.offset == pytest.approx(0.3, abs=0.01)
    assert fit.heldout_nmse is not None
    assert fit.heldout_nmse < 1e-3
    assert fit.transfer_function == function_of(expression, fit.parameters)


@pytest.mark.slow
def test_the_link_structure_is_that_of_identify() -> None:
    """Two methods with the same result: the compiled link kernel and exact responses of
    an expression.
    """
    log = fl.read_log(fl.bundled_log("prbs_30g"))
    link = fl.identify(log, "UD-FOM")
    fit = fl.identify_structure(log, "k*s**a/(s**a + w)*exp(-T*s)", details=False)
    assert fit.parameters["a"] == pytest.approx(link.model.order, abs=1e-5)
    assert fit.parameters["w"] ** 0.5 == pytest.approx(
        link.model.natural_frequency, rel=1e-5
    )
    assert fit.parameters["k"] == pytest.approx(link.gain, rel=1e-5)
    assert fit.parameters["T"] == pytest.approx(link.delay, abs=1e-6)
    assert fit.nmse == pytest.approx(link.nmse, rel=1e-6)
    assert fit.standard_errors["a"] == pytest.approx(
        link.standard_errors["order"], rel=0.05
    )


def test_frequency_response_without_a_start() -> None:
    # improper: no recording could show it
    truth = {
        "K": 20.5,
        "D": 3.7343,
        "m": 1.15,
    }
    fit = fl.identify_structure(lines("K + D*s**m", truth), "K + D*s**m")
    assert fit.period is None
    for name, value in truth.items():
        assert abs(fit.parameters[name] - value) < 4 * fit.standard_errors[name]
        assert fit.intervals[name].low < fit.parameters[name] < fit.intervals[name].high
    assert fit.heldout_nmse == pytest.approx(4e-4, rel=0.5)


def test_weighting_by_coherence() -> None:
    truth = {"k": 2.0, "a": 0.8, "b": 3.0}
    clean = lines("k/(s**a + b)", truth, noise=0.001)
    bad = clean.frequency > 5.0
    spoilt = clean.response * np.where(
        bad, 1 + np.random.default_rng(0).normal(size=bad.size), 1.0
    )
    coherence = np.where(bad, 0.05, 0.99999)
    data = fl.FrequencyResponse(clean.frequency, spoilt, coherence=coherence)
    weighed = fl.identify_structure(data, "k/(s**a + b)", details=False)
    equal = fl.identify_structure(
        data, "k/(s**a + b)", weighting="relative", details=False
    )
    assert abs(weighed.parameters["a"] - 0.8) < 0.01 < abs(equal.parameters["a"] - 0.8)


@pytest.mark.slow
def test_a_delay_to_be_found_fits_no_worse_than_the_true_one() -> None:
    """After a step s^-0.4 rises with a vertical tangent: over the delay the error has a
    cusp wherever a sample passes the step, and the true delay is on one.
    """
    truth = {"k": 2.0, "a": 0.4, "w": 3.0, "T": 0.1}
    data = recording("k*exp(-T*s)/(s**a + w)", truth, samples=400)
    found, told = (
        fl.identify_structure(data, text, heldout=0.0, details=False)
        for text in ("k*exp(-T*s)/(s**a + w)", "k*exp(-0.1*s)/(s**a + w)")
    )
    assert found.nmse <= (1 + 1e-6) * told.nmse


@pytest.mark.slow
def test_intervals_are_as_wide_as_the_scatter() -> None:
    """Half a 95 % interval is 1.96 standard deviations of the fits of 14 noise
    realisations, neither much less nor much more; nearly all of them hold the truth.
    """
    truth = {"k": 2.0, "T": 3.0, "a": 0.7}
    errors, inside = [], 0
    for seed in range(14):
        data = recording("k/((T*s)**a + 1)", truth, samples=500, noise=0.1, seed=seed)
        fit = fl.identify_structure(data, "k/((T*s)**a + 1)", heldout=0.0)
        for name, value in truth.items():
            interval = fit.intervals[name]
            half = 0.5 * (interval.high - interval.low) / 1.96
            errors.append((fit.parameters[name] - value) / half)
            inside += interval.contains(value)
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.3
    assert inside >= 36  # of 42, where 40 are expected


# --- what the user knows ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_fixed_values_bounds_and_start() -> None:
    data = recording(LAG, {"k": -2.0, "a": 1.5, "w": 1.0})
    usual = fl.identify_structure(data, LAG, details=False)
    assert usual.passed and usual.parameters["k"] == pytest.approx(-2.0, rel=0.01)
    free = fl.identify_structure(data, LAG, bounds={"k": (-10, 10)}, details=False)
    assert free.parameters["k"] == pytest.approx(-2.0, rel=0.01)
    known = fl.identify_structure(
        data,
        LAG,
        bounds={"k": (-10, 10)},
        fixed={"a": 1.5, "offset": 0.3},
        details=False,
    )
    assert (known.parameters["a"], known.offset, known.fixed) == (1.5, 0.3, ("a",))
    assert known.standard_errors["w"] < free.standard_errors["w"]
    again = fl.identify_structure(
        data, LAG, bounds={"k": (-10, 10)}, start=free.parameters, details=False
    )
    assert again.parameters["a"] == pytest.approx(free.parameters["a"], abs=1e-4)


@pytest.mark.slow
def test_orders_of_exchangeable_terms_fall() -> None:
    """In a2*s**n2 + a1*s**n1 the terms are interchangeable; the order in the text
    decides which is which.
    """
    data = lines(TWO_TERMS, TRUTH)
    for text in (TWO_TERMS, "1/(a1*s**n1 + a2*s**n2 + a0)"):
        fit = fl.identify_structure(data, text, details=False)
        first, second = [name for name in fit.parameters if name.startswith("n")]
        assert fit.parameters[first] > fit.parameters[second]


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"fixed": {"q": 1.0}}, "fixed"),
        ({"bounds": {"q": (0.0, 1.0)}}, "bounds"),
        ({"bounds": {"a": (1.0, 0.5)}}, "bounds['a']"),
        ({"start": {"a": 1.0}}, "start"),
        ({"start": {"a": 9.0, "w": 1.0}}, "start['a']"),
        ({"fixed": {"k": 1.0, "a": 1.0, "w": 1.0}}, "expression"),
        ({"weighting": "coherence"}, "weighting"),
        ({"hold": "second"}, "hold"),
        ({"heldout": 2.0}, "heldout"),
        ({"start": {"zz": 3.0, "a": 1.0, "w": 1.0}}, "start"),
    ],
)
def test_arguments_out_of_range(options: dict[str, object], field: str) -> None:
    with pytest.raises(FieldError) as caught:
        fl.identify_structure(lines(LAG, {"k": 1, "a": 1, "w": 1}), LAG, **options)  # type: ignore[arg-type]
    assert caught.value.field == field


SWEPT, RECORDED = "given beside a frequency response", "given beside a recording"


@pytest.mark.parametrize(
    ("options", "field", "problem"),
    [
        ({"heldout": 0.2}, "heldout", SWEPT),
        ({"hold": "zero"}, "hold", SWEPT),
        ({"fixed": {"offset": 0.0}}, "fixed['offset']", SWEPT),
        ({"weighting": "relative"}, "weighting", RECORDED),
        (
            {"fixed": {"k": 1.0}, "bounds": {"k": (0.0, 2.0)}},
            "bounds['k']",
            "given beside fixed['k']",
        ),
    ],
)
def test_an_option_that_would_be_ignored(
    options: dict[str, object], field: str, problem: str
) -> None:
    truth = {"k": 1, "a": 1, "w": 1}
    data = (
        recording(LAG, truth, samples=200) if problem == RECORDED else lines(LAG, truth)
    )
    with pytest.raises(FieldError) as caught:
        fl.identify_structure(data, LAG, **options)  # type: ignore[arg-type]
    assert (caught.value.field, caught.value.problem) == (field, problem)


@pytest.mark.parametrize("noise", [0.1, 0.6])
def test_a_structure_must_predict_what_was_held_out(noise: float) -> None:
    """A third of the power is too much, whatever the fitted part leaves."""
    data = recording(LAG, {"k": 2.0, "a": 0.8, "w": 1.5}, noise=0.35)
    rng, tail = np.random.default_rng(1), data.output[1500:]
    scale = noise * np.std(data.output)
    louder = np.append(
        data.output[:1500], tail + scale * rng.standard_normal(tail.size)
    )
    noisy = dataclasses.replace(data, output=louder)
    fit = fl.identify_structure(noisy, LAG, details=False)
    assert fit.nmse < fit.heldout_nmse
    assert ("W318" in [each.code for each in fit.findings]) == (noise > 0.5)


def test_data_without_information() -> None:
    still = fl.extend.Recording(
        0.1, np.zeros(300), np.random.default_rng(0).normal(size=300)
    )
    with pytest.raises(LogError, match="input"):
        fl.identify_structure(still, LAG)
    few = fl.FrequencyResponse([1.0, 2.0, 3.0], [1.0, 0.5, 0.3])
    with pytest.raises(FieldError, match="too few"):
        fl.identify_structure(few, LAG)
    coherence = np.full(20, 0.9)
    silent = fl.FrequencyResponse(np.arange(1.0, 21.0), np.arange(20.0), coherence)
    with pytest.raises(FieldError, match="zero at a line"):
        fl.identify_structure(silent, LAG)
    improper = recording(LAG, {"k": 1, "a": 1, "w": 1}, samples=400)
    with pytest.raises(NotConvergedError, match="proper"):
        fl.identify_structure(improper, "k*s**2/(s + w)")


# --- nothing is known that the data do not say --------------------------------------------------------------


def codes(fit: fl.extend.StructureFit) -> set[str]:
    return {finding.code for finding in fit.findings}


def test_a_product_of_two_parameters_is_not_two_parameters() -> None:
    fit = fl.identify_structure(
        lines(LAG, {"k": 2, "a": 1.5, "w": 1}), "k*c/(s**a + w)"
    )
    assert "W354" in codes(fit)
    assert {"k", "c"} <= set(fit.undetermined)
    assert not {"k", "c"} & set(fit.intervals)
    assert "a" in fit.intervals
    assert not fit.passed


@pytest.mark.slow
def test_a_superfluous_scale_is_seen() -> None:
    fit = fl.identify_structure(
        lines(LAG, {"k": 2, "a": 1.5, "w": 1}), "k/(c*s**a + w)"
    )
    assert {"k", "c", "w"} <= set(fit.undetermined) | set(fit.at_bound)
    assert not fit.passed


def test_a_band_that_misses_a_corner() -> None:
    data = lines(LAG, {"k": 2.0, "a": 0.9, "w": 1.0}).between(20.0, 50.0)
    fit = fl.identify_structure(data, LAG)
    assert "w" in {*fit.undetermined, *fit.at_bound}
    assert not fit.passed
    # its interval is too wide to be one
    assert {fit.known(name) for name in fit.undetermined} <= {"not determined"}
    assert fit.known("a") == (fit.intervals["a"].low, fit.intervals["a"].high)


@pytest.mark.parametrize(
    ("text", "truth", "bounds"),
    [
        ("2*exp(-T*s)/(s**0.8 + 3)", "2*s**0.2/(s**0.8 + 3)", None),
        ("k/(s**0.8 + 3)", "2/(s**0.8 + 3)", {"k": (3.0, 4.0)}),
    ],
)
def test_every_parameter_at_a_bound(
    text: str, truth: str, bounds: dict[str, tuple[float, float]] | None
) -> None:
    """No parameter is inside its range: no interval and no error, and W301 instead of a
    failure of the linear algebra.
    """
    fit = fl.identify_structure(lines(truth, {}), text, bounds=bounds)
    assert fit.at_bound == tuple(fit.limits)
    assert (dict(fit.intervals), dict(fit.standard_errors), fit.undetermined) == (
        {},
        {},
        (),
    )
    assert "W301" in [finding.code for finding in fit.findings]
    repr(fit)


@pytest.mark.slow
def test_noise_is_no_system() -> None:
    rng = np.random.default_rng(1)
    noise = fl.extend.Recording(
        0.02, rng.choice([-1.0, 1.0], 2000), rng.standard_normal(2000)
    )
    fit = fl.identify_structure(noise, LAG, details=False)
    assert "W313" in codes(fit)
    assert not fit.passed


@pytest.mark.slow
def test_a_term_that_is_not_there_is_at_its_bound_or_unknown() -> None:
    data = recording(LAG, {"k": 2.0, "a": 1.2, "w": 1.0})
    fit = fl.identify_structure(data, "k/(s**a + c*s**b + w)", details=False)
    assert not fit.passed
    assert {*fit.undetermined, *fit.at_bound} & {"b", "c"}


# --- the result ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_fit_is_saved_shown_and_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    timed = fl.identify_structure(
        recording(LAG, {"k": 2, "a": 1.5, "w": 1}), LAG, details=False
    )
    swept = fl.identify_structure(
        lines(LAG, {"k": 2, "a": 1.5, "w": 1}), LAG, details=False
    )
    for fit in (timed, swept):
        fit.save(tmp_path / "fit.json")
        assert (
            fl.load(tmp_path / "fit.json")
            == fit
            == fl.extend.StructureFit.load(tmp_path / "fit.json")
        )
        assert hash(fit) == hash(fl.load(tmp_path / "fit.json"))
        assert repr(fit).startswith("StructureFit(✓ passed: k/(s**a + w): k = ")
        page = fit._repr_html_()  # type: ignore[attr-defined]
        assert "95 % interval" in page
        assert "<svg" in page
        assert fracsys.step_response(fit.transfer_function, [20.0]).output[0] > 1.0


def test_data_are_saved(tmp_path: Path) -> None:
    for data in (
        recording(LAG, {"k": 2, "a": 1.5, "w": 1}, samples=60),
        lines("k/(s + w)", {"k": 1, "w": 1}),
    ):
        fl.save(data, tmp_path / "data.npz", force=True)
        assert fl.load(tmp_path / "data.npz") == data
        assert repr(data).startswith(type(data).__name__)


def test_two_channels_of_a_log() -> None:
    log = fl.Experiment(0.01, [0.5, 0.6], [0.0, 0.1], voltage=[1.0, 2.0])
    assert fl.extend.Recording.of(log).input_at_rest == 0.5
    voltage = fl.extend.Recording.of(log, "voltage", "motor_angle")
    assert (voltage.input.tolist(), voltage.output.tolist()) == (
        [1.0, 2.0],
        [0.0, 0.09999999999999998],
    )
    with pytest.raises(LogError, match="voltage"):
        fl.extend.Recording.of(fl.Experiment(0.01, [0.5, 0.6], [0.0, 0.1]), "voltage")
    with pytest.raises(LogError, match="output"):
        fl.extend.Recording(0.1, [1.0, 2.0], [1.0])


@pytest.mark.slow
def test_a_formula_in_place_of_a_link_structure_is_sent_where_it_is_fitted() -> None:
    log = fl.read_log(fl.bundled_log("pulse_30g"))
    with pytest.raises(FieldError, match="identify_structure"):
        fl.identify(log, "k*s**a/(s**a + w)")
    with pytest.raises(FieldError, match="hoose one of these"):
        fl.identify(log, "FOM")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_given_orders_and_much_noise(seed: int) -> None:
    """The noise is 60 % of the size of the output: linear least squares alone start
    with a wrong sign, and a descent from there ends at a bound.
    """
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.choice([-1.0, 1.0], 107), 15)[:1600]
    clean = fracsys.time_response(
        1 / (fracsys.s**3 + 1.5 * fracsys.s**1.5 + 1), u, 0.05
    ).output
    noisy = clean + 0.6 * clean.std() * generator.standard_normal(1600)
    record = fl.extend.Recording(0.05, u, noisy)
    expression, truth = "b/(a*s**3 + c*s**1.5 + 1)", {"b": 1.0, "a": 1.0, "c": 1.5}
    fit = fl.identify_structure(record, expression, heldout=0.0, details=False)
    near = fl.identify_structure(
        record, expression, heldout=0.0, details=False, start=truth
    )
    assert fit.nmse <= near.nmse * (1 + 1e-4)
    for name, value in truth.items():
        assert abs(fit.parameters[name] - value) < 4 * fit.standard_errors[name]


@pytest.mark.slow
def test_a_coefficient_may_have_either_sign() -> None:
    truth = {"k": 2.0, "c": -0.4, "a": 0.7, "w": 1.0}
    record = recording("k/(s + c*s**a + w)", truth, noise=0.0)
    fit = fl.identify_structure(record, "k/(s + c*s**a + w)", details=False)
    assert fit.parameters == pytest.approx(truth, rel=1e-4)
    # If its bounds require it to be positive, the fit is close but not correct, and a
    # finding says so: the residual is as smooth as the output.
    forced = fl.identify_structure(
        record,
        "k/(s + c*s**a + w)",
        bounds={"c": (1e-6, 1e6)},
        details=False,
    )
    assert not forced.passed
    assert "W310" in {finding.code for finding in forced.findings}
