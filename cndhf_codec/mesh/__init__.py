"""Meshes in: what encoders and reports share. No torch, no numba."""
