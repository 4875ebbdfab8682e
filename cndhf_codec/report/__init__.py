"""Measure two shapes against each other: numbers, and a page with pictures. Needs the `encode` extra."""
