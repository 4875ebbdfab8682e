"""The viewer of web/, as one page with a file in it: for `cndhf-view` and for notebooks."""
