"""The command `map`: shows, merges, changes and exports saved maps."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from hoid_common.errors import ConfigError, InputError, MapFileError, counted
from hoid_common.io.files import check_writable
from hoid_common.store.database import SUFFIX
from hoid_common.store.map_directory import named_map
from hoid_scene.search.object_query import ObjectQuery, find
from hoid_scene.store import scene_file
from hoid_scene.store.scene_file import SavedScene, join_scenes, restored
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.map_joining import MapJoin, join_maps, without_loop
from rgbd_slam.store import map_file
from rgbd_slam.store.map_file import MapFile

_MB = 1e6
_INFO, _MERGE, _LOOPS, _REMOVE, _EXPORT = 'info', 'merge', 'loops', 'remove-loop', 'export'
_NO_MESH = (
    'scikit-image or trimesh is not installed: run the command through ./hoid, which installs '
    'them, or "pip install -r requirements/mesh.lock"'
)
_OTHER_VOXELS = 'its voxels have another size than those of the first map'


def add_map_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        'action',
        choices=(_INFO, _MERGE, _LOOPS, _REMOVE, _EXPORT),
        help='info: print what each map holds; merge: join maps that show the same places, in the '
        'frame of the first one; loops: list loops and joins; '
        'remove-loop: take back loop K of a map, as in "remove-loop FILE K"; '
        'export: write a mesh of the dense map (.ply, .glb) or the objects (.json)',
    )
    parser.add_argument('maps', type=Path, nargs='+', metavar='FILE', help=f'saved {SUFFIX} files')
    parser.add_argument(
        '--out',
        type=Path,
        metavar='FILE',
        help='merge: file of the joined map; remove-loop: file of the new map, by default FILE; '
        'export: file for other programs',
    )
    parser.add_argument(
        '--semantic',
        action='store_true',
        help='export: a mesh with the colors of classes, and in a .ply file labels',
    )
    for option, text in (
        ('--join', 'merge: these two show the same places'),
        ('--apart', 'merge: never join these two'),
    ):
        parser.add_argument(
            option,
            type=Path,
            nargs=2,
            action='append',
            default=[],
            metavar='FILE',
            help=f'{text}; can be repeated',
        )


def map_command(args: argparse.Namespace) -> None:
    """Carry out the action of `map`: show saved maps, merge them, remove a loop, or export."""
    described = {_INFO: _described, _LOOPS: _listed_loops}
    change = {_MERGE: _merge, _REMOVE: _remove_loop, _EXPORT: _export}.get(args.action)
    if change is not None:
        change(args)
        return
    for path in args.maps:
        _print(*described[args.action](path, map_file.load(named_map(path))))


def _merge(args: argparse.Namespace) -> None:
    if args.out is None or len(args.maps) < 2:
        raise ConfigError('merge needs at least two maps, and --out for the joined one')
    check_writable(args.out.parent)
    contents = [map_file.load(named_map(path)) for path in args.maps]
    same, apart = _numbers(args.join, args.maps), _numbers(args.apart, args.maps)
    joined = join_maps(contents, SlamConfig(), same=same, apart=apart)
    for path, join in zip(args.maps[1:], joined.joins, strict=True):
        _print(*_joined(path, join, args.maps))
    scenes = [
        scene_of(path).renamed(content.keyframes().uids, uids)
        for path, content, uids in zip(args.maps, contents, joined.uids, strict=True)
    ]
    scene = join_scenes(scenes, joined.content.keyframes(), joined.content.camera)
    for path, keeps_dense in zip(args.maps, scene.keeps_dense, strict=True):
        if not keeps_dense:
            _print(f'{path}: its dense map is left out: {_OTHER_VOXELS}')
    if not any(join.is_joined for join in joined.joins):
        raise MapFileError('no map shows a place of another one; nothing is written')
    args.out.parent.mkdir(parents=True, exist_ok=True)
    map_file.save(args.out, joined.content)
    scene_file.add_to_file(args.out, scene.scene)
    size = args.out.stat().st_size
    _print(f'{args.out}: {counted(len(joined.content.map), "keyframe")}, {size / _MB:.1f} MB')


def _remove_loop(args: argparse.Namespace) -> None:
    if len(args.maps) != 2 or not str(args.maps[1]).isdigit():
        raise ConfigError('remove-loop needs a map and the number of a loop: FILE K')
    path, number = named_map(args.maps[0]), int(str(args.maps[1]))
    out = args.out or path
    check_writable(out.parent)
    scene = scene_of(path)
    opened = without_loop(map_file.load(path), number, SlamConfig())
    map_file.save(out, opened)
    scene_file.add_to_file(out, scene)
    _print(f'{out}: without loop {number}, {len(opened.loops)} loops and joins are left')


def _export(args: argparse.Namespace) -> None:
    if len(args.maps) != 1:
        raise ConfigError('export takes one map')
    if find_spec('trimesh') is None or find_spec('skimage') is None:
        raise InputError(_NO_MESH)
    from hoid_bringup.maps.map_export import export

    path = named_map(args.maps[0])
    done = export(map_file.load(path), scene_of(path), args.out, is_semantic=args.semantic)
    _print(f'{args.out}: {done}, {args.out.stat().st_size / _MB:.1f} MB')


def scene_of(path: Path) -> SavedScene:
    """Return the scene in a saved map; empty if `path` is the folder of a killed node."""
    return scene_file.read_file(path) if path.is_file() else SavedScene()


def _print(*lines: str) -> None:
    sys.stdout.writelines(f'{line}\n' for line in lines)


def _described(path: Path, content: MapFile) -> Iterable[str]:
    scene = scene_of(path)
    state, camera = content.map, content.camera
    sizes = np.sort(np.bincount(state.map_id))[::-1]
    extent_m = np.ptp(state.T_map_camera[:, :3, 3], axis=0)
    lens = f'fx={camera.fx_px:g} fy={camera.fy_px:g}'
    lines = [
        f'{path}: {path.stat().st_size / _MB:.1f} MB',
        f'keyframes  {len(state)}, over {" x ".join(f"{side:.1f}" for side in extent_m)} m',
        f'points     {len(state.position_m)}',
        f'camera     {camera.width_px}x{camera.height_px}, {lens}',
        f'dense map  {counted(len(scene.dense), "voxel")}' if scene.dense else 'dense map  none',
    ]
    if scene.objects is not None:
        mapper = restored(scene, content.keyframes(), content.camera)
        found = find(mapper.mapped_objects(), ObjectQuery())
        lines.append(f'objects    {len(found)}, listed by "hoid objects"')
    if len(sizes) > 1:
        lines.append(
            f'apart      {len(sizes)} maps that no recognized place joins, of '
            f'{", ".join(map(str, sizes))} keyframes'
        )
    return lines


def _listed_loops(path: Path, content: MapFile) -> Iterable[str]:
    yield f'{path}: {len(content.loops)} loops and joins'
    if content.loops:
        yield 'number  kind      keyframes    points  found  residual  used'
    for n, edge in enumerate(content.loops):
        yield (
            f'{n:6}  {edge.kind:8}  {edge.first_uid:5} {edge.second_uid:5}  {edge.num_inliers:6}  '
            f'{100 * edge.found_share:3.0f} %  {edge.residual_m:6.3f} m  '
            f'{"yes" if edge.is_used else "no"}'
        )


def _numbers(pairs: Sequence[Sequence[Path]], maps: Sequence[Path]) -> list[tuple[int, int]]:
    """Return the indices of each pair in `maps`; ConfigError for a path that is not in it."""
    for pair in pairs:
        for path in pair:
            if path not in maps:
                raise ConfigError(f'{path}: --join and --apart take two of the maps to be merged')
        if pair[0] == pair[1]:
            raise ConfigError(f'{pair[0]}: --join and --apart take two different maps')
    return [(maps.index(one), maps.index(other)) for one, other in pairs]


def _joined(path: Path, join: MapJoin, maps: Sequence[Path]) -> Iterator[str]:
    """Yield the output lines of `map merge` about a map: the maps it is joined with, and why."""
    names = ', '.join(str(maps[n]) for n in join.joined_with)
    line = f'{path}: joined with {names}' if names else f'{path}: not joined'
    if not names and not join.fits:
        line += ', as none of its keyframes shows a place of another map'
    if join.disagreement_m is not None:
        line += (
            f'; {len(join.links)} places agree within {1e3 * join.disagreement_m:.0f} mm in the '
            'median'
        )
    yield line
    for fit in join.fits:
        found = f'{fit.num_places} place(s) with {100 * fit.found_share:.0f} % of the points'
        if not fit.doubt:
            yield f'  by {found} that are expected there'
        elif names:
            yield f'  {found} fit, though {fit.doubt}'
        else:
            yield (
                f'  {found} fit, but {fit.doubt}: if the places are the same and do not only look '
                'alike, name the two maps with --join'
            )
