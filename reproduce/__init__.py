"""The source paper recomputed: every printed number, statement and figure, with a
verdict for each.
"""
