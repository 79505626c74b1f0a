"""Live runs: the nodes as supervised processes, and recordings that are replayed to them."""
