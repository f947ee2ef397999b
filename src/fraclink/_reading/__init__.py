"""Readers of recorded logs: a file with stated columns becomes an Experiment."""
