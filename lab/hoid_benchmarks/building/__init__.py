"""A simulated building at feature level, and what SLAM costs and does in it."""
