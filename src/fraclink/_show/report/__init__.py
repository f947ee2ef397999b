"""The report: one HTML file that needs nothing else, from a study."""

from fraclink._show.report.page import render_report, write_report

__all__ = ["render_report", "write_report"]
