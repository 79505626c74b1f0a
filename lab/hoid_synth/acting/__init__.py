"""Motions of people, objects and the camera, and which objects are handled.

Nothing here renders.
"""
