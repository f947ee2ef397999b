"""Mathematics that knows no robot: fractional functions, roots, responses, stability,
rational fits.
"""
