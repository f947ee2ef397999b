"""Recorded logs read: a file with stated columns becomes an Experiment."""
