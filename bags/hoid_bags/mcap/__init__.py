"""MCAP files: written with a checksum for each chunk, read chunk by chunk.

This folder does not depend on the topics or message types of a bag.
"""
