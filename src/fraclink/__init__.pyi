from fraclink import errors as errors
from fraclink import extend as extend
from fraclink import lab as lab
from fraclink import logs as logs
from fraclink import trials as trials
from fraclink import view as view
from fraclink._arm.box import ParameterBox as ParameterBox
from fraclink._arm.controller import Controller as Controller
from fraclink._arm.experiment import Experiment as Experiment
from fraclink._arm.link import LinkModel as LinkModel
from fraclink._arm.link import SecondMode as SecondMode
from fraclink._arm.log_columns import Channel as Channel
from fraclink._arm.log_columns import LogColumns as LogColumns
from fraclink._arm.motor_loop import MotorLoop as MotorLoop
from fraclink._arm.recording import FrequencyResponse as FrequencyResponse
from fraclink._arm.reference import Reference as Reference
from fraclink._arm.reference import prbs as prbs
from fraclink._arm.reference import smooth_step as smooth_step
from fraclink._arm.reference import spline as spline
from fraclink._arm.rig import Rig as Rig
from fraclink._certify.procedure import certify as certify
from fraclink._certify.statement import Certificate as Certificate
from fraclink._cli import main as main
from fraclink._design.pid import tune_pid as tune_pid
from fraclink._design.procedure import design as design
from fraclink._export.c import export_c as export_c
from fraclink._export.fmu import export_fmu as export_fmu
from fraclink._files import load as load
from fraclink._files import save as save
from fraclink._identify.compare import Comparison as Comparison
from fraclink._identify.compare import compare_structures as compare_structures
from fraclink._identify.compare import identify as identify
from fraclink._identify.fit import Fit as Fit
from fraclink._identify.motor import identify_motor as identify_motor
from fraclink._identify.payloads import identify_payloads as identify_payloads
from fraclink._identify.structures import identify_structure as identify_structure
from fraclink._law.design import Design as Design
from fraclink._law.design import Requirement as Requirement
from fraclink._law.design import Specification as Specification
from fraclink._law.design import deg as deg
from fraclink._law.discretization import discretize as discretize
from fraclink._law.law import Law as Law
from fraclink._reading.reading import bundled_log as bundled_log
from fraclink._reading.reading import inspect_log as inspect_log
from fraclink._reading.reading import read_log as read_log
from fraclink._reading.responses import (
    read_frequency_response as read_frequency_response,
)
from fraclink._simulate.arm import Twin as Twin
from fraclink._simulate.arm_set import worst_case as worst_case
from fraclink._simulate.run import Run as Run
from fraclink._simulate.shape import shape as shape
from fraclink._simulate.simulate import simulate as simulate
from fraclink.findings import Finding as Finding
from fraclink.findings import Verdict as Verdict
from fraclink.lab._connections import Callback as Callback
from fraclink.lab._tune import tune as tune
from fraclink.lab._tune_guard import MotionLimits as MotionLimits
from fraclink.lab._tuning import TuningPlan as TuningPlan
from fraclink.view._responses import bode as bode

__version__: str
__all__: list[str]
