"""Where the mapper runs: in this process, or in one of its own.

No step of mapping belongs here.
"""
