"""The map of the running SLAM, and the mapper that extends it, in this process or another.

The steps of mapping are in `local_mapping` and `loops`.
"""
