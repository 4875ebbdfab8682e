"""Read, prepare and measure meshes, for the encoder and the reports. Imports neither torch nor numba."""
