"""Command line, offline pipeline, live replay, evaluation, launch files."""
