"""The publishers of the filter node."""
