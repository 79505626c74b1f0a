"""Choice of the camera calibration when camera_info messages and images contradict."""

from __future__ import annotations

from hoid_common import topics
from hoid_common.errors import MessageError
from hoid_common.values import CameraModel

# Chosen: number of matching images (1 s at 30 Hz) after which the calibration is kept, because a
# map depends on it by then.
_TRIAL_IMAGES = 30
# Chosen: number of identical messages in a row after which another calibration replaces the one
# that is on trial.
_MIN_REPEATS = 2


class CameraInfoCheck:
    """Decides which calibration to use when camera_info messages contradict each other or images.

    The first calibration is used at once, on trial for 30 images. A calibration for another image
    size than that of the images is never accepted. Another calibration replaces the one in use
    only while this is on trial or does not match the images. After the trial, another calibration
    is reported as a problem, until the one in use is received again.
    """

    def __init__(self, reset: str = topics.RESET) -> None:
        self._reset = reset
        self.camera: CameraModel | None = None  # the calibration in use
        self.problem = ''  # the current contradiction, in one line; empty if there is none
        self._image_size_px: tuple[int, int] | None = None
        self._num_images = 0  # number of images that matched the calibration in use
        self._candidate: CameraModel | None = None  # another calibration
        self._num_repeats = 0  # number of messages in a row with the candidate

    def update(self, camera: CameraModel) -> bool:
        """Process a camera_info; return whether its calibration has just come into use.

        Also updates `camera` and `problem`.
        """
        if camera == self.camera:
            self._candidate, self.problem = None, self._mismatch(camera)
            return False
        if mismatch := self._mismatch(camera):
            self.problem = mismatch
            return False
        self._num_repeats = self._num_repeats + 1 if camera == self._candidate else 1
        self._candidate = camera
        if not self._is_replaceable():
            self.problem = (
                f'the camera changed and its images do not fit the map; call {self._reset}'
            )
            return False
        self.camera, self._candidate, self.problem, self._num_images = camera, None, '', 0
        return True

    def check_image(self, size_px: tuple[int, int]) -> None:
        """Count an image; raise MessageError if its size is not that of the calibration in use.

        Args:
            size_px: Width and height of the image.
        """
        self._image_size_px = size_px
        mismatch = self._mismatch(self.camera) if self.camera is not None else ''
        if mismatch:
            self.problem = mismatch
            raise MessageError(mismatch)
        self._num_images += self.camera is not None

    def _is_replaceable(self) -> bool:
        if self.camera is None or self._mismatch(self.camera):
            return True
        return self._num_images < _TRIAL_IMAGES and self._num_repeats >= _MIN_REPEATS

    def _mismatch(self, camera: CameraModel) -> str:
        if self._image_size_px in (None, camera.size_px):
            return ''
        (width, height), (seen_width, seen_height) = camera.size_px, self._image_size_px or (0, 0)
        return (
            f'camera_info is of {width}x{height} px, images are of {seen_width}x{seen_height} px: '
            'publish the camera_info of the color images'
        )
