"""Conversion of point clouds, with or without color: sensor_msgs/PointCloud2.

sensor_msgs_py has the same functions, but is missing from the wheels of rclpy.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.ros.conversions.arrays import bytes_field
from hoid_common.values import ByteArray, Float32Array

# Color is 0x00RRGGBB in the bits of a float32, as in PCL and RViz.
_FIELDS = ('x', 'y', 'z', 'rgb')


class Cloud(NamedTuple):
    """N points in the frame of the message's header, with or without color."""

    points_m: Float32Array  # (N, 3)
    colors_bgr: ByteArray | None = None  # (N, 3) uint8


def cloud_from_msg(msg: PointCloud2) -> Cloud:
    """Return the points of a cloud, and their colors if it has a float32 field rgb.

    Other fields are ignored.

    Raises:
        MessageError: x, y and z are not little-endian float32, the data has the wrong length, or
            `point_step` is too small for the fields.
    """
    offsets = {
        field.name: field.offset for field in msg.fields if field.datatype == PointField.FLOAT32
    }
    if not {'x', 'y', 'z'} <= offsets.keys() or msg.is_bigendian:
        raise MessageError(
            f'cloud has fields {sorted(offsets)}; float32 x, y, z in little endian are needed'
        )
    n = msg.width * msg.height
    if len(msg.data) != n * msg.point_step:
        raise MessageError(
            f'cloud has {len(msg.data)} bytes, but {n} points need {n * msg.point_step}'
        )
    names = [name for name in ('x', 'y', 'z', 'rgb') if name in offsets]
    needed = max(offsets[name] for name in names) + 4
    if needed > msg.point_step:
        raise MessageError(f'cloud has point_step {msg.point_step}, but its fields need {needed}')
    layout = np.dtype(
        {
            'names': names,
            'formats': ['<u4' if name == 'rgb' else '<f4' for name in names],
            'offsets': [offsets[name] for name in names],
            'itemsize': msg.point_step,
        }
    )
    table = np.frombuffer(msg.data, layout, n)
    points = np.stack([table['x'], table['y'], table['z']], axis=1)
    if 'rgb' not in offsets:
        return Cloud(points)
    rgb = np.ascontiguousarray(table['rgb'])
    return Cloud(points, rgb.view(np.uint8).reshape(n, 4)[:, :3].copy())


def point_table(cloud: Cloud) -> ByteArray:
    """Return N points as uint8: (N, 12) for x, y and z as float32, or (N, 16) with color.

    The bytes of a color are blue, green, red and 0.
    """
    n = len(cloud.points_m)
    table = np.zeros((n, 12 if cloud.colors_bgr is None else 16), np.uint8)
    table[:, :12] = np.ascontiguousarray(cloud.points_m, np.float32).view(np.uint8).reshape(n, 12)
    if cloud.colors_bgr is not None:
        table[:, 12:15] = cloud.colors_bgr
    return table


def cloud_to_msg(cloud: Cloud, header: Header) -> PointCloud2:
    """Return an unordered cloud with the fields x, y, z and, when there are colors, rgb."""
    table = point_table(cloud)
    n, step = table.shape
    fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate(_FIELDS[: step // 4])
    ]
    return PointCloud2(
        header=header,
        height=1,
        width=n,
        fields=fields,
        is_bigendian=False,
        point_step=step,
        row_step=step * n,
        data=bytes_field(table),
        is_dense=True,
    )
