from glob import glob

from setuptools import find_packages, setup

NAME = 'hoid_scene'

setup(
    name=NAME,
    version='0.3.0',
    description='Dense map, navigation grid, people and objects from images with known poses',
    maintainer='HOID RGB-D SLAM maintainers',
    maintainer_email='hoid-rgbd-slam@users.noreply.github.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/*.yaml')),
        (f'share/{NAME}/launch', glob('launch/*.py')),
        (f'lib/{NAME}', glob('scripts/*')),
    ],
    install_requires=['numpy', 'opencv-python-headless'],
    # Without pytest here `colcon test` runs no test at all.
    extras_require={
        'test': ['hypothesis', 'pytest', 'pyyaml'],
        'mesh': ['scikit-image', 'scipy', 'trimesh'],
    },
    zip_safe=True,
)
