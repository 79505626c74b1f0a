"""The built-in strategies: rules that decide which objects are dynamic, and the mask over them.

Nothing here finds or describes features.
"""
