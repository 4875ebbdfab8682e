"""Measure two shapes against each other: numbers (`compare` extra), and a page with pictures (`report` extra)."""
