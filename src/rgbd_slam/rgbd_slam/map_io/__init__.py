"""Map files: written whole, read with checks, refused in one line if damaged or foreign.

Code that changes a running map does not belong here.
"""
