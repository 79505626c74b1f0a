from setuptools import find_packages, setup

NAME = 'hoid_synth'

setup(
    name=NAME,
    version='0.1.0',
    description='Rendered rooms with people and handled objects, with ground truth, as bags',
    maintainer='HOID maintainers',
    maintainer_email='hoid@example.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    install_requires=['embreex', 'numpy', 'opencv-python-headless'],
    # Without pytest here `colcon test` runs no test at all.
    extras_require={'test': ['pytest']},
    zip_safe=True,
)
