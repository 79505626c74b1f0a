"""Maps as SQLite databases: tables whose blobs are records of arrays, and who owns a database.

Nothing here knows what the arrays mean. A file that another program or user gives is checked
before it is used, and nothing that it contains is ever executed.
"""
