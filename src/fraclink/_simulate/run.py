"""One simulated run: signals, metrics, verdict and what produced them."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink._npz import read_npz, write_npz
from fraclink._simulate.metrics import Metrics, Verdict
from fraclink.errors import FileFormatError

__all__ = ["Run", "Settings"]

Real = NDArray[np.float64]

_SIGNALS = (
    "time",
    "reference",
    "tip_angle",
    "motor_angle",
    "motor_reference",
    "torque",
    "torque_measured",
    "voltage",
    "tip_estimate",
    "flags",
    "mode",
    "reason",
)
FORMAT = 1


@dataclass(frozen=True)
class Settings:
    """How a run was made; with the law's digest it repeats it bit for bit."""

    rig: str
    law_sha256: str
    payload: float | None
    inner: str
    gauge_offset: float
    noise: float
    seed: int
    delay_samples: int
    substeps: int
    compensation: str


@dataclass(frozen=True, eq=False)
class Run:
    """A simulated closed loop at the control period; every signal has shape (N,).

    time [s], reference θt* [rad], tip_angle θt [rad], motor_angle θm [rad], motor_reference θm* [rad],
    torque Γ and torque_measured (what the gauge said) [N·m], voltage [V], tip_estimate θm − Γ/c as the law
    saw it [rad], and the law's flags, mode and reason. `metrics` and `verdict` judge it, `settings` repeat
    it. With inner="ideal" the voltage is the one that the ideal motor loop needs, compensations left out.

    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.Controller(gain=0.069876, order=0.612197, link=rig.model).discretize(rig.period, order=4)
    >>> run = fl.simulate(rig, rig.model, law, fl.smooth_step(1.0, 0.5), duration=2.0)
    >>> len(run.time), run.payload, run.settings.inner
    (501, 0.03, 'ideal')
    """

    time: Real
    reference: Real
    tip_angle: Real
    motor_angle: Real
    motor_reference: Real
    torque: Real
    torque_measured: Real
    voltage: Real
    tip_estimate: Real
    flags: NDArray[np.uint32]
    mode: NDArray[np.uint32]
    reason: NDArray[np.uint32]
    metrics: Metrics
    verdict: Verdict
    settings: Settings

    def __post_init__(self) -> None:
        for name in _SIGNALS:
            getattr(self, name).flags.writeable = False

    @property
    def payload(self) -> float:
        """Payload of the run [kg]; NaN where only the natural frequency was known."""
        return math.nan if self.settings.payload is None else self.settings.payload

    def save(self, path: Path | str) -> None:
        """Write signals, metrics and settings to one NPZ file, complete or not at all."""
        about = {
            "metrics": {k: v if math.isfinite(v) else str(v) for k, v in asdict(self.metrics).items()},
            "verdict": asdict(self.verdict),
            "settings": asdict(self.settings),
        }
        write_npz(path, "run", FORMAT, about, {name: getattr(self, name) for name in _SIGNALS})

    @classmethod
    def load(cls, path: Path | str) -> Run:
        """Read back what `save` wrote; FileFormatError for anything else."""
        about, signals = read_npz(path, "run", (FORMAT,))
        try:
            return cls(
                **{name: signals[name] for name in _SIGNALS},
                metrics=Metrics(**{k: float(v) for k, v in about["metrics"].items()}),
                verdict=Verdict(**about["verdict"]),
                settings=Settings(**about["settings"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(
                "run",
                str(path),
                "not a run",
                allowed="an NPZ of Run.save",
                remedy="give a file that Run.save wrote",
            ) from error
