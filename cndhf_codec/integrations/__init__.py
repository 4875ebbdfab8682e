"""Other libraries that read `.cndhf` files: import the module of the one that you use. Each needs that library."""
