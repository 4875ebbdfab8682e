"""Other libraries' ways in: import the module of the one you use. Each needs that library."""
