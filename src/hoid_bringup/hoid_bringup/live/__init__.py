"""The nodes as supervised processes, and recordings replayed through them.

No stage of the method belongs here.
"""
