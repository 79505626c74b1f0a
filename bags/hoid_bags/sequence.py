"""RGB-D recordings of any kind behind one interface."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Protocol

from hoid_bags.bag.bag_reader import is_bag
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_topics import TopicChoice
from hoid_bags.bag.metadata import METADATA
from hoid_bags.tum.association import MAX_PAIR_GAP_NS
from hoid_bags.tum.layouts import COLOR_LIST, find_layout
from hoid_bags.tum.tum_folder import open_tum_folder
from hoid_common.errors import InputError
from hoid_common.values import CameraModel, Detections, RgbdFrame, Trajectory


class Sequence(Protocol):
    """A recording of paired color and depth images; it can be iterated repeatedly."""

    @property
    def name(self) -> str:
        """Return a short name for titles."""

    @property
    def camera(self) -> CameraModel:
        """Return the camera of both images."""

    @property
    def ground_truth(self) -> Trajectory | None:
        """Return the ground-truth poses of the camera in a fixed frame; None: there are none."""

    @property
    def true_detections(self) -> Mapping[int, Detections] | None:
        """Return the ground-truth boxes by stamp of the color image (ns); None: there are none."""

    @property
    def fault(self) -> str | None:
        """Return a line of text about the unreadable part of a recording; None: no damage.

        Commands process the readable part, then print this line and exit with status 1.
        """

    def __len__(self) -> int:
        """Return the number of pairs of images."""

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield the frames in order of time; the stamp of a frame is that of its color image.

        Raises:
            InputError: In a TUM folder, an image is truncated, or of another kind, size or unit
                than expected. A bag leaves such images out; it raises this error if none of the
                first 30 pairs of images is usable, or no pair at all.
        """


def open_sequence(
    path: Path,
    camera: CameraModel | None = None,
    depth_units_per_m: float | None = None,
    choice: TopicChoice = TopicChoice(),  # noqa: B008 - immutable
    max_gap_ns: int = MAX_PAIR_GAP_NS,
    depth_offset_ns: int = 0,
) -> Sequence:
    """Open a folder of images or a bag.

    Args:
        path: The folder, or one file of a bag.
        camera: Camera of the recording; None takes it from the folder's name or the bag.
        depth_units_per_m: Depth units per meter; None: those of the layout of a folder (5000 for
            TUM RGB-D), or of the encoding for a bag (1000 for whole numbers, 1 for floats).
        choice: Topics of a bag that the user names; the other topics are found (see
            `find_topics`).
        max_gap_ns: A color and a depth image make a pair only if their stamps differ by less.
        depth_offset_ns: Time by which the stamps of depth images are too late; it is subtracted
            before pairing.

    Raises:
        InputError: The path does not exist, or is no usable recording.
        ConfigError: The depth units of a folder are not positive, or the folder lists a file with
            an impossible name.
    """
    if not path.exists():
        raise InputError(f'{path}: no such file or folder')
    if is_bag(path):
        return BagSequence(
            path, camera, choice, max_gap_ns, depth_offset_ns, depth_units_per_m or 0.0
        )
    if find_layout(path) is not None:
        return open_tum_folder(path, camera, depth_units_per_m, max_gap_ns, depth_offset_ns)
    raise InputError(
        f'{path}: neither a TUM folder (no {COLOR_LIST}) nor a bag '
        f'(no {METADATA}, .mcap, .db3 or .bag)'
    )
