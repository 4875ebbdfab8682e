"""The surface section: an adaptive range coder, and on top of it the connectivity and the sharp marks of a mesh."""
