"""Our value of everything the paper prints, under the names used by published.toml."""

from __future__ import annotations

import math
from collections.abc import Mapping

from fraclink._identify import aic
from reproduce import designs, logs
from reproduce.forms import tip_resonance
from reproduce.logs import PAYLOADS
from reproduce.published import Published

__all__ = ["SAMPLES", "computed", "mse_of_table_2"]

SAMPLES = (
    5001  # 20 s at 4 ms: the only count that gives the AIC of Table 2 from its MSE
)
_FREE = {"UD-IOM": 1, "D-IOM": 2, "UD-FOM": 2, "D-FOM": 3}


def computed(published: Published) -> Mapping[str, float]:
    """Every value we can compute, by name."""
    return {
        **_used(),
        **_law_of_payloads(),
        **_table_2(published),
        **_designs(),
        **_fits(),
    }


def _used() -> dict[str, float]:
    """Every datum of the paper that is an input here, taken from where the computations
    take it.
    """
    arm, pulse = designs.rig(), logs.pulse_log().header
    # kg/m³, of a carbon rod: neither mass nor material is printed in the paper
    density = 1600.0
    return {
        "used.inertia": arm.motor.inertia,
        "used.viscous_friction": arm.motor.viscous_friction,
        "used.torque_constant": arm.motor.torque_constant,
        "used.length": float(pulse["length_m"]),
        "used.payload_nominal": float(pulse["payload_kg"]),
        "used.period_ms": 1e3 * arm.period,
        "used.diameter": math.sqrt(
            float(pulse["link_mass_kg"]) / (math.pi / 4 * density * arm.link.length)
        ),
        "used.pulse_width": logs.WIDTH,
        "used.pulse_amplitude": logs.AMPLITUDE,
        "used.stiffness": float(pulse["stiffness_Nm"]),
        "used.pole": -arm.motor_loop.pole,
        "used.crossover": designs.printed_design().gain_crossover,
        "used.margin_deg": math.degrees(designs.printed_design().phase_margin),
        "used.filter_order": float(designs.printed().fractional.filter_order),
        "used.payload_16": 1e3 * designs.SMALL[0],
        "used.payload_8": 1e3 * designs.SMALL[1],
    }


def _law_of_payloads() -> dict[str, float]:
    arm = designs.rig()
    values = {
        "table1.stiffness": arm.link.beam_stiffness,
        "table1.rigidity": arm.link.stiffness * arm.link.length / 3.0,
    }
    for name, payload in PAYLOADS.items():
        model = designs.link(payload)
        values[f"law5.{name}"] = model.natural_frequency
        # where |Γ/θm| peaks: what a spectrum of the torque shows, in place of (14)
        cosine = -math.cos(math.pi * model.order / 2.0)
        values[f"resonance.torque.{name}"] = (model.natural_frequency**2 / cosine) ** (
            1.0 / model.order
        )
        values[f"resonance.tip.{name}"] = tip_resonance(
            model.natural_frequency, model.order
        )
    return values


def mse_of_table_2(published: Published) -> dict[str, float]:
    """The printed mean squared errors of Table 2 [(N·m)²], by structure."""
    return {
        name: next(
            item.printed
            for item in published.numbers
            if item.id == f"table2_{_slug(name)}_mse"
        )
        for name in _FREE
    }


def _table_2(published: Published) -> dict[str, float]:
    mse = mse_of_table_2(published)
    values = {
        f"table2.aic.{name}": aic(mse[name], SAMPLES, free) / 1e4
        for name, free in _FREE.items()
    }
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
        found = max(
            designed.at_frequency(nominal).gain_crossings,
            key=lambda item: item.frequency,
        )
        gain, order = designs.matched_integer(designed, nominal)
        named = {
            "chi": designed.chi,
            "beta": designed.controller.derivative_order,
            "gain": designed.controller.derivative_gain,
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


def _fits() -> dict[str, float]:
    """Tables 2 and 3 on the twin, under the conditions of the paper and with gain and
    delay fitted in addition.
    """
    values: dict[str, float] = {}
    for name in ("pulse", *PAYLOADS):
        stem = "pulse" if name == "pulse" else f"prbs.{name}"
        for structure, fit in logs.twin_fits(name).items():
            for quantity in ("natural_frequency", "order", "damping", "damping_order"):
                values[f"twin.{stem}.{structure}.{quantity}"] = getattr(
                    fit.model, quantity
                )
            values[f"twin.{stem}.{structure}.mse"] = fit.mse
    for structure, fit in logs.alone("pulse", free=True).items():
        values[f"free.pulse.{structure}.natural_frequency"] = (
            fit.model.natural_frequency
        )
        values[f"free.pulse.{structure}.stiffness"] = fit.model.stiffness
        values[f"free.pulse.{structure}.delay_ms"] = 1e3 * fit.model.gauge_delay
        values[f"free.pulse.{structure}.mse"] = fit.mse
    for which, free in (("twin", False), ("free", True)):
        fractional, damped = joint_models(free)
        values[f"{which}.prbs.joint.order"] = fractional
        (
            values[f"{which}.prbs.joint.damping_order"],
            values[f"{which}.prbs.joint.damping"],
        ) = damped
    return values


def joint_models(free: bool) -> tuple[float, tuple[float, float]]:
    """λ of UD-FOM, and (α, μ) of D-FOM, each common to the three PRBS logs of the twin."""
    damped = logs.joint("D-FOM", free=free).models[0]
    return logs.joint("UD-FOM", free=free).models[0].order, (
        damped.damping_order,
        damped.damping,
    )
