"""SLAM maps in databases: tables, incremental writing of a running map, checked reading."""
