"""The whole way in one call: log → model → controller → simulated moves, with what was assumed."""

from fraclink.study.folder import load_study, save_study
from fraclink.study.nouns import Move, Study
from fraclink.study.request import Request, design_for
from fraclink.study.way import conduct, simulate_move

__all__ = ["Move", "Request", "Study", "conduct", "design_for", "load_study", "save_study", "simulate_move"]
