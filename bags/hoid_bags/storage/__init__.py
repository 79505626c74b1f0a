"""Files of bags: MCAP by chunks with checksums, compressed files, and SQLite files with a log.

This folder does not depend on the topics or message types of a bag.
"""
