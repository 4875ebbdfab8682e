"""Double height fields fitted together and rounded to a size: axes, then the fit, then the rounding."""
