"""`diagnose`: what a log can and cannot tell, found before a model is fitted to it."""

from fraclink._logs.diagnose.examine import diagnose
from fraclink.findings import Finding

__all__ = ["Finding", "diagnose"]
