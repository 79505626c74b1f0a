"""hoid_msgs/Features, and what is said of them later."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from hoid_msgs.msg import Features as FeaturesMsg
from hoid_msgs.msg import FeatureVerdicts as FeatureVerdictsMsg
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.ros.conversions.arrays import byte_array, bytes_field, float_array, floats_field
from hoid_common.ros.conversions.headers import stamp_from_msg
from hoid_common.values import DESCRIPTOR_BYTES, Features, FeatureVerdicts

_MAX_FEATURES = 65_536  # of an image, three times what the filter can be asked for


class FeatureCounts(NamedTuple):
    """What is said about the features beside themselves."""

    num_detected: int = 0
    num_removed: int = 0
    extract_ms: float = 0.0
    filter_ms: float = 0.0


def features_from_msg(msg: FeaturesMsg) -> Features:
    """Return the features; lengths that disagree and values that cannot be raise MessageError."""
    n = len(msg.octave)
    features = Features(
        stamp_from_msg(msg.header.stamp),
        float_array(msg.uv_px, 'features.uv_px', 2 * n).reshape(n, 2),
        float_array(msg.depth_m, 'features.depth_m', n),
        byte_array(msg.octave, 'features.octave', n),
        float_array(msg.angle_deg, 'features.angle_deg', n),
        float_array(msg.response, 'features.response', n),
        byte_array(msg.descriptors, 'features.descriptors', DESCRIPTOR_BYTES * n).reshape(
            n, DESCRIPTOR_BYTES
        ),
        byte_array(msg.may_seed, 'features.may_seed', n).astype(np.bool_)
        if len(msg.may_seed)
        else np.ones(n, np.bool_),
    )
    _check_values(features, msg.image_width, msg.image_height)
    return features


def feature_counts_from_msg(msg: FeaturesMsg) -> FeatureCounts:
    """Return what the message says beside the features."""
    return FeatureCounts(msg.num_detected, msg.num_removed, msg.extract_ms, msg.filter_ms)


def features_to_msg(
    features: Features,
    header: Header,
    image_size_px: tuple[int, int],
    counts: FeatureCounts = FeatureCounts(),  # noqa: B008 (immutable)
) -> FeaturesMsg:
    """Return the message; `image_size_px` is width, height of the image of the features."""
    seeds_all = bool(features.may_seed.all())
    return FeaturesMsg(
        header=header,
        image_width=image_size_px[0],
        image_height=image_size_px[1],
        uv_px=floats_field(features.uv_px),
        depth_m=floats_field(features.depth_m),
        octave=bytes_field(features.octave),
        angle_deg=floats_field(features.angle_deg),
        response=floats_field(features.response),
        descriptors=bytes_field(features.descriptors),
        may_seed=bytes_field(features.may_seed[:0] if seeds_all else features.may_seed),
        num_detected=counts.num_detected,
        num_removed=counts.num_removed,
        extract_ms=counts.extract_ms,
        filter_ms=counts.filter_ms,
    )


def feature_verdicts_from_msg(msg: FeatureVerdictsMsg) -> FeatureVerdicts:
    """Return the verdicts; an empty message, which says that nothing moves, gives none.

    Raises:
        MessageError: They are more than an image can have features.
    """
    if len(msg.dynamic) > _MAX_FEATURES:
        raise MessageError(
            f'feature_verdicts.dynamic has {len(msg.dynamic)} elements, more than {_MAX_FEATURES}'
        )
    flags = byte_array(msg.dynamic, 'feature_verdicts.dynamic', len(msg.dynamic))
    return FeatureVerdicts(stamp_from_msg(msg.header.stamp), flags.astype(np.bool_))


def feature_verdicts_to_msg(verdicts: FeatureVerdicts, header: Header) -> FeatureVerdictsMsg:
    """Return the message; the header is that of the features."""
    flags = verdicts.is_dynamic if verdicts.is_dynamic.any() else verdicts.is_dynamic[:0]
    return FeatureVerdictsMsg(header=header, dynamic=bytes_field(flags))


def _check_values(features: Features, width_px: int, height_px: int) -> None:
    uv = features.uv_px
    # Half a pixel beyond the outermost centres still lies on the sensor.
    inside = (uv >= -0.5) & (uv <= np.array([width_px, height_px]) - 0.5)
    if not inside.all():  # also False for NaN
        k = int(np.argmin(inside.all(axis=1)))
        raise MessageError(
            f'features.uv_px: feature {k} at {uv[k].tolist()} is outside {width_px}x{height_px} px'
        )
    depth = features.depth_m
    usable = (depth >= 0) & (depth < np.inf)
    if not usable.all():
        k = int(np.argmin(usable))
        raise MessageError(f'features.depth_m: feature {k} has depth {depth[k]}; no reading is 0')
