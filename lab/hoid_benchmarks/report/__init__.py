"""Tables, figures and the HTML page of stored results.

This package does not run experiments.
"""
