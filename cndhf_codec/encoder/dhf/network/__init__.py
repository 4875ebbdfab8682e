"""SIRENs, their compiled evaluation and gradient, and the optimiser."""
