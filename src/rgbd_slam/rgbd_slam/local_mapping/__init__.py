"""Updates of the map around a new keyframe: new points, fused points, and culling.

The modules of this package change only the neighborhood of one keyframe.
"""
