"""MCAP files: chunks with checksums, written at once and read one by one.

Nothing here knows which topics a bag has or what they mean.
"""
