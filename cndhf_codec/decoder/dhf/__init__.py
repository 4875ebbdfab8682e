"""Double height fields: the networks' heights, the implicit function, queries and surfaces in the normalised frame."""
