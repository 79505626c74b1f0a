"""Maps in databases: their tables, what is written of a running map, and checks when one is read.

A damaged or foreign file is refused with a `MapFileError` of one line.

Code that changes a running map does not belong here.
"""
