"""Identify from arrays, without a file: here they are computed, on your bench they come
from the recorder.

python examples/arrays_of_your_own.py
"""

import numpy as np

import fraclink as fl
import fracsys

PERIOD = 0.004  # s
ORDER, STIFFNESS, FREQUENCY = 1.90, 1.56, 11.0  # λ, c [N·m/rad], ω₀ [s^(-λ/2)]


def main() -> None:
    s = fracsys.s
    time = PERIOD * np.arange(5000)
    motor_angle = fl.prbs(0.2, 0.157).angle(time)
    link = STIFFNESS * s**ORDER / (s**ORDER + FREQUENCY**2)
    torque = fracsys.time_response(link, motor_angle, PERIOD).output
    torque = torque + 0.002 * np.random.default_rng(1).standard_normal(
        torque.size
    )  # N·m

    log = fl.Experiment(PERIOD, motor_angle, torque, payload=0.030)
    fit = fl.identify(log, "UD-FOM")
    for name in ("order", "natural_frequency"):
        print(
            f"{name} = {getattr(fit.model, name):.4f} ± {fit.standard_errors[name]:.4f}"
        )


if __name__ == "__main__":
    main()
