from setuptools import find_packages, setup

NAME = 'hoid_training'

setup(
    name=NAME,
    version='0.1.0',
    description='Training of the detector for rendered rooms',
    maintainer='HOID maintainers',
    maintainer_email='hoid@example.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    install_requires=['numpy', 'onnx', 'opencv-python-headless', 'torch', 'tqdm'],
    # Without pytest here `colcon test` runs no test at all.
    extras_require={'test': ['pytest']},
    zip_safe=True,
)
