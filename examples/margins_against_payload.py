"""What is left of the margins at each payload, inside and outside the range of the
design, as a figure.

python examples/margins_against_payload.py FOLDER
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import fraclink as fl


def main(folder: Path) -> None:
    rig = fl.Rig.named("paper-2023-geared")
    design = fl.design(
        rig.model,
        rig,
        payloads=(0.020, 0.040),
        gain_crossover=12.0,
        phase_margin=fl.deg(50),
    )
    for payload in (0.008, 0.020, 0.030, 0.040, 0.060):
        left = design.sampled_at(payload)
        print(
            f"{1e3 * payload:2.0f} g: {np.degrees(left.phase_margin):5.1f}°, Ms {1 / left.modulus_margin:.2f}"
        )

    masses = np.linspace(0.008, 0.060, 40)
    curve = fl.extend.margin_curve(design, masses)
    plt.plot(1e3 * masses, np.degrees(curve.phase_margin))
    plt.axvspan(*(1e3 * payload for payload in design.payloads), alpha=0.2)
    plt.axhline(50.0, linestyle="--")
    plt.xlabel("payload [g]; shaded: design range")
    plt.ylabel("phase margin [°]")
    plt.savefig(folder / "margins.svg")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
