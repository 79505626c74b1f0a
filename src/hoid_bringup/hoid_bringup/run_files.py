"""What the files in the output folder of a run are called."""

SUMMARY = 'summary.json'
FINAL = 'trajectory.txt'
ONLINE = 'trajectory_online.txt'
KEYFRAMES = 'keyframes.txt'
MAP = 'map.ply'
CLOUD = 'cloud.ply'
GRID = 'grid'  # .pgm and .yaml
PICTURE = 'trajectory.png'
