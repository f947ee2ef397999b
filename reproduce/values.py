"""Our value of everything the paper prints, by the names that published.toml uses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

from fraclink._identify import Comparison, aic, compare_structures
from fraclink._logs import bundled_log, read_log
from reproduce import designs
from reproduce.published import Published

__all__ = ["LOGS", "PAYLOADS", "comparison", "computed"]

PAYLOADS = {"light": 0.020, "nominal": 0.030, "heavy": 0.040}
LOGS = {"pulse": "pulse_30g", "light": "prbs_20g", "nominal": "prbs_30g", "heavy": "prbs_40g"}
_SAMPLES = 5001  # 20 s at 4 ms: the only count that gives the AIC of Table 2 from its MSE
_FREE = {"UD-IOM": 1, "D-IOM": 2, "UD-FOM": 2, "D-FOM": 3}


def computed(published: Published) -> Mapping[str, float]:
    """Every value that we can compute, by name."""
    return {**_law_of_payloads(), **_table_2(published), **_designs(), **_fits()}


def _law_of_payloads() -> dict[str, float]:
    arm = designs.rig()
    values = {"table1.stiffness": arm.link.beam_stiffness}
    for name, payload in PAYLOADS.items():
        model = designs.link(payload)
        values[f"law5.{name}"] = model.natural_frequency
        values[f"resonance.torque.{name}"] = model.torque_resonance or math.nan
        values[f"resonance.tip.{name}"] = model.tip_resonance or math.nan
    return values


def _table_2(published: Published) -> dict[str, float]:
    mse = {
        name: next(item.printed for item in published.numbers if item.id == f"table2_{_slug(name)}_mse")
        for name in _FREE
    }
    values = {f"table2.aic.{name}": aic(mse[name], _SAMPLES, free) / 1e4 for name, free in _FREE.items()}
    return values | {"table2.reduction": 100.0 * (1.0 - mse["UD-FOM"] / mse["UD-IOM"])}


def _slug(name: str) -> str:
    return name.lower().replace("-", "")


def _designs() -> dict[str, float]:
    values: dict[str, float] = {}
    measured, measured_nominal = designs.measured()
    for which, designed, nominal in (
        ("printed", designs.printed_design(), 11.54),
        ("measured", measured, measured_nominal),
    ):
        found = max(designed.at_frequency(nominal).gain_crossings, key=lambda item: item.frequency)
        gain, order = designs.matched_integer(designed, nominal)
        named = {
            "chi": designed.chi,
            "beta": designed.controller.order,
            "gain": designed.controller.gain,
            "crossover_upper": designed.gain_crossover_upper,
            "nominal_crossover": found.frequency,
            "nominal_margin": math.degrees(found.phase_margin),
            "integer_gain": gain,
            "integer_beta": order,
            "delta_1": designs.rule_filter(which, 1),
            "delta_2": designs.rule_filter(which, 2),
        }
        values |= {f"design.{which}.{name}": value for name, value in named.items()}
    return values


@cache
def comparison(log: str) -> Comparison:
    """The four fits of a log (a key of `LOGS`); all samples are fitted, as in the paper."""
    experiment = read_log(bundled_log(LOGS[log]), rig=designs.rig())
    return compare_structures(experiment, heldout=0.0, details=False)


def _fits() -> dict[str, float]:
    values: dict[str, float] = {}
    for log in LOGS:
        stem = "twin.pulse" if log == "pulse" else f"twin.prbs.{log}"
        for name, fit in comparison(log).fits.items():
            for quantity in ("natural_frequency", "order", "damping", "damping_order"):
                values[f"{stem}.{name}.{quantity}"] = getattr(fit.model, quantity)
            values[f"{stem}.{name}.mse"] = fit.mse
    # One λ for the three payloads: their mean, weighted by the errors of each.
    fits = [comparison(log).fits["UD-FOM"] for log in PAYLOADS]
    weights = [1.0 / fit.standard_errors["order"] ** 2 for fit in fits]
    mean = sum(w * fit.model.order for w, fit in zip(weights, fits, strict=True)) / sum(weights)
    return values | {"twin.prbs.joint.order": mean}
