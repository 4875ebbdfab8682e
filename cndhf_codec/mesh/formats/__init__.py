"""Readers of mesh files, one module a format: bytes -> `common.Triangles`, or `UnreadableError` with the reason."""
