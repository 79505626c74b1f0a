"""Choice of the calibration when camera_info contradicts itself or the size of the images."""

from __future__ import annotations

from hoid_common.errors import MessageError
from hoid_common.values import CameraModel

# Chosen: number of images of the calibration's size (1 s at 30 Hz) after which the calibration is
# kept, because a map depends on it by then.
_TRIAL_IMAGES = 30
# Chosen: number of identical messages in a row after which another calibration replaces one whose
# trial has not ended.
_MIN_REPEATS = 2


class CameraInfoCheck:
    """Decides which calibration to use when camera_info messages contradict each other or images.

    The first calibration with the size of the images is used at once, on trial for 30 images.
    During the trial, another calibration of this size replaces it: at once if the first is of a
    wrong size, else when it is received twice in a row. Afterwards it is kept (decision
    045), and contradictions are reported. A calibration of another size is scaled if one size is a
    whole multiple of the other.
    """

    def __init__(self, remedy: str) -> None:
        self._remedy = remedy
        self.camera: CameraModel | None = None  # the calibration in use
        # One line about a calibration that differs from the one in use, until the one in use is
        # received again; '' = none.
        self.change = ''
        self.scaling = ''  # one line if the calibration in use is scaled to the size of the images
        # One line if the images have another size than the calibration, else ''.
        self._size_problem = ''
        self._image_size_px: tuple[int, int] | None = None
        self._num_images = 0  # number of images that matched the calibration in use
        self._candidate: CameraModel | None = None  # another calibration, not in use
        self._num_repeats = 0  # number of messages in a row with the candidate

    @property
    def problem(self) -> str:
        return self.change or self._size_problem or self.scaling

    def update(self, camera: CameraModel) -> bool:
        """Update `camera` and `problem`; return whether a calibration has just come into use."""
        scaling = ''
        if camera != self.camera and (self.scaling or self._num_images < _TRIAL_IMAGES):
            camera, scaling = self._scaled(camera)
        self._size_problem = self.size_mismatch(camera)
        if camera == self.camera:
            self._candidate, self.change, self.scaling = None, '', scaling
            return False
        if self.camera is not None and self._num_images >= _TRIAL_IMAGES:
            self.change = self._change_text(self.camera, camera, 'since the map depends on it')
            return False
        if self._size_problem:
            return False
        self._num_repeats = self._num_repeats + 1 if camera == self._candidate else 1
        self._candidate = camera
        is_worse = self.scaling or (self.camera is not None and self.size_mismatch(self.camera))
        if self.camera is not None and not is_worse:
            if self._num_repeats < _MIN_REPEATS:
                self.change = self._change_text(self.camera, camera, 'until this is repeated')
                return False
            self.change = (
                f'{_changed(self.camera, camera)}: the second is used for all images, since the '
                f'first came with few; if it is wrong, {self._remedy}'
            )
        self._use(camera, scaling)
        return True

    def _use(self, camera: CameraModel, scaling: str) -> None:
        self.camera, self.scaling = camera, scaling
        self._candidate, self._num_images = None, 0

    def _scaled(self, camera: CameraModel) -> tuple[CameraModel, str]:
        mismatch = self.size_mismatch(camera)
        scaled = camera.scaled_to(self._image_size_px or camera.size_px)
        if not mismatch or scaled is None:
            return camera, ''
        return scaled, f'{mismatch}; it is scaled to them, which is wrong if they are cut out'

    def check_image(self, size_px: tuple[int, int]) -> bool:
        """Count an image of (width, height); return whether the calibration was scaled to it now.

        MessageError if the calibration in use has another size.
        """
        self._image_size_px = size_px
        camera, scaling = self._scaled(self.camera) if self.camera is not None else (None, '')
        is_scaled = camera is not None and bool(scaling) and not self._num_images
        if camera is not None and is_scaled:
            self._use(camera, scaling)
        self._size_problem = self.size_mismatch(self.camera) if self.camera is not None else ''
        if self._size_problem:
            raise MessageError(self._size_problem)
        self._num_images += self.camera is not None
        return is_scaled

    def _change_text(self, kept: CameraModel, other: CameraModel, why: str) -> str:
        return f'{_changed(kept, other)}: the first is kept, {why}; {self._remedy}'

    def size_mismatch(self, camera: CameraModel) -> str:
        """Return an error text if a calibration differs from the latest image in size, else ''."""
        if self._image_size_px in (None, camera.size_px):
            return ''
        (width, height), (seen_width, seen_height) = camera.size_px, self._image_size_px or (0, 0)
        is_kept = self._num_images >= _TRIAL_IMAGES
        remedy = self._remedy if is_kept else 'publish the camera_info of the color images'
        return (
            f'camera_info is of {width}x{height} px, images are of {seen_width}x{seen_height} px: '
            f'{remedy}'
        )


def _changed(first: CameraModel, second: CameraModel) -> str:
    return f'camera_info has changed from {_text(first)} to {_text(second)}'


def _text(camera: CameraModel) -> str:
    return (
        f'{camera.width_px}x{camera.height_px} px, fx {camera.fx_px:.1f}, '
        f'{len(camera.distortion)} distortion coefficients'
    )
