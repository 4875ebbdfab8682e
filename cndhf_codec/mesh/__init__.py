"""Meshes in, and what encoders and reports share: solids, frames, samples, distances. No torch, no numba."""
