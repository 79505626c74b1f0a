"""The action `map export`: writes the mesh of a saved map, or its objects as JSON."""

from __future__ import annotations

from pathlib import Path

from hoid_common.errors import ConfigError, InputError, counted
from hoid_common.store.map_directory import write_whole
from hoid_scene.mesh import mesh_of, write_mesh
from hoid_scene.search.object_list import objects_json, whereabouts
from hoid_scene.search.object_query import ObjectQuery, find
from hoid_scene.store.scene_file import SavedScene, restored
from rgbd_slam.config.node_config import FrameConfig
from rgbd_slam.store.map_file import MapFile

_PLY, _GLB, _JSON = '.ply', '.glb', '.json'


def export(content: MapFile, scene: SavedScene, out: Path | None, *, is_semantic: bool) -> str:
    """Write a map to a file whose suffix selects the format; return a summary of its content.

    PLY and GLB get a mesh of the dense map, in measured colors or, if `is_semantic`, in colors of
    the objects' classes. JSON gets the objects, but no tentative ones. ConfigError if the suffix
    of the file is missing or unknown. InputError if the map has no dense map, or a package is
    missing.
    """
    if out is None or out.suffix not in (_PLY, _GLB, _JSON):
        raise ConfigError('export needs --out FILE.ply, FILE.glb or FILE.json')
    keyframes = content.keyframes()
    mapper = restored(scene, keyframes, content.camera, label_cloud=True)
    if out.suffix == _JSON:
        every = mapper.mapped_objects(tentative=True)
        rooms = mapper.rooms(every)
        objects = find(every, ObjectQuery(state='any'))
        where = [whereabouts(item, every, rooms) for item in objects]
        text = objects_json(objects, where, FrameConfig().map)
        write_whole(out, lambda aside: aside.write_text(text, encoding='utf-8'))
        return counted(len(objects), 'object')
    if scene.dense is None:
        raise InputError('there is no dense map: set dense.enabled, or give --dense to run')
    cloud = mapper.cloud()
    poses = keyframes.T_map_camera[keyframes.is_main]
    voxel_m = float(scene.dense.voxel_m[0])
    mesh = mesh_of(cloud, mapper.label(cloud), voxel_m, content.camera, poses)
    write_whole(out, lambda aside: write_mesh(aside, mesh, is_semantic=is_semantic))
    return f'{len(mesh.faces)} triangles, {len(mesh.vertices_m)} vertices'
