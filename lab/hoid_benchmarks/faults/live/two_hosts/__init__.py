"""A camera on one host and the nodes on another, joined by a link that loses packets."""
