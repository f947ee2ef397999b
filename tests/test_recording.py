"""Recordings of any two channels: ring-downs, channels of a log, lines of a frequency
response and their weights.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import fraclink as fl
from fraclink import FrequencyResponse
from fraclink._arm.recording import coherence_weights
from fraclink.errors import FieldError, LogError
from fraclink.extend import Recording

T = 0.01
TIME = T * np.arange(1000)
# about 0.3, as measured by a laser
SWING = 0.3 + 0.1 * np.cos(6.0 * TIME) * np.exp(-0.5 * TIME)


def test_a_ring_down_is_the_step_of_the_force_that_is_taken_away() -> None:
    """A record that begins at the maximum deflection: y(0) − y(t), without a delay."""
    made = Recording.ring_down(T, SWING, source="a.csv", sha256="ab")
    assert made.period == T and (made.source, made.sha256) == ("a.csv", "ab")
    assert made.input.tolist() == [1.0] * 1000 and made.input_at_rest == 0.0
    np.testing.assert_allclose(made.output, SWING[0] - SWING)
    # the rest position relative to the initial deflection
    assert made.output[-200:].mean() == pytest.approx(0.1, abs=2e-3)


def test_a_record_that_begins_later_is_cut_where_the_link_turns() -> None:
    # in the middle of a swing: the velocity is zero at half a period, π/6 s
    late = SWING[30:]
    made = Recording.ring_down(T, late)
    turn = round(math.pi / 6.0 / T) - 30
    assert made.output.size == pytest.approx(late.size - turn, abs=2)
    # zero velocity there
    assert made.output[0] == 0.0 and np.abs(np.diff(made.output[:2]))[0] < 1e-3
    # noise at the end, however large, is not a swing
    rest = np.concatenate([late, np.full(400, 0.3)])
    rest[-350] = 1.3
    assert Recording.ring_down(T, rest).output.size == pytest.approx(
        rest.size - turn, abs=2
    )


def test_a_record_that_begins_while_it_is_held_keeps_that_part() -> None:
    rng = np.random.default_rng(1)
    held = np.concatenate([0.4 + 1e-4 * rng.standard_normal(60), SWING])
    made = Recording.ring_down(T, held)
    assert made.output.size == 1060
    assert np.abs(made.output[:60]).max() < 1e-3  # the step comes 0.6 s late
    assert made.output[60:].max() == pytest.approx(0.4 - SWING.min(), abs=1e-3)


@pytest.mark.parametrize("values", [np.full(500, 0.2), SWING[:49], np.zeros(3)])
def test_what_does_not_ring_is_refused(values: np.ndarray) -> None:
    with pytest.raises(LogError, match="no ring-down") as caught:
        Recording.ring_down(T, values)
    assert (caught.value.field, caught.value.value) == ("output", values.size)
    assert Recording.ring_down(T, SWING[:50]).output.size > 10


def test_channels_of_a_log_are_at_rest_where_they_began() -> None:
    angle, torque, volts = 0.5 + SWING, 2.0 * SWING, 3.0 * SWING
    log = fl.Experiment(
        period=T,
        motor_angle=angle,
        output=torque,
        voltage=volts,
        source="x",
        sha256="cd",
    )
    plain = Recording.of(log)
    assert plain.input_at_rest == angle[0] and (plain.source, plain.sha256) == (
        "x",
        "cd",
    )
    assert np.array_equal(plain.input, angle) and np.array_equal(plain.output, torque)
    motor = Recording.of(log, "voltage", "motor_angle")
    assert motor.input_at_rest == 0.0 and np.array_equal(motor.input, volts)
    np.testing.assert_allclose(motor.output, angle - angle[0])
    assert np.array_equal(Recording.of(log, "voltage").output, torque)
    np.testing.assert_allclose(plain.time, TIME)
    bare = fl.Experiment(period=T, motor_angle=angle, output=torque)
    with pytest.raises(LogError, match="not in the log") as caught:
        Recording.of(bare, "voltage")
    assert (
        caught.value.value == "voltage"
        and caught.value.allowed == "motor_angle, output"
    )
    with pytest.raises(LogError, match="not as long as the input"):
        Recording(period=T, input=[0, 1, 2], output=[0, 1])


RESPONSE = FrequencyResponse(
    [1.0, 2.0, 3.0],
    [1, 2j, -3],
    magnitude=[0.5, 0.6, 0.7],
    coherence=[0.5, 0.8, 1.0],
    source="f",
    sha256="ef",
)


def test_lines_between_two_frequencies_keep_their_columns() -> None:
    assert RESPONSE.band == (1.0, 3.0)
    cut = RESPONSE.between(2.0, 3.0)
    assert cut.frequency.tolist() == [2.0, 3.0] and cut.response.tolist() == [2j, -3]
    assert cut.magnitude is not None and cut.magnitude.tolist() == [0.6, 0.7]
    assert cut.coherence is not None and cut.coherence.tolist() == [0.8, 1.0]
    assert (cut.source, cut.sha256) == ("f", "ef")
    assert FrequencyResponse([1.0, 2.0], [1, 2]).between(1.0, 1.0).coherence is None
    with pytest.raises(FieldError, match="without a line") as caught:
        RESPONSE.between(3.1, 9.0)
    assert caught.value.allowed == "a band that overlaps 1 to 3 rad/s"


@pytest.mark.parametrize("name", ["response", "magnitude", "coherence"])
def test_columns_of_other_lengths_are_named(name: str) -> None:
    columns = {
        "response": [1, 1j],
        "magnitude": [1.0, 1.0],
        "coherence": [0.5, 0.5],
    } | {name: [0.5]}
    with pytest.raises(FieldError, match="not as long as frequency") as caught:
        FrequencyResponse([1.0, 2.0], **columns)
    assert caught.value.field == name


def test_a_lines_weight_is_one_over_its_spread() -> None:
    """√((1 − γ²)/γ²)|H| is the standard deviation of a line, apart from the number of
    averages.
    """
    weights = coherence_weights(np.array([2.0, 4j, 1.0]), np.array([0.5, 0.8, 1.0]))
    assert weights == pytest.approx([0.5, 2.0 / 4.0, 1e3], rel=1e-6)
