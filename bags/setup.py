from setuptools import find_packages, setup

NAME = 'hoid_bags'

setup(
    name=NAME,
    version='0.3.0',
    description='TUM folders and rendered scenes to MCAP bags; info, play and record',
    maintainer='HOID RGB-D SLAM maintainers',
    maintainer_email='hoid-rgbd-slam@users.noreply.github.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    install_requires=[
        'apsw',
        'backports-zstd',
        'lz4',
        'mcap',
        'numpy',
        'opencv-python-headless',
        'pyyaml',
        'rosbags',
        'tqdm',
    ],
    # Without pytest here `colcon test` runs no test at all.
    extras_require={'test': ['hypothesis', 'mcap-ros2-support', 'pytest'], 'video': ['av']},
    zip_safe=True,
)
