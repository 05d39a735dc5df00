"""Package of the node `tip_planner`, as `colcon build` installs it."""

from setuptools import setup

NAME = "hystmpc_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/tip_planner.launch.xml"]),
        (f"share/{NAME}/config", ["config/tip_planner.yaml", "config/two_axes.yaml"]),
    ],
    install_requires=["setuptools", "hystmpc"],
    zip_safe=True,
    maintainer="The hystmpc developers",
    maintainer_email="hystmpc@example.org",
    description="The planner of hystmpc as a node",
    license="Apache-2.0",
    entry_points={"console_scripts": ["tip_planner = hystmpc_ros.tip_planner:main"]},
)
