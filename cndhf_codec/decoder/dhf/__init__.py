"""Double height fields decoded: heights, the implicit function, cells, rays and surfaces."""
