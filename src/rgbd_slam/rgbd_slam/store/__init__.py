"""Maps in databases: tables, incremental writing of a running map, and checks when one is read.

Code that changes a running map does not belong here.
"""
