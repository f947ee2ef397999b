"""The recorded logs beside the repository: what identification makes of them."""

from __future__ import annotations

import numpy as np

from fraclink._arm.box import ParameterBox
from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._identify import (
    compare_structures,
    frequency_response,
    identify,
    identify_frequency_response,
)
from identify_logs import ist, line, merced, recorded


def real_logs() -> None:
    log = merced()
    if log is None:
        print("the recorded logs are not there; set FRACLINK_SHARED")
        return
    comparison = compare_structures(log, stiffness=1.3)
    fractional, viscous = comparison.fits["UD-FOM"], comparison.fits["D-IOM"]
    named = {"Merced": (fractional, viscous, 0.0130, 0.0138, 1.987)}
    steep, gentle = ist("a15_f10"), ist("a10_f04")
    assert steep is not None and gentle is not None
    both = compare_structures(steep)
    named["IST a15_f10"] = (
        both.fits["UD-FOM"],
        both.fits["D-IOM"],
        0.0315,
        0.0325,
        1.992,
    )
    for name, (first, second, most, more, order) in named.items():
        for fit, wanted in ((first, most), (second, more)):
            held = fit.heldout_nmse or np.nan
            count = fit.fitted_samples
            variance = np.var((fit.predicted + fit.residual)[count:])
            by_variance = (fit.heldout_mse or np.nan) / variance
            line(
                f"{name}, {fit.structure}: held-out NMSE (over the variance instead)",
                f"{held:.5f} ({by_variance:.5f})",
                f"<= {wanted}",
                held <= wanted,
            )
        found = first.model.order
        line(
            f"{name}: λ, delay {1e3 * first.delay:.2f} ms",
            f"{found:.4f} ± {first.standard_errors['order']:.4f}",
            f"{order} ± 0.003",
            abs(found - order) <= 0.003,
        )
    verdict = compare_structures(gentle)
    line(
        "IST a10_f04: preferred structure",
        verdict.preferred,
        "D-IOM",
        verdict.preferred == "D-IOM",
    )
    nested = [(log, comparison), (steep, both), (gentle, verdict)]
    worst = max(
        c.fits["D-FOM"].mse / min(c.fits["UD-FOM"].mse, c.fits["D-IOM"].mse) - 1
        for _, c in nested
    )
    line(
        "D-FOM never worse than UD-FOM or D-IOM (real logs): worst excess",
        f"{worst:.1e}",
        "<= 1e-6",
        worst <= 1e-6,
    )


def boxes() -> None:
    """Whether the box of one recorded log holds what the other logs of its arm say, and
    the box of all.
    """
    rig = Rig.named(
        "paper-2023"
    )  # for its tolerances: λ ±0.03, ω₀ ±1.5 %, gauge ±5 % and 2 ms
    logs = {
        name: log
        for name in ("a05_f04", "a10_f04", "a15_f10")
        if (log := ist(name)) is not None
    }
    models = {
        name: identify(log, structure="UD-FOM").model for name, log in logs.items()
    }
    for name, model in models.items():
        box = ParameterBox.of(model, rig)
        for other, its in models.items():
            outside = (
                []
                if other == name
                else [key for key in _LINK if not _inside(box, its, key)]
            )
            orders = f"yes; λ {model.order:.3f} and {its.order:.3f}"
            if other != name:
                line(
                    f"box of IST {name} holds {other}; outside:",
                    ", ".join(outside) or "nothing",
                    orders,
                    not outside,
                )
    seen = [model for model in models.values() if model.second_mode is not None]
    if seen:  # one of the logs shows the second mode
        wide = ParameterBox.of(seen[0], rig, others=models.values())
        kept = all(_inside(wide, its, key) for its in models.values() for key in _LINK)
        line(
            "box of one IST log with others=, holds all",
            "yes" if kept else "no",
            "yes",
            kept,
        )


_LINK = ("natural_frequency", "order", "damping", "gauge_gain", "gauge_delay")


def _inside(box: ParameterBox, model: LinkModel, name: str) -> bool:
    low, high = getattr(box, name)
    return bool(low <= getattr(ParameterBox.at(model), name)[0] <= high)


def daisy() -> None:
    path = recorded("daisy_robot_arm", "robot-arm.csv")
    if path is None:
        return
    data = np.genfromtxt(path, delimiter=",", names=True)
    found = frequency_response(data["u"], data["y"])
    fit = identify_frequency_response(
        found.frequency,
        found.response,
        weights=found.magnitude,
        resonances=2,
        anti_resonances=2,
    )
    line(
        "DaISy arm: one common λ of 7 parameters",
        f"{fit.order:.4f}",
        "1.994 ± 0.002",
        abs(fit.order - 1.994) <= 0.002,
    )
    line(
        "DaISy arm: fit of the excited lines",
        f"{fit.fit:.2f} %",
        ">= 97.3 %",
        fit.fit >= 97.3,
    )
