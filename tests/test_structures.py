"""Any fractional structure: expressions, recovery without a start, intervals, and what
must be refused.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fraclink as fl
import fracsys
from fraclink._identify.expression import parse_expression
from fraclink._identify.least_squares import differences
from fraclink._identify.structure_problem import RecordStart, StructureCoordinates
from fraclink._identify.structure_search import StructureSearch
from fraclink._identify.structure_slopes import Rows, derivatives
from fraclink.errors import FieldError, LogError, NotConvergedError

LAG = "k/(s**a + w)"
TWO_TERMS = "1/(a2*s**n2 + a1*s**n1 + a0)"
TRUTH = {"a2": 0.8, "n2": 2.2, "a1": 0.5, "n1": 0.9, "a0": 1.0}


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
    y = fracsys.time_response(
        parse_expression(expression).function(truth), u, period
    ).output
    return fl.extend.Recording(
        period, u, y + 0.3 + noise * y.std() * rng.standard_normal(samples)
    )


def lines(
    expression: str, truth: dict[str, float], *, noise: float = 0.02, seed: int = 0
) -> fl.FrequencyResponse:
    rng = np.random.default_rng(seed)
    w = np.geomspace(0.05, 50.0, 80)
    h = parse_expression(expression).function(truth)(1j * w)
    error = rng.standard_normal((2, w.size)) / np.sqrt(2)
    return fl.FrequencyResponse(w, h * (1 + noise * (error[0] + 1j * error[1])))


# --- recovery -----------------------------------------------------------------------------------------------


# From the second pair no start leads there that is ranked as if the cut were a rest,
# from the third none that is drawn so.
@pytest.mark.parametrize(("seed", "late"), [(3, 700), (3, 1300), (7, 1300)])
def test_a_log_that_was_cut_in_mid_motion_is_recovered_with_the_angle_before(
    seed: int, late: int
) -> None:
    truth = {"k": 1.56, "a": 1.92, "w": 100.0, "T": 0.004}
    text, period = "k*s**a/(s**a + w)*exp(-T*s)", 0.004
    levels = np.random.default_rng(seed).uniform(-0.5, 0.5, 26)
    levels[0] = 0.0
    # 12 ms of a servo: smooth enough for straight lines between the samples.
    angle = (
        fracsys.time_response(
            1 / (0.012 * fracsys.s + 1) ** 2, np.repeat(levels, 100), period
        ).output
        + 0.7
    )
    torque = fracsys.time_response(
        parse_expression(text).function(truth), angle - 0.7, period, hold="first"
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
    # Over the whole rest, with what was held out: nothing is missing at the cut.
    assert np.std(fit.predicted - 0.3 - torque[late:]) < 0.1 * noise.std()


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
    assert fit.transfer_function == parse_expression(expression).function(
        fit.parameters
    )


@pytest.mark.slow
def test_the_link_structure_is_that_of_identify() -> None:
    """Two engines, one answer: the compiled link kernel and exact responses of an
    expression.
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


@pytest.mark.parametrize(
    ("expression", "values"),
    [
        (
            "(b*s**n + 1)/(a2*s**2 + s + a0)*exp(-T*s)",
            {"b": 0.3, "n": 0.7, "a2": 0.2, "a0": 2.0, "T": 0.1},
        ),
        ("k/((T*s)**a + 1)**2 - k**0.5", {"k": 2.0, "T": 1.5, "a": 0.8}),
        ("1 - 2**a/(s + w)**2", {"a": 0.6, "w": 3.0}),
    ],
)
def test_derivatives_of_an_expression_are_those_of_differences(
    expression: str, values: dict[str, float]
) -> None:
    points = 0.1 + 1j * np.geomspace(0.1, 30.0, 20)
    structure = parse_expression(expression)
    value, slopes = derivatives(structure, values, points)
    np.testing.assert_allclose(value, structure.response(values, points), rtol=1e-12)
    assert set(slopes) == set(values)
    for name in values:
        above, below = (
            structure.response(
                {**values, name: values[name] * (1 + sign * 1e-5)}, points
            )
            for sign in (1, -1)
        )
        wanted = (above - below) / (2e-5 * values[name])
        np.testing.assert_allclose(
            slopes[name], wanted, atol=1e-8 * np.abs(value).max()
        )


def coordinates_of(expression: str) -> StructureCoordinates:
    structure = parse_expression(expression)
    limits = {"order": (0.02, 4.0), "delay": (0.0, 10.0), "coefficient": (1e-12, 1e12)}
    return StructureCoordinates(
        structure, {n: limits[r] for n, r in structure.roles.items()}, {}
    )


def test_rows_of_a_jacobian_by_a_transform_back_are_those_of_exact_responses() -> None:
    data = RecordStart.of(recording(TWO_TERMS, TRUTH, samples=8000), "auto", 8000)
    own = coordinates_of(TWO_TERMS)
    coarse = Rows(data).coarse(own, TRUTH)
    assert coarse is not None
    assert coarse.sharp and coarse.width > 1
    at = np.array([[float(own.place(name, TRUTH[name])) for name in own.names]])
    low, high = own.box(own.names)

    def simulated(places: np.ndarray) -> np.ndarray:
        return data.simulated(
            own.structure, own.values(places, projected=False), len(places)
        )

    exact = differences(simulated, at, simulated(at), low, high)[0]
    whole = exact.shape[1] // coarse.width * coarse.width
    wanted = exact[:, :whole].reshape(len(exact), -1, coarse.width).mean(
        axis=2
    ) * np.sqrt(coarse.width)
    rows = coarse.rows(own, TRUTH)
    assert rows is not None
    assert np.all(
        np.linalg.norm(rows - wanted, axis=1) < 5e-3 * np.linalg.norm(wanted, axis=1)
    )


