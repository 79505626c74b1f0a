"""The only place that knows GTSAM: the pose graph and the bundle adjustment over a whole map."""
