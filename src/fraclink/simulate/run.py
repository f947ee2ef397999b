"""One simulated run: signals, metrics, verdict and what produced them."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fraclink.errors import FileFormatError
from fraclink.files import atomic_write
from fraclink.simulate.metrics import Metrics, Verdict

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
LARGEST = 400_000_000  # bytes of a run's arrays: 2 000 000 samples, all signals


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
            "fraclink": "run",
            "format": FORMAT,
            "units": "SI, radians",
            "metrics": {k: v if math.isfinite(v) else str(v) for k, v in asdict(self.metrics).items()},
            "verdict": asdict(self.verdict),
            "settings": asdict(self.settings),
        }
        with atomic_write(path, "wb") as stream:
            np.savez(stream, about=np.array(json.dumps(about)), **{n: getattr(self, n) for n in _SIGNALS})

    @classmethod
    def load(cls, path: Path | str) -> Run:
        """Read back what `save` wrote; FileFormatError for anything else."""
        import zipfile

        remedy = "give a file that Run.save wrote"
        try:
            # Sizes come from the archive's directory, before anything is unpacked.
            with zipfile.ZipFile(path) as archive:
                size = sum(item.file_size for item in archive.infolist())
                if size > LARGEST:
                    raise FileFormatError(
                        "run", size, "too large", allowed=f"<= {LARGEST} bytes", remedy=remedy
                    )
            with np.load(path, allow_pickle=False) as data:
                about = json.loads(str(data["about"]))
                if about.get("fraclink") != "run" or about.get("format") != FORMAT:
                    raise FileFormatError(
                        "format", about.get("format"), "not a run", allowed=str(FORMAT), remedy=remedy
                    )
                signals = {name: np.array(data[name]) for name in _SIGNALS}
            return cls(
                **signals,
                metrics=Metrics(**{k: float(v) for k, v in about["metrics"].items()}),
                verdict=Verdict(**about["verdict"]),
                settings=Settings(**about["settings"]),
            )
        except (OSError, KeyError, TypeError, ValueError, AttributeError, zipfile.BadZipFile) as error:
            if isinstance(error, FileFormatError):
                raise
            raise FileFormatError(
                "run", str(path), "not a run", allowed="an NPZ of Run.save", remedy=remedy
            ) from error
