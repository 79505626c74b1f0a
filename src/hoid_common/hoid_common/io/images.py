"""Conversion of the pixels of image messages, live or from a bag, to arrays and back.

Color is (H, W, 3) uint8 BGR, depth is (H, W) float32 in m with 0 for "no reading"; on topics,
16UC1 in mm or 32FC1 in m (REP 118).
"""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass
from typing import Any, TypeAlias, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from hoid_common.errors import MessageError
from hoid_common.io.depth import check_depth_unit, readings_m
from hoid_common.values import MAX_PIXELS, ByteArray, Float32Array

Buffer: TypeAlias = 'bytes | bytearray | memoryview | array[int] | ByteArray'
Pixels: TypeAlias = NDArray[Any]

MM_PER_M = 1000.0
COMPRESSED_DEPTH_FORMAT = '16UC1; compressedDepth png'
JPEG_FORMAT = 'bgr8; jpeg compressed bgr8'
PNG_FORMAT = 'bgr8; png compressed bgr8'
COMPRESSED_DEPTH_HEADER = struct.Struct('<iff')
"""Header of compressed_depth_image_transport: format, and two parameters of inverse depth."""
# By encoding: type, number of channels, and OpenCV's code for the conversion to BGR (None: it is
# BGR). ROS names a Bayer pattern by the first two pixels of the first two rows, OpenCV by the
# second and third pixel of the second row.
_COLOR: dict[str, tuple[str, int, int | None]] = {
    'bgr8': ('u1', 3, None),
    '8UC3': ('u1', 3, None),
    'rgb8': ('u1', 3, cv2.COLOR_RGB2BGR),
    'mono8': ('u1', 1, cv2.COLOR_GRAY2BGR),
    '8UC1': ('u1', 1, cv2.COLOR_GRAY2BGR),
    'bgra8': ('u1', 4, cv2.COLOR_BGRA2BGR),
    '8UC4': ('u1', 4, cv2.COLOR_BGRA2BGR),
    'rgba8': ('u1', 4, cv2.COLOR_RGBA2BGR),
    'bgr16': ('u2', 3, None),
    'rgb16': ('u2', 3, cv2.COLOR_RGB2BGR),
    'mono16': ('u2', 1, cv2.COLOR_GRAY2BGR),
    'bayer_rggb8': ('u1', 1, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr8': ('u1', 1, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg8': ('u1', 1, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg8': ('u1', 1, cv2.COLOR_BayerGB2BGR),
    'bayer_rggb16': ('u2', 1, cv2.COLOR_BayerBG2BGR),
    'bayer_bggr16': ('u2', 1, cv2.COLOR_BayerRG2BGR),
    'bayer_gbrg16': ('u2', 1, cv2.COLOR_BayerGR2BGR),
    'bayer_grbg16': ('u2', 1, cv2.COLOR_BayerGB2BGR),
    'yuv422': ('u1', 2, cv2.COLOR_YUV2BGR_UYVY),
    'uyvy': ('u1', 2, cv2.COLOR_YUV2BGR_UYVY),
    'yuv422_yuy2': ('u1', 2, cv2.COLOR_YUV2BGR_YUY2),
    'yuyv': ('u1', 2, cv2.COLOR_YUV2BGR_YUY2),
    'nv12': ('u1', 1, cv2.COLOR_YUV2BGR_NV12),
    'nv21': ('u1', 1, cv2.COLOR_YUV2BGR_NV21),
    'nv24': ('u1', 1, cv2.COLOR_YUV2BGR_NV12),
    'i420': ('u1', 1, cv2.COLOR_YUV2BGR_I420),
}
_CHROMA_ROWS = {'nv12': 0.5, 'nv21': 0.5, 'i420': 0.5, 'nv24': 2.0}
"""Rows of color that follow those of the image, as a multiple of its height."""
_DEPTH_TYPES: dict[str, np.dtype[Any]] = {
    '16UC1': np.dtype('u2'),
    'mono16': np.dtype('u2'),
    '16SC1': np.dtype('i2'),
    '32FC1': np.dtype('f4'),
    '64FC1': np.dtype('f8'),
}
DEPTH_ENCODINGS = tuple(_DEPTH_TYPES)
UNIT_REMEDY = 'set the units with --depth-factor, or input.depth_units_per_m of live nodes'
"""Text for errors: the option and the parameter that correct a wrong unit of depth messages."""


@dataclass(frozen=True, eq=False)
class RawImage:
    """The fields of sensor_msgs/Image that carry pixels; a message can take its place."""

    height: int
    width: int
    encoding: str
    is_bigendian: int
    step: int
    data: Any  # buffer of bytes


def decode_color(image: RawImage) -> ByteArray:
    """Return the (H, W, 3) uint8 BGR image of a message with a color or gray encoding.

    Of 16-bit channels the upper 8 bits are kept. The result may share the message's memory.
    MessageError if the encoding or the data is invalid.
    """
    if image.encoding not in _COLOR:
        raise MessageError(
            f'color image has encoding "{image.encoding}"; use one of {", ".join(_COLOR)}'
        )
    kind, channels, code = _COLOR[image.encoding]
    chroma_rows = int(image.height * _CHROMA_ROWS.get(image.encoding, 0))
    pixels = _pixels(image, np.dtype(kind), channels, chroma_rows)
    if image.encoding == 'nv24':  # OpenCV converts only NV12, with a quarter of the colors
        chroma = pixels[image.height :].reshape(image.height, image.width, 2)[::2, ::2]
        pixels = np.vstack([pixels[: image.height], chroma.reshape(-1, image.width)])
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    try:
        return cast('ByteArray', pixels if code is None else cv2.cvtColor(pixels, code))
    except cv2.error as error:  # such as for an odd size of yuv422
        raise MessageError(
            f'{image.encoding} image of {image.width}x{image.height} px cannot be converted to BGR'
        ) from error


def decode_depth(image: RawImage, units_per_m: float = 0.0) -> Float32Array:
    """Return the (H, W) float32 depth in m of a message, 0 = no reading; memory may be shared.

    If `units_per_m` is 0, integers are in mm and floats in m. MessageError if encoding, data or
    unit is invalid.
    """
    if image.encoding not in _DEPTH_TYPES:
        raise MessageError(
            f'depth image has encoding "{image.encoding}"; use 16UC1 (mm) or 32FC1 (m)'
        )
    return depth_in_m(_pixels(image, _DEPTH_TYPES[image.encoding], 1), image.encoding, units_per_m)


def encode_compressed_depth(depth_mm: NDArray[np.uint16]) -> bytes:
    """Return the field `data` of a compressedDepth message of uint16 depth (H, W) in mm."""
    # Level 1: higher levels take several times as long and save a few percent of a depth image.
    png = _encoded(depth_mm, 'depth image', 'PNG', [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return compressed_depth_of_png(png)


def compressed_depth_of_png(png: bytes) -> bytes:
    return COMPRESSED_DEPTH_HEADER.pack(0, 0.0, 0.0) + png


def encode_jpeg(image_bgr: ByteArray, quality: int) -> bytes:
    """Return the JPEG of a (H, W, 3) uint8 BGR image; MessageError if it cannot be encoded."""
    return _encoded(image_bgr, 'image', 'JPEG', [cv2.IMWRITE_JPEG_QUALITY, quality])


def _encoded(image: NDArray[Any], name: str, kind: str, options: list[int]) -> bytes:
    if image.size == 0:
        raise MessageError(f'{name} of shape {image.shape} has no pixels and cannot be encoded')
    ok, data = cv2.imencode(f'.{kind.lower()}', image, options)
    if not ok:
        raise MessageError(f'{name} of shape {image.shape} cannot be encoded as {kind}')
    return data.tobytes()


def depth_mm_or_none(depth_m: Float32Array) -> NDArray[np.uint16] | None:
    """Return depth (H, W) in m as uint16 in mm, or None if a value is no whole number of mm."""
    depth_mm = np.rint(depth_m * MM_PER_M)
    if depth_mm.max(initial=0) > np.iinfo(np.uint16).max:
        return None
    whole = depth_mm.astype(np.uint16)
    return whole if np.array_equal(depth_m_from_units(whole), depth_m) else None


def _pixels(
    image: RawImage, dtype: np.dtype[Any], channels: int, chroma_rows: int = 0
) -> NDArray[Any]:
    """Return the pixels (H, W) or (H, W, C) in native byte order; MessageError if invalid."""
    height, width, step = image.height + chroma_rows, image.width, image.step
    row_bytes = width * channels * dtype.itemsize
    if height <= 0 or width <= 0:
        raise MessageError(f'{image.encoding} image is empty: {width}x{height} px')
    if width * height > MAX_PIXELS:
        raise MessageError(
            f'{image.encoding} image is {width}x{height} px, '
            f'more than {MAX_PIXELS / 1e6:.0f} megapixels'
        )
    if step < row_bytes:
        raise MessageError(
            f'{image.encoding} image has step {step}, but {width} px need {row_bytes} bytes'
        )
    raw = np.frombuffer(image.data, np.uint8)
    if len(raw) < step * height:
        raise MessageError(
            f'{image.encoding} image has {len(raw)} bytes, but {width}x{height} px at step {step} '
            f'need {step * height}'
        )
    ordered = dtype.newbyteorder('>' if image.is_bigendian else '<')
    rows = raw[: step * height].reshape(height, step)[:, :row_bytes]
    pixels = np.ascontiguousarray(rows).view(ordered).astype(dtype, copy=False)
    return pixels.reshape(height, width, channels) if channels > 1 else pixels


def depth_m_from_units(depth: NDArray[Any], units_per_m: float = 0.0) -> Float32Array:
    """Return (H, W) float32 depth in m; if `units_per_m` is 0, integers are mm and floats m."""
    if depth.dtype == np.int16:
        depth = np.maximum(depth, 0).astype(np.uint16)
    units_per_m = units_per_m or (MM_PER_M if depth.dtype == np.uint16 else 1.0)
    if units_per_m == 1.0:
        return cast('Float32Array', depth.astype(np.float32, copy=False))
    return cast('Float32Array', np.divide(depth, np.float32(units_per_m), dtype=np.float32))


def depth_in_m(depth: NDArray[Any], encoding: str, units_per_m: float) -> Float32Array:
    depth_m = depth_m_from_units(depth, units_per_m)
    check_depth_unit(
        depth_m,
        f'{encoding}, which is in {"m" if depth.dtype.kind == "f" else "mm"}; {UNIT_REMEDY}',
    )
    return readings_m(depth_m)
