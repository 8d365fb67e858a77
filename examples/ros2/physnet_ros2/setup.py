"""Built by colcon: `colcon build --packages-select physnet_ros2`."""

from setuptools import setup

NAME = "physnet_ros2"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/physnet.launch.py"]),
        (f"share/{NAME}/config", ["config/physnet.yaml"]),
    ],
    install_requires=["setuptools", "physnet-client"],
    zip_safe=True,
    license="Apache-2.0",
    entry_points={"console_scripts": [f"physnet_node = {NAME}.node:main"]},
)
