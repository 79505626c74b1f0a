"""Textures of rooms, people and props: papers, fabrics, prints, and the atlas that holds them.

Nothing here has a shape.
"""
