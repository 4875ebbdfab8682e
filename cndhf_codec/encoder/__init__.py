"""From a mesh to a container: the pipeline, above one folder per representation."""
