"""The whole way from a log to a verdict, and the folder that keeps it."""

from fraclink._workflow.run import design_for, run, simulate_move
from fraclink._workflow.start import START_FILES, Start, start
from fraclink._workflow.study import Refusal, Scope, Study, Verdict, load_study, save_study

__all__ = ["START_FILES", "Refusal", "Scope", "Start", "Study", "Verdict", "design_for", "load_study", "run"]
__all__ += ["save_study", "simulate_move", "start"]
