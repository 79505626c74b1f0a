"""3-D viewer of recordings and runs."""
