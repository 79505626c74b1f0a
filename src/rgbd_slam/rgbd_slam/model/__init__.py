"""What SLAM knows: frames, keyframes, map points, the atlas of them, trajectories.

No matching, optimisation or decision about them belongs here.
"""
