"""Recorded logs: read, inspected, diagnosed."""
