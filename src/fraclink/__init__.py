"""From the log of a flexible-link robot to the fractional-order controller on its board.

Public names are loaded when they are first used: ``import fraclink`` itself loads numpy only.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# Public name -> module that defines it. The tests guard the list; add the same name below TYPE_CHECKING.
_HOME: dict[str, str] = {
    "Controller": "fraclink.controller",
    "Experiment": "fraclink.experiment",
    "Fit": "fraclink.identify",
    "FractionalTransferFunction": "fraclink.fractional",
    "Law": "fraclink.law",
    "LinkModel": "fraclink.link",
    "Plan": "fraclink.design",
    "Rig": "fraclink.rig",
    "Run": "fraclink.simulate",
    "Study": "fraclink.study",
    "Twin": "fraclink.twin",
    "approximate": "fraclink.rational",
    "bundled_log": "fraclink.readers",
    "certify": "fraclink.certify",
    "chirp": "fraclink.reference",
    "conduct": "fraclink.study",
    "deg": "fraclink.design",
    "design": "fraclink.design",
    "diagnose": "fraclink.diagnose",
    "export_c": "fraclink.export",
    "from_control": "fraclink.interop",
    "hold": "fraclink.reference",
    "identify": "fraclink.identify",
    "identify_all": "fraclink.identify",
    "impulse_response": "fraclink.response",
    "inspect_log": "fraclink.readers",
    "is_stable": "fraclink.stability",
    "margins": "fraclink.stability",
    "norm": "fraclink.stability",
    "poles": "fraclink.stability",
    "prbs": "fraclink.reference",
    "pulse": "fraclink.reference",
    "read_log": "fraclink.readers",
    "run_twin": "fraclink.twin",
    "s": "fraclink.fractional",
    "simulate": "fraclink.simulate",
    "smooth_step": "fraclink.reference",
    "step_response": "fraclink.response",
    "time_response": "fraclink.response",
    "write_report": "fraclink.report",
}

if TYPE_CHECKING:  # what editors and type checkers see; nothing of this runs
    from fraclink.certify import certify as certify
    from fraclink.controller import Controller as Controller
    from fraclink.design import Plan as Plan
    from fraclink.design import deg as deg
    from fraclink.design import design as design
    from fraclink.diagnose import diagnose as diagnose
    from fraclink.experiment import Experiment as Experiment
    from fraclink.export import export_c as export_c
    from fraclink.fractional import FractionalTransferFunction as FractionalTransferFunction
    from fraclink.fractional import s as s
    from fraclink.identify import Fit as Fit
    from fraclink.identify import identify as identify
    from fraclink.identify import identify_all as identify_all
    from fraclink.interop import from_control as from_control
    from fraclink.law import Law as Law
    from fraclink.link import LinkModel as LinkModel
    from fraclink.rational import approximate as approximate
    from fraclink.readers import bundled_log as bundled_log
    from fraclink.readers import inspect_log as inspect_log
    from fraclink.readers import read_log as read_log
    from fraclink.reference import chirp as chirp
    from fraclink.reference import hold as hold
    from fraclink.reference import prbs as prbs
    from fraclink.reference import pulse as pulse
    from fraclink.reference import smooth_step as smooth_step
    from fraclink.report import write_report as write_report
    from fraclink.response import impulse_response as impulse_response
    from fraclink.response import step_response as step_response
    from fraclink.response import time_response as time_response
    from fraclink.rig import Rig as Rig
    from fraclink.simulate import Run as Run
    from fraclink.simulate import simulate as simulate  # type: ignore[no-redef]
    from fraclink.stability import is_stable as is_stable
    from fraclink.stability import margins as margins
    from fraclink.stability import norm as norm
    from fraclink.stability import poles as poles
    from fraclink.study import Study as Study
    from fraclink.study import conduct as conduct
    from fraclink.twin import Twin as Twin
    from fraclink.twin import run_twin as run_twin

__all__ = sorted(["__version__", *_HOME])


def __getattr__(name: str) -> Any:
    if name in _HOME:
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module 'fraclink' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__


class _Root(ModuleType):
    """The root module: verbs keep their names though modules are called the same.

    Importing ``fraclink.design`` makes Python store the module as the root's attribute ``design``, over
    the verb of that name; whether `fl.design(...)` worked would then depend on what was imported before.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Root
