"""Print the README's comparison: `python tools/make_comparison.py`.

A move of 60° in 0.5 s on the twin of the bundled arm under fraclink and the rivals of
`fraclink compare`, each tuned for 20 to 40 g by its rule. tests/test_readme.py compares
the README with this output.
"""

from __future__ import annotations

import math

import fraclink as fl
from fraclink.trials import Standing, compare

RIVALS = {
    "fraclink": "**fraclink**",
    "LQG": "LQG, integer-order model",
    "PD on the tip": "PD on the tip",
    "ZV shaping": "motor PID, input shaping (ZV)",
    "motor PID alone": "motor PID alone",
}
GROUPS = ((0.020, 0.030, 0.040), (0.008,), (0.080,))  # payloads [kg] of a column
HEAD = (
    "| controller | at rest, 20 to 40 g | 8 g | 80 g | tip error after a gauge drift | noise at the motor |",
    "|---|---|---|---|---|---|",
)


def standings(design: fl.Design, payloads: tuple[float, ...]) -> dict[str, Standing]:
    """Fraclink and its rivals, each judged at the worst of these payloads [kg]."""
    move = fl.smooth_step(math.radians(60.0), 0.5)
    result = compare(design, payloads=payloads, reference=move, names=list(RIVALS))
    return {standing.name: standing for standing in result.standings}


def table() -> list[str]:
    """The lines of the table."""
    rig = fl.Rig.named("paper-2023-geared")
    design = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(45),
    )
    groups = [standings(design, payloads) for payloads in GROUPS]
    lines = list(HEAD)
    for name, words in RIVALS.items():
        times = [group[name].worst_settling for group in groups]
        rests = [f"{time:.1f} s" if math.isfinite(time) else "never" for time in times]
        standing = groups[0][name]
        error = f"{1e3 * standing.offset_error:.1f} mrad"
        noise = f"{1e3 * standing.motor_reference_noise:.1f} mrad"
        lines.append(f"| {' | '.join([words, *rests, error, noise])} |")
    return lines


if __name__ == "__main__":
    print("\n".join(table()))
