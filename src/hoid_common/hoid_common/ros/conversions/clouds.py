"""Conversion of sensor_msgs/PointCloud2; the pip wheels of rclpy lack sensor_msgs_py."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.ros.conversions.arrays import bytes_field
from hoid_common.values import ByteArray, Float32Array

# Color is 0x00RRGGBB in the bits of a float32, as in PCL and RViz.
_FIELDS = ('x', 'y', 'z', 'rgb')
# The class of a point is a uint32, as in PCL's PointXYZRGBL.
_LABEL = 'label'


class Cloud(NamedTuple):
    """N points in the frame of the message's header, with or without color and label."""

    points_m: Float32Array  # (N, 3)
    colors_bgr: ByteArray | None = None  # (N, 3) uint8
    labels: NDArray[np.uint32] | None = None  # (N,) number of the class; 0: no class


def cloud_from_msg(msg: PointCloud2) -> Cloud:
    """Return the points of a cloud, with colors (rgb, float32) and labels (uint32) if it has them.

    MessageError if x, y and z are not little-endian float32, or the data does not fit the fields.
    """
    offsets = {
        field.name: field.offset
        for field in msg.fields
        if field.datatype == (PointField.UINT32 if field.name == _LABEL else PointField.FLOAT32)
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
    names = [name for name in (*_FIELDS, _LABEL) if name in offsets]
    needed = max(offsets[name] for name in names) + 4
    if needed > msg.point_step:
        raise MessageError(f'cloud has point_step {msg.point_step}, but its fields need {needed}')
    layout = np.dtype(
        {
            'names': names,
            'formats': ['<u4' if name in ('rgb', _LABEL) else '<f4' for name in names],
            'offsets': [offsets[name] for name in names],
            'itemsize': msg.point_step,
        }
    )
    table = np.frombuffer(msg.data, layout, n)
    points = np.stack([table['x'], table['y'], table['z']], axis=1)
    cloud = Cloud(points, labels=table[_LABEL].copy() if _LABEL in offsets else None)
    if 'rgb' not in offsets:
        return cloud
    rgb = np.ascontiguousarray(table['rgb'])
    return cloud._replace(colors_bgr=rgb.view(np.uint8).reshape(n, 4)[:, :3].copy())


def point_table(cloud: Cloud) -> ByteArray:
    """Return the bytes (N, B) of points: 12 for x, y, z (float32), 4 for color, 4 for label."""
    n = len(cloud.points_m)
    table = np.zeros((n, 4 * len(_fields(cloud))), np.uint8)
    table[:, :12] = np.ascontiguousarray(cloud.points_m, np.float32).view(np.uint8).reshape(n, 12)
    if cloud.colors_bgr is not None:
        table[:, 12:15] = cloud.colors_bgr
    if cloud.labels is not None:
        table[:, -4:] = np.ascontiguousarray(cloud.labels, '<u4').view(np.uint8).reshape(n, 4)
    return table


def _fields(cloud: Cloud) -> list[PointField]:
    names = _FIELDS[: 3 if cloud.colors_bgr is None else 4]
    types = [(name, PointField.FLOAT32) for name in names]
    if cloud.labels is not None:
        types.append((_LABEL, PointField.UINT32))
    return [
        PointField(name=name, offset=4 * i, datatype=datatype, count=1)
        for i, (name, datatype) in enumerate(types)
    ]


def cloud_to_msg(cloud: Cloud, header: Header) -> PointCloud2:
    table = point_table(cloud)
    n, step = table.shape
    return PointCloud2(
        header=header,
        height=1,
        width=n,
        fields=_fields(cloud),
        is_bigendian=False,
        point_step=step,
        row_step=step * n,
        data=bytes_field(table),
        is_dense=True,
    )
