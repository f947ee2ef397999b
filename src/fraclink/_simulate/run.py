"""One run of the closed loop, whatever arm it was made on: the model, the twin, or a real one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fraclink._npz import kind_of, read_npz, write_npz
from fraclink._simulate.metrics import Metrics, Signals, Verdict, judge, measure
from fraclink.errors import FileFormatError
from fraclink.findings import Finding

__all__ = ["Run", "judged_run"]

Real = NDArray[np.float64]
Bits = NDArray[np.uint32]

FORMAT = 2
SIGNALS = (
    "time",
    "reference",
    "tip_angle",
    "motor_angle",
    "motor_reference",
    "torque",
    "motor_angle_measured",
    "torque_measured",
    "tip_estimate",
    "voltage",
    "mode",
    "reason",
    "flags",
)


@dataclass(frozen=True, eq=False)
class Run:
    """A run of the closed loop, one value per control period, each at the period's beginning; shape (N,).

    A signal that this arm does not have is NaN: nobody measures the tip of a real arm.

    Parameters
    ----------
    time
        [s].
    reference
        θt* of the tip [rad].
    tip_angle
        θt [rad].
    motor_angle
        θm at the gear's output [rad].
    motor_reference
        θm*, which the law gave [rad].
    torque
        Γ at the root of the link [N·m].
    motor_angle_measured
        what the encoder said [rad].
    torque_measured
        what the gauge said [N·m].
    tip_estimate
        θm − Γ/c as the law saw it [rad].
    voltage
        of the motor [V]; behind an ideal motor loop the one that it needs, compensations left out.
    mode, reason, flags
        of the law, see law.h.
    payload
        mass at the tip when the run began [kg]; NaN where only the natural frequency was known.
    metrics
        figures of the run.
    verdict
        whether it passed, and why.
    about
        what was run: plain values by name, among them "arm": "model", "twin" or "real".
    findings
        what a reader should know about the run.
    extras
        signals that only some arms have, by name, e.g. the twin's "contact_force" [N].
    finished
        False where the arm left every bound and the run was cut.

    Examples
    --------
    >>> import fraclink as fl
    >>> rig = fl.Rig.named("paper-2023")
    >>> law = fl.Controller(gain=0.069876, order=0.612197, link=rig.model).discretize(rig.period, order=4)
    >>> run = fl.simulate(law, fl.smooth_step(1.0, 0.5), rig=rig, model=rig.model, duration=2.0)
    >>> len(run.time), run.payload, run.about["motor_loop"]
    (501, 0.03, 'ideal')
    """

    time: Real
    reference: Real
    tip_angle: Real
    motor_angle: Real
    motor_reference: Real
    torque: Real
    motor_angle_measured: Real
    torque_measured: Real
    tip_estimate: Real
    voltage: Real
    mode: Bits
    reason: Bits
    flags: Bits
    payload: float
    metrics: Metrics
    verdict: Verdict
    about: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    extras: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    finished: bool = True

    def __post_init__(self) -> None:
        for name in SIGNALS:
            getattr(self, name).flags.writeable = False
        for values in self.extras.values():
            values.flags.writeable = False

    @property
    def period(self) -> float:
        """Control period [s]."""
        return float(self.time[1] - self.time[0])

    @property
    def error(self) -> Real:
        """Reference minus tip angle [rad]."""
        return np.asarray(self.reference - self.tip_angle)

    def save(self, path: Path | str) -> None:
        """Write signals, metrics and what was run to one NPZ file, complete or not at all."""
        about = {
            "metrics": {k: v if math.isfinite(v) else str(v) for k, v in asdict(self.metrics).items()},
            "verdict": asdict(self.verdict),
            "about": dict(self.about),
            "payload": self.payload if math.isfinite(self.payload) else str(self.payload),
            "findings": [asdict(finding) for finding in self.findings],
            "finished": self.finished,
        }
        extras = {f"extra_{name}": values for name, values in self.extras.items()}
        write_npz(path, "run", FORMAT, about, {name: getattr(self, name) for name in SIGNALS} | extras)

    @classmethod
    def load(cls, path: Path | str) -> Run:
        """Read back what `save` wrote, in this format or the first; FileFormatError for anything else."""
        kind = "twin-run" if kind_of(path) == "twin-run" else "run"
        about, arrays = read_npz(path, kind, (1,) if kind == "twin-run" else (1, FORMAT))
        try:
            if about["format"] == 1:
                about, arrays = _upgraded(about, arrays)
            return cls(
                **{name: arrays.pop(name) for name in SIGNALS},
                metrics=Metrics(**{k: float(v) for k, v in about["metrics"].items()}),
                verdict=Verdict(**about["verdict"]),
                payload=float(about["payload"]),
                about=about["about"],
                findings=tuple(Finding(**finding) for finding in about["findings"]),
                extras={name.removeprefix("extra_"): values for name, values in arrays.items()},
                finished=bool(about["finished"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FileFormatError(
                "run",
                str(path),
                "not a run",
                allowed="an NPZ of Run.save",
                remedy="give a file that Run.save wrote",
            ) from error


def _upgraded(about: Mapping[str, Any], arrays: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A file of format 1, of the model ("run") or of the twin ("twin-run"), as format 2 has it."""
    twin = about["fraclink"] == "twin-run"
    unknown = np.full(len(arrays["time"]), math.nan)
    settings = {"arm": "twin", **about["about"]} if twin else {"arm": "model", **about["settings"]}
    signals = {name: arrays.get(name, unknown) for name in SIGNALS}
    payload = arrays["payload"][0] if twin else None
    if not twin:
        payload = settings.pop("payload")
        settings["motor_loop"] = settings.pop("inner")
    extras = {f"extra_{name}": values for name, values in arrays.items() if name not in SIGNALS}
    told = {"metrics": about["metrics"], "verdict": about["verdict"], "about": settings, "findings": []}
    told["payload"] = str(math.nan if payload is None else payload)
    return told | {"finished": about.get("finished", True)}, signals | extras


def judged_run(
    signals: Mapping[str, NDArray[Any]],
    *,
    payload: float,
    period: float,
    ended: float,
    vibration_period: float,
    about: Mapping[str, Any],
    findings: tuple[Finding, ...] = (),
    extras: Mapping[str, NDArray[Any]] | None = None,
    finished: bool = True,
) -> Run:
    """Return the run of the named signals, all but `time`, measured and judged.

    Parameters
    ----------
    payload
        [kg].
    period
        [s].
    ended
        when the reference came to rest [s].
    vibration_period
        of the link [s].
    """
    judged = ("reference", "tip_angle", "motor_reference", "voltage", "flags", "mode", "reason")
    rows = (signals[name][None, :] for name in judged)
    block = Signals(*rows, period, np.array([ended]), np.array([vibration_period]))
    metrics = measure(block)
    return Run(
        time=period * np.arange(len(signals["reference"]), dtype=np.float64),
        **signals,
        payload=payload,
        metrics=metrics,
        verdict=judge(block, metrics),
        about=about,
        findings=findings,
        extras=extras or {},
        finished=finished,
    )
