"""Architecture rules: layers of imports, where ROS may be imported, sizes and docstrings."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
INIT_FILES = [
    *ROOT.glob('src/*/*/__init__.py'),
    *ROOT.glob('bags/*/__init__.py'),
    *ROOT.glob('lab/hoid_*/__init__.py'),
]
FOLDERS = {path.parent.name: path.parent for path in INIT_FILES}
# Layers from the lowest up; a member may import members of lower layers only. First the packages:
# the last two layers are the laboratory, which no robot installs.
PACKAGES = """
    hoid_native < hoid_common < hoid_detector hoid_filter hoid_scene rgbd_slam hoid_bags
    < hoid_bringup < hoid_synth < hoid_training hoid_benchmarks
"""
# Then the folders of each package, with the modules at its root.
LAYERS = {
    'hoid_common': """
        errors log_throttle topics slam_status < camera_topics config values
        < se3 process sync < io messages poses < inputs store < ros
    """,
    'hoid_detector': """
        drawing expected_objects newest_wins quarter_turn < model < config < onnx_detector < node
    """,
    'hoid_filter': """
        strategy_registry < config drawing < extraction < motion < strategy < detections
        < strategies masked_images < feature_filter < live_filter
        < ros < node
    """,
    'hoid_scene': """
        config place scene_scheduler memory < dense level < grid < tracks < objects
        < search < export mesh navigation_masks < scene_mapper < store < scene_session < ros < node
    """,
    'rgbd_slam': """
        config < records < model < matching < optimize < places < inertial < tracking local_mapping
        < loops < store < robot_frames late_verdicts map_joining focal_length < mapping
        < slam leveling < session < ros < node
    """,
    'hoid_bags': """
        images progress < storage < tum < bag < imu_recording sequence convert < options < live
        < commands
    """,
    'hoid_synth': """
        mesh noise < floor < config < texture < people < room < acting < render imu
        < truth static_model < scene < bag room_truth < commands
    """,
    'hoid_bringup': """
        arguments evaluate < run < live view maps < commands cli < __main__
    """,
    'hoid_benchmarks': """
        animation captions consistency markdown plan < jobs < rooms faults planner < building
        < live < report < publish demo_picture map_animation objects < object_picture < pictures
        < commands demo
    """,
}
ROS = re.compile(r'rclpy|launch(_ros)?|tf2_ros|rosgraph_msgs|.*_(msgs|srvs|interfaces)')
ROS_FOLDERS = re.compile(
    r'(hoid_common|hoid_filter|rgbd_slam|hoid_scene)\.ros\b|'
    r'(hoid_detector|hoid_filter|rgbd_slam|hoid_scene)\.node$|'
    r'hoid_bags\.live\b|hoid_bringup\.live\b|hoid_benchmarks(\.faults)?\.live\b'
)
MOST_MODULES, MOST_LINES = 12, 400
# Lines without the docstring; at most 5 % of the functions may be longer.
LONG_FUNCTION = 22
# Importing each takes more than 0.1 s, which would delay the restart of a killed node.
LONG_TO_LOAD = ('gtsam', 'rosbags.typesys.stores.ros2_jazzy', 'scipy', 'onnxruntime')
EXPERIMENTS_ONLY = ('distributed', 'embreex', 'evo', 'matplotlib', 'plotly')


@cache
def modules() -> dict[str, Path]:
    """Return the product's modules by name."""
    return {
        '.'.join(path.relative_to(folder.parent).with_suffix('').parts): path
        for folder in FOLDERS.values()
        for path in sorted(folder.rglob('*.py'))
        if path.name != '__init__.py'
    }


