"""Motions of people, objects and the camera, and which objects are handled.

Images are rendered by `hoid_synth.render`.
"""
