"""Calculate with powers of s as with a transfer function: poles, margins, responses, a
rational stand-in.

python examples/fractional_systems.py
"""

import numpy as np

import fracsys


def main() -> None:
    s = fracsys.s
    link = 100 / (s**1.92 + 100)
    controller = 0.07 * s**0.61
    margins = fracsys.margins(controller * link)
    print("poles:", np.round(fracsys.poles(link), 3))
    print(
        f"phase margin {np.degrees(margins.phase_margin):.2f}° at {margins.gain_crossover:.2f} rad/s"
    )

    times = np.linspace(0.0, 2.0, 401)
    exact = fracsys.step_response(link, times).output
    print(f"step response: peak {exact.max():.3f} at {times[exact.argmax()]:.2f} s")

    rational = fracsys.approximate(link, band=(0.1, 300.0), order=6, method="minimax")
    print(
        f"{rational.order} poles: at most {rational.error_db:.4f} dB and {rational.error_deg:.3f}° off"
    )


if __name__ == "__main__":
    main()
