"""Encode a mesh as a subdivision surface: simplify, cut, mark creases, fit, round, to a given size."""
