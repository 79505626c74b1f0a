"""Files and encodings: images, camera calibrations, parameter files, trajectories as text."""
