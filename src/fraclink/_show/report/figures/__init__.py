"""The figures of a report, one file for each part of the way."""

from fraclink._show.report.figures.log import log_figure
from fraclink._show.report.figures.loop import bode_figure, margins_figure, nyquist_figure
from fraclink._show.report.figures.models import models_figure
from fraclink._show.report.figures.moves import moves_figure

__all__ = ["bode_figure", "log_figure", "margins_figure", "models_figure", "moves_figure", "nyquist_figure"]
