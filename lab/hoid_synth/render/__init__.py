"""Ray casting, light and sensor model: color and depth images of a stage.

Nothing here determines the content of a scene.
"""
