from glob import glob

from setuptools import find_packages, setup

NAME = 'hoid_bringup'

setup(
    name=NAME,
    version='0.3.0',
    description='Command line, offline pipeline, live replay, evaluation and launch files',
    maintainer='HOID RGB-D SLAM maintainers',
    maintainer_email='hoid-rgbd-slam@users.noreply.github.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/*.yaml')),
        (f'share/{NAME}/launch', glob('launch/*.py')),
        (f'share/{NAME}/policies', glob('policies/*.xml')),
        (f'share/{NAME}/rviz', glob('rviz/*.rviz')),
        (f'share/{NAME}/foxglove', glob('foxglove/*.json')),
    ],
    install_requires=[
        'argcomplete',
        'numpy',
        'opencv-python-headless',
        'psutil',
        'pyyaml',
        'rosbags',
    ],
    # Without pytest here `colcon test` runs no test at all.
    extras_require={
        'test': ['hypothesis', 'pytest'],
        'experiments': ['evo', 'matplotlib'],
        'view': ['rerun-sdk'],
    },
    zip_safe=True,
    entry_points={'console_scripts': ['hoid = hoid_bringup.cli:main']},
)
