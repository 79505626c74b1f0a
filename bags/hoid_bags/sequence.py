"""The interface that RGB-D recordings of all kinds have, and the function that opens them."""

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
        """Return the ground-truth poses of the camera in a fixed frame, or None."""

    @property
    def true_detections(self) -> Mapping[int, Detections] | None:
        """Return the ground-truth boxes by stamp of the color image (ns), or None."""

    @property
    def fault(self) -> str | None:
        """Return a line of text about the unreadable part of a recording; None: no damage.

        Commands process the readable part, then print this line and exit with status 1.
        """

    def __len__(self) -> int:
        """Return the number of pairs of images."""

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield the frames in order of time; the stamp of a frame is that of its color image.

        InputError: an image file is damaged, or of another kind, size or unit than expected.
        A bag leaves such images out; the error then means that the first 30 pairs, or all, are
        unusable.
        """


def open_sequence(
    path: Path,
    camera: CameraModel | None = None,
    depth_units_per_m: float | None = None,
    choice: TopicChoice = TopicChoice(),  # noqa: B008 - immutable
    max_gap_ns: int = MAX_PAIR_GAP_NS,
    depth_offset_ns: int = 0,
) -> Sequence:
    """Open a recording in files (see `open_tum_folder`) or a bag (see `BagSequence`).

    InputError if the path does not exist, or is no usable recording. ConfigError if the depth
    units are not positive, or a list names an impossible file.

    Args:
        camera: Camera of the recording; None: the camera that the recording states.
        depth_units_per_m: Depth units per meter; None: those of the layout, or of the encoding.
        choice: Topics of a bag that the user names; the others are found (see `find_topics`).
        max_gap_ns: A color and a depth image make a pair only if their stamps differ by less.
        depth_offset_ns: Time by which the stamps of depth images are too late.
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
