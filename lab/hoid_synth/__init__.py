"""Renders scenes with people who handle objects, with exact ground truth."""
