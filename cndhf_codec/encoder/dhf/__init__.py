"""Fit double height fields together and round them to a size: axes, then the fit, then the rounding."""
