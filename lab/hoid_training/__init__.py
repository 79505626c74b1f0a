"""Renders a training set, trains the detector for rendered scenes, measures it."""
