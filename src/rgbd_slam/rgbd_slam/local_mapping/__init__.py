"""What a new keyframe does around it: new points, fused points, what is culled.

Nothing here looks farther than the keyframes around.
"""
