"""Selects the images for the scene mapper, and describes them: time, pose and keyframe."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from hoid_common import se3
from hoid_common.poses.keyframe_poses import KeyframePoses, TrackedImage
from hoid_common.sync import Rate
from hoid_common.values import NS_PER_S, UNKNOWN, DynamicObject, FloatArray, ObjectState

# Chosen: number of track periods to wait for an image with detections.
_PATIENCE = 1.25


class SceneRequest(NamedTuple):
    """The request to the scene mapper to use one image: its time, pose and keyframe.

    The pose belongs to one version of the map. With the pose of the keyframe in that version, the
    scene mapper stores it relative to the keyframe, so that it is corrected with the map later.
    """

    stamp_ns: int
    T_map_camera: FloatArray  # (4, 4), in the map frame of that version
    reference_uid: int  # uid of the keyframe relative to which the pose is stored
    # Keyframe poses of that version; None: the image is neither for the dense map nor for the
    # object map.
    keyframes: KeyframePoses | None
    track_objects: bool = True  # whether to update the tracks of people and objects
    map_objects: bool = False  # whether to update the object map; needs keyframes
    fuse: bool = True  # whether to fuse the image into the dense map; needs keyframes

    @property
    def T_keyframe_camera(self) -> FloatArray | None:  # noqa: N802 - a transform's name
        """Return the (4, 4) pose of the image relative to its keyframe; None without that."""
        row = None if self.keyframes is None else self.keyframes.row_of(self.reference_uid)
        if self.keyframes is None or row is None:
            return None
        return se3.inverse(self.keyframes.T_map_camera[row]) @ self.T_map_camera


class _TrackRate:
    """Selects images with detections at a rate, and other images where these are too rare."""

    def __init__(self, rate_hz: float) -> None:
        self._seen = Rate(rate_hz)
        self._patience_ns = round(_PATIENCE * NS_PER_S / rate_hz)
        self._since_ns: int | None = None  # stamp of the image selected last, or of the first one

    def take_due(self, stamp_ns: int, *, is_seen: bool) -> bool:
        since_ns = stamp_ns if self._since_ns is None else self._since_ns
        is_late = not 0 <= stamp_ns - since_ns < self._patience_ns
        is_due = self._seen.take_due(stamp_ns) if is_seen else is_late
        self._since_ns = stamp_ns if is_due else since_ns
        return is_due


class SceneScheduler:
    """Selects the images for the dense map, the object tracks and the object map.

    While the map grows, images are fused in every map, not only in the main one: the dense map
    stores the images of other maps until a recognized place merges the maps. Objects are tracked
    in the main map only, because tracks are published at once. They are tracked in localization as
    well, because the present positions of people and objects are not part of the map. The object
    map is updated in localization too, but only in the main map: it shows what has been moved
    since the map was made.

    Args:
        dense_rate_hz: Rate [Hz] of images for the dense map; None: the dense map is off.
        tracks_rate_hz: Rate of images for the object tracks; None: they are off.
        object_map_rate_hz: Rate of images for the object map; None: it is off.
    """

    def __init__(
        self,
        dense_rate_hz: float | None,
        tracks_rate_hz: float | None,
        object_map_rate_hz: float | None = None,
    ) -> None:
        self._dense = None if dense_rate_hz is None else Rate(dense_rate_hz)
        self._tracks = None if tracks_rate_hz is None else _TrackRate(tracks_rate_hz)
        self._object_map = None if object_map_rate_hz is None else Rate(object_map_rate_hz)

    def pick(
        self, image: TrackedImage | None, keyframes: Callable[[], KeyframePoses]
    ) -> SceneRequest | None:
        """Return the request for an image, or None if no map needs it.

        Once the objects of the image are known, `narrow` must follow.
        """
        if image is None:
            return None
        is_known = image.is_growing or image.is_in_main_map
        fuse = image.is_growing and _take(self._dense, image.stamp_ns)
        track_objects = image.is_in_main_map and self._tracks is not None
        map_objects = is_known and self._object_map is not None
        if not (fuse or track_objects or map_objects):
            return None
        return SceneRequest(
            image.stamp_ns,
            image.T_map_camera,
            image.keyframe_uid,
            keyframes() if fuse or map_objects else None,
            track_objects,
            map_objects,
            fuse,
        )

    def narrow(
        self, request: SceneRequest | None, objects: Sequence[DynamicObject]
    ) -> SceneRequest | None:
        """Return the request for the maps for which the image is due; None: for no map.

        Predicted boxes do not show where an object is. The object map therefore uses only images
        with detections, and the tracks use other images only while those are too rare.
        """
        if request is None:
            return None
        is_seen, stamp_ns, tracks = has_detections(objects), request.stamp_ns, self._tracks
        narrowed = request._replace(
            track_objects=request.track_objects
            and tracks is not None
            and tracks.take_due(stamp_ns, is_seen=is_seen),
            map_objects=request.map_objects and is_seen and _take(self._object_map, stamp_ns),
        )
        is_used = narrowed.fuse or narrowed.track_objects or narrowed.map_objects
        return narrowed if is_used else None


def _take(rate: Rate | None, stamp_ns: int) -> bool:
    return rate is not None and rate.take_due(stamp_ns)


def has_detections(objects: Sequence[DynamicObject]) -> bool:
    """Return whether the detector processed an image, so that not all boxes are predicted."""
    known = [item for item in objects if item.class_name != UNKNOWN]
    return not known or any(item.state is not ObjectState.PREDICTED for item in known)
