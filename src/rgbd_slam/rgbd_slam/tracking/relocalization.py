"""Finding a lost camera in everything mapped so far."""

from __future__ import annotations

import numpy as np

from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.place_finder import PlaceFinder
from rgbd_slam.tracking.tracker import Tracker, TrackerOutput


class Relocalizer:
    """Looks for the place of single frames; its index follows the map only while it is asked."""

    def __init__(
        self, atlas: Atlas, camera: StereoCamera, tracker: Tracker, config: SlamConfig
    ) -> None:
        self.num_found = 0  # lost frames
        self._tracker = tracker
        self._finder = PlaceFinder(atlas, camera, config.places, config.seed)

    def relocalize(self, frame: Frame) -> TrackerOutput | None:
        """Track a frame from where it is recognised; None when that is unknown or not clear."""
        place = self._finder.locate(frame)
        if place is None:
            return None
        points = np.full(len(frame), NO_POINT, np.int64)
        points[place.match.k] = place.match.j
        tracking = self._tracker.track_at(frame, place.match.T_camera_map, points, place.keyframe)
        self.num_found += tracking is not None
        return tracking
