"""Finding a lost camera in everything mapped so far."""

from __future__ import annotations

import logging

import numpy as np

from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.place_finder import FoundPlace, PlaceFinder
from rgbd_slam.places.pose_hint import PoseHint
from rgbd_slam.tracking.tracker import Tracker, TrackerOutput

_logger = logging.getLogger(__name__)

_HINTED_FRAMES = 30  # in which the camera is looked for at a pose given; each costs some 20 ms
_FOUND = 'found {:.1f} m and {:.0f} degrees from the pose given'
_NOT_THERE = 'not found at the pose given; looking everywhere'


class Relocalizer:
    """Looks for the place of single frames; its index follows the map only while it is asked."""

    def __init__(
        self, atlas: Atlas, camera: StereoCamera, tracker: Tracker, config: SlamConfig
    ) -> None:
        self.num_found = 0  # lost frames
        self._tracker = tracker
        self._finder = PlaceFinder(atlas, camera, config.places, config.seed)
        self._hint: PoseHint | None = None
        self._num_looked = 0  # frames, at the pose given
        self._note = self._logged = ''

    def relocalize_near(self, hint: PoseHint) -> None:
        """Look at a pose before anywhere else, until the camera is found."""
        self._hint, self._num_looked, self._logged = hint, 0, ''

    def take_note(self) -> str:
        """Return what came of a pose given in the frame that was looked at last, once."""
        note, self._note = self._note, ''
        return note

    def relocalize(self, frame: Frame) -> TrackerOutput | None:
        """Track a frame from where it is recognised; None when that is unknown or not clear."""
        place = self._locate(frame)
        if place is None:
            return None
        points = np.full(len(frame), NO_POINT, np.int64)
        points[place.match.k] = place.match.j
        tracking = self._tracker.track_at(frame, place.match.T_camera_map, points, place.keyframe)
        if tracking is not None:
            self.num_found += 1
            self._compare(tracking)
        return tracking

    def _locate(self, frame: Frame) -> FoundPlace | None:
        hint = self._hint
        if hint is None:
            return self._finder.locate(frame)
        if self._num_looked < _HINTED_FRAMES:
            self._num_looked += 1
            place = self._finder.locate_near(frame, hint)
            if place is not None:
                return place
        self._say(_NOT_THERE)
        return self._finder.locate(frame)

    def _compare(self, tracking: TrackerOutput) -> None:
        """Say how far from the pose given the camera is."""
        if self._hint is not None:
            (away_m,), (turned_rad,) = self._hint.apart(tracking.tracked.T_map_camera[None])
            self._hint = None
            self._say(_FOUND.format(away_m, np.degrees(turned_rad)))

    def _say(self, note: str) -> None:
        self._note = note
        if note != self._logged:
            self._logged = note
            _logger.info(note)
