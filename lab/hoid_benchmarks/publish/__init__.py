"""Results that the documents show: one file of rows, and the tables that are written from it.

No experiment runs here, and nothing else writes the tables between a page's markers.
"""
