"""Array records: sets of parallel arrays with a declared layout, and a store of them on disk.

Nothing here knows what the arrays mean.
"""
