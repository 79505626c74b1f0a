"""Command line, offline pipeline, live replay, evaluation and launch files of the suite."""
