"""Say how far ahead of a camera, whose frame is named, people are, and on what floor."""

import signal
import sys

import rclpy
from nav_msgs.msg import OccupancyGrid
from people_msgs.msg import People

from hoid_common.ros import conversions, frame_tree, qos


def _tell(msg: People) -> None:
    at_ns, grid, info = conversions.stamp_from_msg(msg.header.stamp), grids[-1], grids[-1].info
    camera_map = frames.find(sys.argv[1], msg.header.frame_id, at_ns)  # at the image's stamp
    grid_map = frames.find(grid.header.frame_id, msg.header.frame_id, at_ns)
    for p in msg.people if camera_map is not None and grid_map is not None else ():
        at_m = (p.position.x, p.position.y, p.position.z, 1)
        x, y = (grid_map @ at_m)[:2] - (info.origin.position.x, info.origin.position.y)
        row, column = int(y // info.resolution), int(x // info.resolution)
        inside = 0 <= row < info.height and 0 <= column < info.width
        value = grid.data[row * info.width + column] if inside else -1  # as Nav2 reads it
        floor = 'unknown' if value < 0 else 'occupied' if value >= 100 else 'free'
        print(f'{p.name}: {(camera_map @ at_m)[2]:.2f} m ahead, {floor} floor', flush=True)


rclpy.init()
signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends the program at once
frames, grids = frame_tree.FrameListener(node := rclpy.create_node('people')), [OccupancyGrid()]
node.create_subscription(OccupancyGrid, 'grid_map', grids.append, qos.LATCHED)
node.create_subscription(People, 'people', _tell, 10)
rclpy.spin(node)
