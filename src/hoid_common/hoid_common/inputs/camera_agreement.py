"""Which camera_info to believe: one that agrees with the images it comes with."""

from __future__ import annotations

from hoid_common.errors import MessageError
from hoid_common.values import CameraModel

_TRIAL_IMAGES = 30
"""After which a camera has proved itself, and a map depends on it."""
_REPEATS = 2
"""How often in a row another camera is said before it takes the place of one on trial."""


class CameraAgreement:
    """Weighs what is said of a camera, message by message.

    The first camera is taken at once, on trial. One of another size than the images is never
    used; another one replaces it while it is on trial or does not fit the images itself. Later it
    is only complained of, until the one in use is said again.
    """

    def __init__(self) -> None:
        self.camera: CameraModel | None = None  # in use
        self.complaint = ''  # what does not agree at the moment
        self._image_size_px: tuple[int, int] | None = None
        self._num_images = 0  # that fitted the camera in use
        self._rival: CameraModel | None = None
        self._num_said = 0  # times that the rival was said in a row

    def offer(self, camera: CameraModel) -> bool:
        """Weigh what a message says; return whether it is taken, so that all begins anew."""
        if camera == self.camera:
            self._rival, self.complaint = None, self._misfit(camera)
            return False
        if said := self._misfit(camera):
            self.complaint = said
            return False
        self._num_said = self._num_said + 1 if camera == self._rival else 1
        self._rival = camera
        if not self._is_replaceable():
            self.complaint = 'the camera changed and its images do not fit the map; call ~/reset'
            return False
        self.camera, self._rival, self.complaint, self._num_images = camera, None, '', 0
        return True

    def check_image(self, size_px: tuple[int, int]) -> None:
        """Note an image's width and height; raise MessageError if the camera's are others."""
        self._image_size_px = size_px
        said = self._misfit(self.camera) if self.camera is not None else ''
        if said:
            self.complaint = said
            raise MessageError(said)
        self._num_images += self.camera is not None

    def _is_replaceable(self) -> bool:
        if self.camera is None or self._misfit(self.camera):
            return True
        return self._num_images < _TRIAL_IMAGES and self._num_said >= _REPEATS

    def _misfit(self, camera: CameraModel) -> str:
        if self._image_size_px in (None, camera.size_px):
            return ''
        (width, height), (seen_width, seen_height) = camera.size_px, self._image_size_px or (0, 0)
        return (
            f'camera_info is of {width}x{height} px, images are of {seen_width}x{seen_height} px: '
            'publish the camera_info of the colour images'
        )
