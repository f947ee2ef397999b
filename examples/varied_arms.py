"""Run one law on 2000 varied arms, and ask how many fail and what drives the
settling time.

python examples/varied_arms.py FOLDER
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
    campaign = fl.trials.Campaign.of(
        rig, rig.model, fl.discretize(design), runs=2000, seed=1
    )
    runs = fl.trials.run_campaign(campaign)
    fl.save(runs, folder / "arms.npz", force=True)
    summary = runs.summary
    print(summary.failure.sentence)
    settling = next(
        metric for metric in summary.metrics if metric.name == "settling_time"
    )
    for parameter, correlation in settling.drivers[:3]:
        print(f"settling time against {parameter}: rank correlation {correlation:+.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
