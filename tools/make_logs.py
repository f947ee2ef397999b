"""Write the bundled logs src/fraclink/data/logs/*.csv from the digital twin.

    python tools/make_logs.py [FOLDER]

The rig is the paper's: c = 1.56 N·m/rad measured, L = 0.65 m, so EI = c L/3; a carbon
rod of 7.35 g (3 mm diameter, 1600 kg/m³), power-law damping with λ = 1.92, the hub
driven by the motor servo M(s) with p = 80 rad/s, 20 s at 4 ms. Typical imperfections of
a laboratory are included: 1.2 % of the signal's power as gauge noise, an offset, the
steps of a 12-bit converter over ±2.5 N·m, an encoder of 20 000 counts, and 2 ms in the
strain amplifier.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.rig import Encoder, Gauge
from fraclink.extend import Beam, PowerLaw

sys.path.insert(0, str(Path(__file__).parents[1]))
from reproduce.twin_logs import simulate_log

PERIOD, SAMPLES = 0.004, 5001
STIFFNESS, LENGTH, LINK_MASS = 1.56, 0.65, 0.00735
# relative to the mean square of the torque: the NMSE of a perfect model
NOISE_SHARE = 0.012


def prbs(
    seed: int, *, amplitude: float = 0.1, hold: int = 60, rest: int = 125
) -> NDArray[np.float64]:
    """Maximum-length sequence of a seven-bit register, each bit held 0.24 s (half a
    vibration), after 0.5 s of rest.
    """
    register = seed
    values = np.zeros(SAMPLES)
    for start in range(rest, SAMPLES, hold):
        bit = ((register >> 6) ^ (register >> 5)) & 1
        register = ((register << 1) | bit) & 0x7F
        values[start : start + hold] = amplitude if register & 1 else -amplitude
    return values


def pulse() -> NDArray[np.float64]:
    """Raise the hub by 0.2 rad for 7 s; it falls at 12.5 s, in the part that is held
    out.

    The paper's pulse has the same width and 1 rad; reproduce/logs.py makes that one.
    """
    values = np.zeros(SAMPLES)
    values[1375 : 1375 + 1750] = 0.2
    return values


def build() -> dict[str, str]:
    """Return the text of every bundled log by its name."""
    result = {}
    cases = (
        ("prbs_30g", 0.030, prbs(0x5B), 30),
        ("prbs_20g", 0.020, prbs(0x2D), 20),
        ("prbs_40g", 0.040, prbs(0x13), 40),
        ("pulse_30g", 0.030, pulse(), 130),
    )
    for name, payload, reference, seed in cases:
        beam = Beam(LENGTH, STIFFNESS * LENGTH / 3.0, LINK_MASS, payload)
        damping = PowerLaw(1.92)
        clean = simulate_log(beam, damping, reference, period=PERIOD)
        rms = float(np.sqrt(np.mean((clean.torque - np.mean(clean.torque)) ** 2)))
        encoder = Encoder(counts_per_revolution=20_000)
        gauge = Gauge(
            noise=float(f"{rms * NOISE_SHARE**0.5:.2g}"),
            offset=0.02,
            quantum=5.0 / 4096,
            limit=2.5,
        )
        log = simulate_log(
            beam,
            damping,
            reference,
            period=PERIOD,
            encoder=encoder,
            gauge=gauge,
            gauge_delay=0.002,
            seed=seed,
            title=f"simulated {name.split('_')[0]} test of the paper's arm with {payload * 1e3:.0f} g",
        )
        result[f"{name}.csv"] = log.text()
    return result


def main() -> None:
    """Write the logs and print their sizes."""
    folder = (
        Path(sys.argv[1])
        if len(sys.argv) > 1
        else Path(__file__).parents[1] / "src/fraclink/data/logs"
    )
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in build().items():
        (folder / name).write_text(text, encoding="utf-8")
        print(f"{name}: {len(text.encode()) / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
