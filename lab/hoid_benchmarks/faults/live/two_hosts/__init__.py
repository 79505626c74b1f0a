"""A camera on one host and the nodes on another, connected by a link that loses packets."""
