"""Logs as a servo-driven rig of the paper would record them: the twin's link on a hub
that follows M(s) of equation (21), whatever torque the link exerts on it.

The bundled logs (tools/make_logs.py) and the reproduction's own are made here. The twin
of fraclink has a motor instead, and its runs hold the readings of its sensors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.rig import Encoder, Gauge
from fraclink._simulate.kernel import delay_line
from fraclink._simulate.plant import LONGEST_STEP, Plant, assemble, substeps
from fraclink.extend import Beam, FractionalKelvinVoigt, KelvinVoigt, PowerLaw

__all__ = ["TwinLog", "marched", "on_servo", "simulate_log"]

Real = NDArray[np.float64]
EXACT, QUIET = Encoder(), Gauge()


@dataclass(frozen=True)
class TwinLog:
    """time [s], motor_angle [rad] and torque [N·m] as measured by the sensors, the true
    values, and the header lines of the file.
    """

    time: Real
    motor_angle: Real
    torque: Real
    tip_angle: Real
    true_torque: Real
    header: Mapping[str, str]

    def text(self) -> str:
        """Return the text of the file."""
        lines = [f"# {key}: {value}" for key, value in self.header.items()]
        lines.append("time_s,motor_angle_rad,torque_Nm")
        # Nine digits resolve a thousandth of the finest quantum and keep the files
        # short.
        rows = np.column_stack([self.time, self.motor_angle, self.torque]).tolist()
        lines += [f"{t:.9g},{a:.9g},{g:.9g}" for t, a, g in rows]
        return "\n".join(lines) + "\n"


def on_servo(plant: Plant, pole: float = 80.0) -> Plant:
    """Return the plant with its hub driven by v̇ = p²(θ* − θm) − 2 p v: M(s) of (21),
    without the moment of the link.
    """
    dynamics, inputs = plant.dynamics.copy(), plant.inputs.copy()
    dynamics[1], inputs[1] = 0.0, 0.0
    dynamics[1, :2], inputs[1, 0] = (-(pole**2), -2.0 * pole), pole**2
    return replace(plant, dynamics=dynamics, inputs=inputs)


def marched(plant: Plant, inputs: Real, step: float) -> Real:
    """Return the outputs after each step [s] of an input that is constant over the
    step, starting from rest.
    """
    exact = plant.discretise(step)
    states = np.zeros((len(inputs) + 1, exact.hub.size))
    for k, value in enumerate(inputs.tolist()):
        states[k + 1] = states[k, : exact.order] @ exact.transition + value * exact.hub
    return np.asarray(states[1:] @ exact.outputs.T)


def simulate_log(
    beam: Beam,
    damping: KelvinVoigt | FractionalKelvinVoigt | PowerLaw,
    reference: Real,
    *,
    period: float = 0.004,
    encoder: Encoder = EXACT,
    gauge: Gauge = QUIET,
    gauge_delay: float = 0.0,
    modes: int | None = None,
    pole: float = 80.0,
    seed: int = 0,
    title: str = "",
) -> TwinLog:
    """Return the log for a hub reference [rad] with one value per period, held over the
    period.
    """
    count = substeps(period, LONGEST_STEP)
    fine = period / count
    free = assemble(beam, damping, modes=modes, step=fine, hub_inertia=1.0)
    plant = on_servo(free, pole)
    inputs = np.repeat(reference[:-1] - reference[0], count)
    # Linear and initially at rest: an offset only affects the angles.
    outputs = np.vstack([np.zeros(6), marched(plant, inputs, fine)])
    hub = outputs[::count, 0] + reference[0]
    torque = outputs[:, 3]
    # The delay is applied at the fine steps before sampling, so a delay of half a
    # period is not rounded.
    oldest, weights = delay_line(gauge_delay / fine)
    late = np.concatenate([np.zeros(oldest), torque])
    parts = (w * late[i : i + torque.size] for i, w in enumerate(weights) if w)
    reading = np.asarray(sum(parts))[::count] + gauge.offset
    noise = np.random.default_rng(seed).standard_normal(reading.size)
    reading = np.clip(reading + gauge.noise * noise, -gauge.limit, gauge.limit)
    if gauge.quantum:
        reading = np.round(reading / gauge.quantum) * gauge.quantum
    angle, line = hub, encoder.resolution
    if line:
        angle = np.floor(hub / line + 0.5) * line
    counts = encoder.counts_per_revolution
    header = {
        **({"title": title} if title else {}),
        "simulated": "true",
        "source": "digital twin of fraclink, tools/make_logs.py",
        "columns": "time_s [s], motor_angle_rad [rad], torque_Nm [N m]",
        "period_s": f"{period:g}",
        "payload_kg": f"{beam.payload:.3f}",
        "link_mass_kg": f"{beam.link_mass:g}",
        "length_m": f"{beam.length:g}",
        "flexural_rigidity_Nm2": f"{beam.flexural_rigidity:.6g}",
        "stiffness_Nm": f"{beam.stiffness:.6g}",
        "damping": damping.label,
        "modes_rad_per_s": " ".join(f"{w:.6g}" for w in plant.modes.frequencies),
        "step_s": f"{fine:g}",
        "hub": f"servo with double pole at {pole:g} rad/s",
        "encoder_counts": str(counts) if counts else "none",
        "gauge_noise_Nm": f"{gauge.noise:g}",
        "gauge_offset_Nm": f"{gauge.offset:g}",
        "gauge_drift_Nm_per_s": "0",
        "gauge_quantum_Nm": f"{gauge.quantum:g}",
        "gauge_delay_s": f"{gauge_delay:g}",
        "seed": str(seed),
    }
    time = np.round(period * np.arange(reading.size), 9)
    return TwinLog(
        time,
        angle,
        reading,
        outputs[::count, 2] + reference[0],
        torque[::count],
        header,
    )
