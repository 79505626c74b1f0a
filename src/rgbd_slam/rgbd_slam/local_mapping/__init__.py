"""Updates of the map around a new keyframe: new points, fused points, and culling.

No module of this package changes more than the neighborhood of one keyframe.
"""
