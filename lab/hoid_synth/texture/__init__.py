"""Procedural textures of rooms, people and objects, and the atlas that contains them.

Meshes are made elsewhere.
"""
