"""Choose the axes of the double height fields, by their costs and by trials."""
