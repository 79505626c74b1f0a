"""Loop closing and map merging: detection, pose graph optimization, global adjustment."""
