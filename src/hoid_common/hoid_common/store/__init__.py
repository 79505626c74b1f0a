"""Maps as SQLite databases: tables whose blobs are records of arrays, and who owns a database.

A file that another program or user gives is checked before it is used, and nothing that it
contains is executed.
"""
