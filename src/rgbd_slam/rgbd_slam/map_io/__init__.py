"""Map files and checkpoints, which are checked when they are read.

A damaged or foreign file is refused with a `MapFileError` of one line.

Code that changes a running map does not belong here.
"""
