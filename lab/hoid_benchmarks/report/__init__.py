"""Tables, figures and the HTML page of stored results.

Nothing here runs an experiment.
"""
