"""Executes the commands that the SLAM node sends to the scene process."""

from __future__ import annotations

from hoid_common.errors import HoidError, InputError
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.objects.object_query import find
from hoid_scene.scene_mapper import SceneMapper
from rgbd_slam.ros.scene.files import save_cloud, save_grid, save_objects
from rgbd_slam.ros.scene.messages import CommandResult, SceneCommand
from rgbd_slam.ros.scene.outputs import SceneOutputs


def execute(
    command: SceneCommand, scene: SceneMapper | None, outputs: SceneOutputs, stamp_ns: int
) -> CommandResult:
    """Execute a command, and return its result, which contains the text of an error if it failed.

    Args:
        command: The command.
        scene: The scene mapper; None if there is none.
        outputs: The outputs of the scene, for the size of the grid and the name of the map frame.
        stamp_ns: Stamp of the latest image that was used for the scene; 0: none yet.
    """
    try:
        objects = _found(command, scene)
        text = _written(command, scene, outputs)
        if command.forget_id is not None:
            text = _forgotten(command.forget_id, scene)
    except HoidError as error:
        return CommandResult(command.number, False, str(error))
    return CommandResult(command.number, True, text, objects, stamp_ns)


def _written(command: SceneCommand, scene: SceneMapper | None, outputs: SceneOutputs) -> str:
    """Write the requested files; return a message for the user about the last one, or ''.

    The files of `_export` have no message.
    """
    text = ''
    if scene is not None:
        _export(command, scene)
    if command.cloud_path is not None:
        text = save_cloud(scene, command.cloud_path)
    if command.grid_path is not None:
        text = save_grid(scene, outputs.place_grid, command.grid_path)
    if command.yaml_path is not None:
        text = save_objects(scene, command.yaml_path, outputs.frame)
    return text


def _export(command: SceneCommand, scene: SceneMapper) -> None:
    """Write the submaps and the object map to the requested files, which the SLAM node reads.

    A file is not written if there is no such map, or if it is empty.
    """
    if command.submaps_path is not None:
        submaps = scene.export_since(command.submaps_since)
        if submaps is not None:
            submaps.write(command.submaps_path)
    if command.objects_path is not None:
        objects = scene.export_objects(scene.ledger.keyframes.uids)
        if objects is not None:
            objects.write(command.objects_path)


def _found(command: SceneCommand, scene: SceneMapper | None) -> tuple[MapObject, ...]:
    if command.query is None or scene is None:
        return ()
    return tuple(find(scene.mapped_objects(), command.query))


def _forgotten(object_id: int, scene: SceneMapper | None) -> str:
    if scene is None or not scene.forget_object(object_id):
        raise InputError(f'no object {object_id} in the object map; find_objects lists them')
    return f'object {object_id} is forgotten'
