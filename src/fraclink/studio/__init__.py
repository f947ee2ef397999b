"""The studio: a page on this machine that shows a study while it is being changed. All
computations and decisions are made in Python.
"""
