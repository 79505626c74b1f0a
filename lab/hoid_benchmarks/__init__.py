"""Experiments of the paper and of this project, declared in YAML files and run by one command."""
