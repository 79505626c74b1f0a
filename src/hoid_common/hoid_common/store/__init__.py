"""Maps as SQLite databases: tables whose blobs are records of arrays, and who owns a database."""
