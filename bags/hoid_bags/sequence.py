"""RGB-D recordings of any kind behind one interface."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

from hoid_bags.bag.bag_reader import METADATA, is_bag
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.tum.cameras import TUM_DEPTH_UNITS_PER_M
from hoid_bags.tum.tum_folder import COLOR_LIST, open_tum_folder
from hoid_common.errors import InputError
from hoid_common.values import CameraModel, Detections, RgbdFrame, Trajectory


class Sequence(Protocol):
    """A recording: pairs of colour and depth images in order of time; it may be iterated again."""

    @property
    def name(self) -> str:
        """Return a short name for titles."""

    @property
    def camera(self) -> CameraModel:
        """Return the camera of both images."""

    @property
    def ground_truth(self) -> Trajectory | None:
        """Return the true poses, when the recording has them."""

    @property
    def true_detections(self) -> Mapping[int, Detections] | None:
        """Return the exact detections by colour stamp, when the recording has them."""

    @property
    def fault(self) -> str | None:
        """Return what is wrong with a recording of which only a part can be read, else None.

        Such a recording is still worth processing: do so, then report this line and exit with 1.
        """

    def __len__(self) -> int:
        """Return the number of pairs."""

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield the pairs; the frame's stamp is that of its color image.

        Raises:
            InputError: an image is truncated or of another kind or size than expected.
        """


def open_sequence(
    path: Path, camera: CameraModel | None = None, depth_units_per_m: float = TUM_DEPTH_UNITS_PER_M
) -> Sequence:
    """Open a TUM folder or a bag.

    Args:
        camera: of the recording; None takes it from the folder's name or the bag.
        depth_units_per_m: of the PNG files of a folder; bags have units of their own.

    Raises:
        InputError: nothing there, or not a recording that can be used.
    """
    if not path.exists():
        raise InputError(f'{path}: no such file or folder')
    if is_bag(path):
        return BagSequence(path, camera)
    if (path / COLOR_LIST).exists():
        return open_tum_folder(path, camera, depth_units_per_m)
    raise InputError(
        f'{path}: neither a TUM folder (no {COLOR_LIST}) nor a bag (no {METADATA}, no .mcap file)'
    )
