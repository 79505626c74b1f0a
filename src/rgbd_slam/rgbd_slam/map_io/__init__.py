"""Maps as files: writing, reading, and refusing what is damaged or foreign.

Nothing here changes a running map.
"""
