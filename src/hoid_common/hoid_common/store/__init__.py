"""Maps as SQLite databases: tables with arrays in their columns, and the lock of the owner."""