@pytest.mark.parametrize(
    ("expression", "values"),
    [
        ("k/(s - w)", {"k": 1.0, "w": 2.0}),  # grows: it would wrap around
        ("k*s**a/(s**a + w)", {"k": 1.0, "a": 1.5, "w": 2.0}),  # jumps with its input
        (
            "k/(s**a + w)*exp(-T*s)",
            {"k": 1.0, "a": 1.5, "w": 2.0, "T": 0.13},
        ),  # a jump between samples
    ],
)
def test_what_no_transform_back_knows_is_left_to_exact_responses(
    expression: str, values: dict[str, float]
) -> None:
    data = RecordStart.of(recording("1/(s + 1)", {}), "auto", 2500)
    coarse = Rows(data).coarse(coordinates_of(expression), values)
    assert coarse is None or not coarse.sharp


@pytest.mark.slow
def test_the_steps_end_where_the_exact_jacobian_leads() -> None:
    """From a place far off, by damped steps on blocks of samples: the end is that of a
    trust region.
    """
    data = RecordStart.of(recording(TWO_TERMS, TRUTH), "auto", 2500)
    search = StructureSearch(coordinates_of(TWO_TERMS), None)
    own = search.coordinates
    low, high = own.box(own.moving)
    far = {"a2": 1.6, "n2": 1.9, "a1": 0.2, "n1": 0.6, "a0": 1.3}
    begin = np.array([float(own.place(name, far[name])) for name in own.moving])
    ended = search._ended(data, [begin], low, high)
    settled = search._settled(data, ended.places, low, high)
    assert ended.converged[0]
    assert settled.costs[0] == pytest.approx(ended.costs[0], rel=1e-6)
    np.testing.assert_allclose(ended.places[0], settled.places[0], atol=1e-4)


def test_frequency_response_without_a_start() -> None:
    truth = {
        "K": 20.5,
        "D": 3.7343,
        "m": 1.15,
    }  # improper: a recording could not show it
    fit = fl.identify_structure(lines("K + D*s**m", truth), "K + D*s**m")
    assert fit.domain == "frequency"
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
def test_intervals_cover() -> None:
    """95 % intervals of three parameters in 40 noises: 114 of 120 expected, hardly ever
    fewer than 104.
    """
    truth = {"k": 2.0, "T": 3.0, "a": 0.7}
    inside = 0
    for seed in range(40):
        data = recording("k/((T*s)**a + 1)", truth, samples=1500, noise=0.1, seed=seed)
        fit = fl.identify_structure(data, "k/((T*s)**a + 1)", heldout=0.0)
        inside += sum(
            fit.intervals[name].contains(value) for name, value in truth.items()
        )
    assert inside >= 104


# --- what the user knows ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_fixed_values_bounds_and_start() -> None:
    data = recording(LAG, {"k": -2.0, "a": 1.5, "w": 1.0})
    usual = fl.identify_structure(data, LAG, details=False)
    assert not usual.passed  # a coefficient is positive where nothing else is said
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


def test_orders_of_exchangeable_terms_fall() -> None:
    """In a2*s**n2 + a1*s**n1 the terms may change names; the text's order says which is
    which.
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


def test_data_without_information() -> None:
    still = fl.extend.Recording(
        0.1, np.zeros(300), np.random.default_rng(0).normal(size=300)
    )
    with pytest.raises(LogError, match="input"):
        fl.identify_structure(still, LAG)
    few = fl.FrequencyResponse([1.0, 2.0, 3.0], [1.0, 0.5, 0.3])
    with pytest.raises(FieldError, match="too few"):
        fl.identify_structure(few, LAG)
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
    assert "W352" in codes(fit)
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


@pytest.mark.parametrize(
    ("text", "truth", "bounds"),
    [
        ("2*exp(-T*s)/(s**0.8 + 3)", "2*s**0.2/(s**0.8 + 3)", None),
        ("k/(s**0.8 + 3)", "-2/(s**0.8 + 3)", None),
        ("k/(s**0.8 + 3)", "2/(s**0.8 + 3)", {"k": (3.0, 4.0)}),
    ],
)
def test_every_parameter_at_a_bound(
    text: str, truth: str, bounds: dict[str, tuple[float, float]] | None
) -> None:
    """Nothing is inside its range: no interval, no error, and W351 instead of an end in
    the algebra.
    """
    fit = fl.identify_structure(lines(truth, {}), text, bounds=bounds)
    assert fit.at_bound == tuple(fit.limits)
    assert (dict(fit.intervals), dict(fit.standard_errors), fit.undetermined) == (
        {},
        {},
        (),
    )
    assert "W351" in [finding.code for finding in fit.findings]
    repr(fit)


def test_noise_is_no_system() -> None:
    rng = np.random.default_rng(1)
    noise = fl.extend.Recording(
        0.02, rng.choice([-1.0, 1.0], 2000), rng.standard_normal(2000)
    )
    fit = fl.identify_structure(noise, LAG, details=False)
    assert "W355" in codes(fit)
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
        assert repr(fit).startswith("StructureFit(k/(s**a + w): k = ")
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
