"""Conversion of features and their final verdicts: hoid_msgs/Features and FeatureVerdicts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from hoid_msgs.msg import Features as FeaturesMsg
from hoid_msgs.msg import FeatureVerdicts as FeatureVerdictsMsg
from std_msgs.msg import Header

from hoid_common.errors import MessageError
from hoid_common.messages import stamp_from_msg
from hoid_common.ros.conversions.arrays import array_field, byte_array, bytes_field, float_array
from hoid_common.values import DESCRIPTOR_BYTES, Features, FeatureVerdicts

# A FeatureVerdicts message with more elements is refused. Chosen: over three times the maximum of
# the filter's parameter extraction.num_features.
_MAX_FEATURES = 65_536


class FeatureCounts(NamedTuple):
    """Statistics of the filter for one image, as in hoid_msgs/Features."""

    num_detected: int = 0  # features that were found before filtering
    num_removed: int = 0  # features that were removed as dynamic
    extract_ms: float = 0.0  # duration of detection and description
    filter_ms: float = 0.0  # duration of classifying and removing dynamic features


def features_from_msg(msg: FeaturesMsg) -> Features:
    """Return the features of a message; an empty field `may_seed` becomes all True.

    MessageError if lengths disagree, a pixel is outside the image, or a depth is negative or not
    finite.
    """
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
    return FeatureCounts(msg.num_detected, msg.num_removed, msg.extract_ms, msg.filter_ms)


def features_to_msg(
    features: Features,
    header: Header,
    image_size_px: tuple[int, int],
    counts: FeatureCounts = FeatureCounts(),  # noqa: B008 (immutable)
) -> FeaturesMsg:
    """Return the Features message of an image; `may_seed` is empty if all are True."""
    seeds_all = bool(features.may_seed.all())
    return FeaturesMsg(
        header=header,
        image_width=image_size_px[0],
        image_height=image_size_px[1],
        uv_px=array_field('f', features.uv_px),
        depth_m=array_field('f', features.depth_m),
        octave=bytes_field(features.octave),
        angle_deg=array_field('f', features.angle_deg),
        response=array_field('f', features.response),
        descriptors=bytes_field(features.descriptors),
        may_seed=bytes_field(features.may_seed[:0] if seeds_all else features.may_seed),
        num_detected=counts.num_detected,
        num_removed=counts.num_removed,
        extract_ms=counts.extract_ms,
        filter_ms=counts.filter_ms,
    )


def feature_verdicts_from_msg(msg: FeatureVerdictsMsg) -> FeatureVerdicts:
    """Return the verdicts in a message; an empty array means that no feature is dynamic."""
    if len(msg.dynamic) > _MAX_FEATURES:
        raise MessageError(
            f'feature_verdicts.dynamic has {len(msg.dynamic)} elements, more than {_MAX_FEATURES}'
        )
    flags = byte_array(msg.dynamic, 'feature_verdicts.dynamic', len(msg.dynamic))
    return FeatureVerdicts(stamp_from_msg(msg.header.stamp), flags.astype(np.bool_))


def feature_verdicts_to_msg(verdicts: FeatureVerdicts, header: Header) -> FeatureVerdictsMsg:
    flags = verdicts.is_dynamic if verdicts.is_dynamic.any() else verdicts.is_dynamic[:0]
    return FeatureVerdictsMsg(header=header, dynamic=bytes_field(flags))


def _check_values(features: Features, width_px: int, height_px: int) -> None:
    uv = features.uv_px
    # Pixel centers are integers, so that the image extends half a pixel beyond the outermost
    # centers.
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
