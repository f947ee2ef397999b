"""Move an arm with a distributed mass that loses a third of its payload on the way.

python examples/payload_that_drops.py FOLDER
"""

import sys
from pathlib import Path

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
    # kg: a carbon rod, which is not part of the design
    arm = fl.Twin.from_rig(rig, link_mass=0.00735)
    move = fl.smooth_step(1.0, duration=1.0)
    for name, events in (
        ("30 g", []),
        ("30 g, then 20 g", [fl.extend.PayloadChange(time=0.6, payload=0.020)]),
    ):
        run = fl.simulate(
            fl.discretize(design), move, arm=arm, duration=4.0, events=events
        )
        print(f"{name}: {run.verdict}")
    fl.save(run, folder / "run.npz")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
