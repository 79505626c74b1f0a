"""Operating-system processes: child processes, entry points, signals and shared memory.

Nothing here imports ROS.
"""
