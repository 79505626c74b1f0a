"""The node's topics and services."""
