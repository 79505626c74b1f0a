"""Operating-system processes: child processes, entry points, signals and shared memory."""
