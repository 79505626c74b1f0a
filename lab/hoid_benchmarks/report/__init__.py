"""Tables, figures and the page, from stored results.

Nothing here runs an experiment.
"""
