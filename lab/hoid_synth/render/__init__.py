"""Ray casting, light and sensor model: color and depth images of a stage.

The content of a scene is determined by `hoid_synth.acting` and `hoid_synth.room`.
"""
