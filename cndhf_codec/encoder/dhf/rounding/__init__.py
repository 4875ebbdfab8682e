"""Weights to whole multiples of their steps, with error feedback, to the size asked for."""
