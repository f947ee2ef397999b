"""From a log to C code: identify the arm, design for 20 to 40 g, prove the margins,
write the firmware.

python examples/log_to_board.py FOLDER
"""

import sys
from pathlib import Path

import fraclink as fl


def main(folder: Path) -> None:
    rig = fl.Rig.named("paper-2023-geared")
    log = fl.read_log(fl.bundled_log("prbs_30g"), rig=rig)
    fit = fl.identify(log)
    print(
        f"order {fit.model.order:.3f}, {100 * fit.heldout_nmse:.1f} % error on samples that were held out"
    )

    design = fl.design(
        fit, rig, payloads=(0.020, 0.040), gain_crossover=11.5, phase_margin=fl.deg(50)
    )
    certificate = fl.certify(design)
    print(
        f"proved for every payload: {certificate.passed}, |1 + L| > {certificate.statement.modulus:.2f}"
    )

    for path in fl.export_c(fl.discretize(design), folder / "firmware"):
        print(path.name)
    fl.save(design, folder / "design.json")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
