"""Results in the documents: a file of rows for each plan, and the tables written from it.

This package does not run experiments. Only this package writes the tables between the markers of a
page.
"""
