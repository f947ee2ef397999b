"""The studio: a page on this machine that shows a study while it is changed. Python
computes and decides.
"""
