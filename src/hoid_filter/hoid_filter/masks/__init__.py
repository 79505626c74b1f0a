"""From verdicts to pixels: which features lie on what is dynamic.

Nothing here decides what is dynamic.
"""
