"""The experiments: the paper's and ours, declared in files, run in one command."""
