"""Readers of mesh files, one module per format: bytes -> `common.Triangles`, or `UnreadableError` with the reason."""
