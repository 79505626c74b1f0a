"""Ray casting, light and the sensor model: from a scene at one time to colour and depth.

Nothing here decides what is in the scene.
"""
