"""The simulated building: its landmarks, a camera that sees them, and routes through it.

Nothing of the SLAM that is measured belongs here.
"""
