"""From the log of a flexible-link robot to the fractional-order controller on its board.

Public names are loaded when they are first used: ``import fraclink`` itself loads numpy only.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public name -> module that defines it. The tests guard the list; add the same name below TYPE_CHECKING.
_HOME: dict[str, str] = {
    "Controller": "fraclink._arm.controller",
    "Design": "fraclink._design",
    "Experiment": "fraclink._arm.experiment",
    "Fit": "fraclink._identify",
    "FractionalTransferFunction": "fraclink._systems.fractional",
    "Law": "fraclink._law",
    "LinkModel": "fraclink._arm.link",
    "Rig": "fraclink._arm.rig",
    "Run": "fraclink._simulate",
    "Twin": "fraclink._simulate",
    "approximate": "fraclink._systems.rational",
    "bundled_log": "fraclink._logs",
    "certify": "fraclink._certify",
    "chirp": "fraclink._arm.reference",
    "deg": "fraclink._design",
    "design": "fraclink._design",
    "diagnose": "fraclink._logs",
    "discretize": "fraclink._law",
    "export_c": "fraclink._export",
    "from_control": "fraclink._systems.interop",
    "hold": "fraclink._arm.reference",
    "identify": "fraclink._identify",
    "identify_all": "fraclink._identify",
    "inspect_log": "fraclink._logs",
    "is_stable": "fraclink._systems.stability",
    "load": "fraclink._files",
    "margins": "fraclink._systems.margins",
    "norm": "fraclink._systems.norms",
    "poles": "fraclink._systems.stability",
    "prbs": "fraclink._arm.reference",
    "pulse": "fraclink._arm.reference",
    "read_log": "fraclink._logs",
    "run": "fraclink._workflow",
    "s": "fraclink._systems.fractional",
    "save": "fraclink._files",
    "simulate": "fraclink._simulate",
    "smooth_step": "fraclink._arm.reference",
    "step_response": "fraclink._systems.response",
    "time_response": "fraclink._systems.response",
    "write_report": "fraclink._show.report",
}

if TYPE_CHECKING:  # what editors and type checkers see; nothing of this runs
    from fraclink._arm.controller import Controller as Controller
    from fraclink._arm.experiment import Experiment as Experiment
    from fraclink._arm.link import LinkModel as LinkModel
    from fraclink._arm.reference import chirp as chirp
    from fraclink._arm.reference import hold as hold
    from fraclink._arm.reference import prbs as prbs
    from fraclink._arm.reference import pulse as pulse
    from fraclink._arm.reference import smooth_step as smooth_step
    from fraclink._arm.rig import Rig as Rig
    from fraclink._certify import certify as certify
    from fraclink._design import Design as Design
    from fraclink._design import deg as deg
    from fraclink._design import design as design
    from fraclink._export import export_c as export_c
    from fraclink._files import load as load
    from fraclink._files import save as save
    from fraclink._identify import Fit as Fit
    from fraclink._identify import identify as identify
    from fraclink._identify import identify_all as identify_all
    from fraclink._law import Law as Law
    from fraclink._law import discretize as discretize
    from fraclink._logs import bundled_log as bundled_log
    from fraclink._logs import diagnose as diagnose
    from fraclink._logs import inspect_log as inspect_log
    from fraclink._logs import read_log as read_log
    from fraclink._show.report import write_report as write_report
    from fraclink._simulate import Run as Run
    from fraclink._simulate import Twin as Twin
    from fraclink._simulate import simulate as simulate  # type: ignore[no-redef]
    from fraclink._systems.fractional import FractionalTransferFunction as FractionalTransferFunction
    from fraclink._systems.fractional import s as s
    from fraclink._systems.interop import from_control as from_control
    from fraclink._systems.margins import margins as margins
    from fraclink._systems.norms import norm as norm
    from fraclink._systems.rational import approximate as approximate
    from fraclink._systems.response import step_response as step_response
    from fraclink._systems.response import time_response as time_response
    from fraclink._systems.stability import is_stable as is_stable
    from fraclink._systems.stability import poles as poles
    from fraclink._workflow import run as run

__all__ = sorted(["__version__", *_HOME])


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'fraclink' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
