"""Maps in databases: tables, incremental writing of a running map, and checked reading."""
