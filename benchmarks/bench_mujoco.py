"""A flexible arm in MuJoCo (multibody dynamics that nobody here wrote), tuned and then
moved by the law that ships: the true settling time of the tip against the printed one of
the worst case.

The link is a chain of rigid segments with springs between them, on a hub with friction,
an encoder in counts and a gauge that reads the first spring late. MuJoCo is no
dependency of fraclink (`pip install mujoco`); without it nothing is measured.
"""

from __future__ import annotations

import math
from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np

from bench_arms import tried
from harness import line, sizes

try:
    import mujoco
except ImportError:
    mujoco = None

SEGMENTS = 8
STEP = 1e-4  # [s] of the simulation
# L [m], c [N·m/rad], masses of link and payload [kg], ζ of the first mode, and J
# [kg·m²], K [N·m/V], ν [N·m·s], Coulomb torque [N·m] of the motor
PLAIN = {
    "length": 0.60,
    "stiffness": 1.7,
    "link": 0.010,
    "payload": 0.030,
    "damping": 0.02,
    "inertia": 0.020,
    "gain": 0.22,
    "friction": 0.30,
    "coulomb": 0.10,
    "gauge_delay": 0.002,
    "gauge_noise": 0.004,
    "T": 0.004,
}
LIMITS = (math.radians(40.0), 4.0, 1.5, 10.0)
ARMS = {
    "plain": (PLAIN, LIMITS, ""),
    "aluminium": (PLAIN | {"damping": 0.005}, LIMITS, ""),
    "heavy link": (PLAIN | {"link": 0.030}, LIMITS, ""),
    "long and slow": (
        PLAIN
        | {"length": 0.90, "stiffness": 1.2, "payload": 0.060, "link": 0.015}
        | {"inertia": 0.050, "gain": 0.40, "friction": 0.60},
        (math.radians(40.0), 3.0, 1.2, 10.0),
        "",
    ),
}


class Arm:
    """An arm as `fraclink.Callback` and `bench_arms` move it; `rows` holds the tip's
    angle [rad] of each period.
    """

    def __init__(self, *, seed: int = 0, lost: float = 0.0, **changes: float) -> None:
        self.p = p = PLAIN | changes
        assert not lost  # no sample is lost here
        length, part = p["length"], p["length"] / SEGMENTS
        # With springs of one stiffness k a force at the tip bends the chain by Σ d²/k.
        reach = length - part * np.arange(SEGMENTS)
        self._spring = p["stiffness"] * float(np.sum(reach**2)) / length**2
        frequency = math.sqrt(p["stiffness"] / p["payload"]) / length
        drag = 2.0 * p["damping"] / frequency * self._spring
        inner, outer = "", ""
        for k in range(SEGMENTS):
            inner += (
                f'<body pos="{part if k else 0} 0 0"><joint axis="0 0 1" stiffness="{self._spring}" '
                f'damping="{drag}"/><geom type="capsule" fromto="0 0 0 {part} 0 0" size="0.002" '
                f'mass="{p["link"] / SEGMENTS}"/>'
            )
            outer += "</body>"
        tip = (
            f'<geom type="sphere" pos="{part} 0 0" size="0.002" mass="{p["payload"]}"/>'
            f'<site name="tip" pos="{part} 0 0"/>'
        )
        hub = (
            f'<joint name="hub" axis="0 0 1" armature="{p["inertia"]}" damping="{p["friction"]}" '
            f'frictionloss="{p["coulomb"]}"/>'
            '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>'
        )
        self._model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{STEP}" gravity="0 0 0" integrator="implicit">'
            '<flag contact="disable"/></option><worldbody><body>'
            f"{hub}{inner}{tip}{outer}</body></worldbody></mujoco>"
        )
        self._data = mujoco.MjData(self._model)
        self._noise = np.random.default_rng(seed)
        # the gauge's readings that have not arrived yet
        late = round(p["gauge_delay"] / STEP)
        self._late: deque[float] = deque([0.0] * (late + 1), maxlen=late + 1)
        self.rows: list[tuple[float]] = []

    def sense(self) -> tuple[float, float]:
        """Motor angle in counts of a 14-bit encoder [rad], and the gauge [N·m]."""
        count = 2.0 * math.pi / 2**14
        angle = count * math.floor(float(self._data.qpos[0]) / count)
        noise = self.p["gauge_noise"] * self._noise.standard_normal()
        return angle, self._late[0] + noise

    def step(self, voltage: float) -> None:
        """A period under a voltage [V]."""
        x, y, _ = self._data.site("tip").xpos
        self.rows.append((math.atan2(y, x) if self.rows else 0.0,))
        for _ in range(round(self.p["T"] / STEP)):
            self._data.qfrc_applied[0] = self.p["gain"] * voltage
            mujoco.mj_step(self._model, self._data)
            # The motor leads the bent link: the first spring turns against it.
            self._late.append(-self._spring * float(self._data.qpos[1]))

    def read(self) -> tuple[float, float]:
        """As `fraclink.Callback` reads it."""
        return self.sense()

    def write(self, command: Any) -> None:
        """As `fraclink.Callback` drives it."""
        self.step(0.0 if command.mode in (0, 4) else command.voltage)


def main() -> None:
    """Print every arm."""
    given = sizes(__doc__, arms=(len(ARMS), 1))
    if mujoco is None:
        line("arms in MuJoCo", "no mujoco", "there", None)
        return
    names = list(ARMS)[: given.arms]
    results = [
        tried(SimpleNamespace(ARMS=ARMS, Arm=Arm), name, False) for name in names
    ]
    line(
        "arms in MuJoCo with a law, and no move with a given payload later than printed",
        f"{sum(map(bool, results))} of {len(results)} arms",
        "all",
        all(results),
    )


if __name__ == "__main__":
    main()