@cache
def imports(name: str) -> frozenset[str]:
    """Return the modules that a module imports anywhere in its text."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(modules()[name].read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {
                inner if (inner := f'{node.module}.{alias.name}') in modules() else node.module
                for alias in node.names
            }
    return frozenset(found)


def layer_of(layers: str, name: str) -> int:
    """Return the index of the layer that contains a package, folder or module."""
    for number, layer in enumerate(layers.split('<')):
        if name in layer.split():
            return number
    raise AssertionError(f'{name} is in no layer: add it to {Path(__file__).name}')


def test_packages_import_only_lower_packages() -> None:
    for name in modules():
        package = name.partition('.')[0]
        for other in {module.partition('.')[0] for module in imports(name)} & FOLDERS.keys():
            if other != package:
                above = layer_of(PACKAGES, other) >= layer_of(PACKAGES, package)
                assert not above, f'{name} must not import {other}'


@pytest.mark.parametrize('package', LAYERS)
def test_folders_import_only_lower_folders(package: str) -> None:
    for name in (name for name in modules() if name.startswith(f'{package}.')):
        folder = name.split('.')[1]
        for module in imports(name):
            head, _, rest = module.partition('.')
            other = rest.partition('.')[0]
            if head == package and other and other != folder:
                above = layer_of(LAYERS[package], other) >= layer_of(LAYERS[package], folder)
                assert not above, f'{name} must not import {module}'


def test_imports_have_no_cycles() -> None:
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, f'import cycle: {" -> ".join((*path, name))}'
        if name not in done:
            for other in sorted(imports(name) & modules().keys()):
                visit(other, (*path, name))
            done.add(name)

    for name in modules():
        visit(name, ())


def test_ros_is_imported_only_in_nodes_and_ros_folders() -> None:
    for name in modules():
        if not ROS_FOLDERS.search(name):
            found = {module for module in imports(name) if ROS.fullmatch(module.partition('.')[0])}
            assert not found, f'{name} imports {sorted(found)}'


def test_gtsam_is_imported_in_one_folder_only() -> None:
    users = {name.rpartition('.')[0] for name in modules() if 'gtsam' in imports(name)}
    assert users == {'rgbd_slam.optimize'}


def test_folders_files_and_functions_stay_small() -> None:
    folders = Counter(path.parent for path in modules().values())
    assert {f for f, count in folders.items() if count > MOST_MODULES} == set()
    lines = {name: len(path.read_text().splitlines()) for name, path in modules().items()}
    assert {name for name, count in lines.items() if count > MOST_LINES} == set()
    functions = [
        node
        for path in modules().values()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.FunctionDef)
    ]
    long = [function for function in functions if code_lines(function) > LONG_FUNCTION]
    assert len(long) <= 0.05 * len(functions)


def code_lines(function: ast.FunctionDef) -> int:
    """Return the number of lines of a function without its docstring."""
    first = function.body[0]
    has_docstring = ast.get_docstring(function) is not None
    docstring = (first.end_lineno or 0) - first.lineno + 1 if has_docstring else 0
    return (function.end_lineno or 0) - function.lineno + 1 - docstring


def test_every_module_and_public_class_has_a_docstring() -> None:
    """A function has one where its signature does not give shape, unit, frame or error."""
    for name, path in modules().items():
        tree = ast.parse(path.read_text())
        assert ast.get_docstring(tree), name
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith('_'):
                assert ast.get_docstring(node), f'{name}: {node.name}'


@pytest.mark.parametrize('package', LAYERS)
def test_every_folder_has_a_docstring(package: str) -> None:
    for path in FOLDERS[package].rglob('__init__.py'):
        if path.parent != FOLDERS[package]:
            assert ast.get_docstring(ast.parse(path.read_text())), path


def test_nodes_and_commands_import_no_package_of_the_experiments() -> None:
    code = (
        'import sys\n'
        f'sys.modules.update(dict.fromkeys({EXPERIMENTS_ONLY!r}))\n'
        'import hoid_bags.commands, hoid_bringup.live.nodes, hoid_bringup.cli\n'
        'import hoid_detector.node, hoid_filter.node, rgbd_slam.node, hoid_scene.node\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr


def test_slam_starts_without_slow_imports() -> None:
    code = (
        'import sys\n'
        f'sys.modules.update(dict.fromkeys({LONG_TO_LOAD!r}))\n'
        'from importlib import import_module\n'
        'import rgbd_slam, rgbd_slam.node\n'
        'for name in rgbd_slam.CHILD_MODULES:\n'
        '    import_module(name)\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr


def test_yaml_is_parsed_in_one_module_only() -> None:
    readers = re.compile(r'yaml\.(safe_|full_|unsafe_)?load')
    found = {name for name, path in modules().items() if readers.search(path.read_text())}
    assert found == {'hoid_common.io.yaml_file'}
