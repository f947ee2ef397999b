"""Which columns of a log share the vibration of one link: its motor angle, and its
output or the motor angle minus the output.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fraclink._arm.experiment import Experiment
from fraclink._arm.log_columns import UNITS
from fraclink._identify import Fit
from fraclink._identify.problem import CLEARLY_LESS
from fraclink._reading.names import length_of_name
from fraclink._reading.table import LogTable
from fraclink.errors import FieldError, LogError
from fraclink.logs._diagnosis import PERIODS, share_of, vibration_of
from fracsys.checks import Real

# An output may be delayed by half a period of the vibration before it looks like an
# early one of the other sign. With unknown sign the limit is a quarter in either
# direction; half of that is allowed.
LATE = math.pi / 4
# Roles of the columns that may be angles, by their names.
_ANGLES = ("motor_angle", "the tip", "deflection", "")


@dataclass(frozen=True)
class Candidate:
    """A column for a role: the share of the variance that no link explains, its place,
    and its name or a difference that contains it.
    """

    rest: float
    place: int
    text: str


@dataclass(frozen=True)
class Pairs:
    """The columns of a table in pairs, one as the motor angle and one as the output.

    Parameters
    ----------
    table
        the columns.
    period
        sampling period [s]; any value serves to compare the shares that a link explains.
    angle_unit
        of the motor angle where it is stated, or "".
    """

    table: LogTable
    period: float
    angle_unit: str = ""

    def vibration(self, angle: Real, output: Real) -> Fit | None:
        """The single mode from `angle` to `output`; None if there is none."""
        try:
            return vibration_of(Experiment(self.period, angle, output, "deflection"))
        except FieldError:
            return None

    def check_no_rate(self, place: int, angle: Real, mode: Fit | None) -> None:
        """Raise LogError for an output that is the rate of a deflection."""
        values, name = self.table.values[place], self.table.label(place)
        whole = self.vibration(angle, self.period * np.cumsum(values - values.mean()))
        clearer = 1 - share_of(whole) < CLEARLY_LESS * (1 - share_of(mode))
        if clearer and self.is_link(whole) and abs(phase(whole)) < LATE:
            raise LogError(
                "column of output",
                name,
                f"a speed: its integral is a vibration driven by the motor ({100 * share_of(whole):.3g} %)",
                "torque or deflection",
                "state another column, or integrate this one before it is read",
            )

    def by_vibration(
        self, role: str, group: list[int], partners: list[int]
    ) -> list[Candidate]:
        """The candidates of a role, first those that share a vibration with one of
        `partners`.
        """
        candidates = []
        for place in group:
            pairs = [(k, place) if role == "output" else (place, k) for k in partners]
            shared = [self.shared(*pair) for pair in pairs]
            rest, text = min(shared, default=(1.0, ""))
            text = text if role == "output" and text else self.table.label(place)
            candidates.append(Candidate(rest, place, text))
        return sorted(candidates, key=lambda each: each.rest)

    def shared(self, angle: int, output: int) -> tuple[float, str]:
        """The share of the variance of an output, or of the motor angle minus it, that
        no link driven by the motor angle explains, and the name of the signal chosen.

        A deflection δ = θm − θt responds to an acceleration with a positive gain. A tip
        angle responds with a negative one and rings like a deflection of the other
        sign; but then its difference from θm is a vibration as well, and a clearer one.
        """
        turned, values = (self.table.values[place] for place in (angle, output))
        names = [self.table.label(angle), self.table.label(output)]
        itself = self.vibration(turned, values)
        rest = 1 - share_of(itself) if self.is_link(itself) else 1.0
        ratio = self.ratio(angle, output)
        if not ratio:
            return rest, names[1]
        mode = self.vibration(turned, turned - ratio * values)
        less = 1 - share_of(mode)
        if mode is None or not self.is_link(mode) or mode.gain < 0 or less > rest:
            return rest, names[1]
        factor = "" if abs(ratio - 1) < 1e-9 else f"{ratio:.9g} * "
        return less, f"{names[0]} - {factor}{names[1]}"

    def ratio(self, angle: int, output: int) -> float:
        """The unit of an output in units of the motor angle, as if both were angles; 0
        where they are not.
        """
        if self.table.roles[output][0] not in _ANGLES:
            return 0.0
        if length_of_name(self.table.name(output)):
            turned, values = (self.table.values[place] for place in (angle, output))
            change = values - values[0]
            return float(turned @ (turned - turned[0]) / (turned @ change or math.inf))
        unit = self.angle_unit or self.table.unit(angle, UNITS["angle"])
        # Without a unit it is assumed to have that of the motor angle.
        sizes = [
            UNITS["angle"].get(each, 0.0)
            for each in (self.table.unit(output, UNITS["angle"]) or unit, unit)
        ]
        return sizes[0] / sizes[1] if all(sizes) else float(not any(sizes))

    def is_link(self, mode: Fit | None) -> bool:
        """Whether a mode can be that of a link: its output is no copy of the motor's
        motion and does not lead it, and the log shows its vibration.
        """
        if mode is None or any(each.code == "W324" for each in mode.findings):
            return False
        angle = self.period * mode.model.natural_frequency
        longest = max(values.size for values in self.table.values)
        # Three periods, and four samples in each, as `diagnose` requires.
        shown = math.tau * PERIODS / longest < angle < 0.5 * math.pi
        return shown and phase(mode) > -LATE


def phase(mode: Fit | None) -> float:
    """The delay of the output of a mode as a phase of its vibration [rad]."""
    return 0.0 if mode is None else mode.delay * mode.model.natural_frequency
