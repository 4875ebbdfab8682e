"""The surface of a file: the limit of its control mesh under Loop's subdivision."""
