"""Install rules of the ROS package; the code is the import package of the same name, three folders up."""

from setuptools import find_packages, setup

NAME = "servo_bridge"

setup(
    name=NAME,
    version="0.2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed"], NAME: ["firmware/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},  # by which colcon knows what runs the tests
    zip_safe=False,
    maintainer="the softsim authors",
    maintainer_email="softsim@users.noreply.example.org",
    description="Servo bridge: joint angles to servo packets on a serial port, and a virtual board.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "servo_bridge = servo_bridge.executables:servo_bridge",
            "virtual_board = servo_bridge.executables:virtual_board",
            "emulated_board = servo_bridge.executables:emulated_board",
        ],
    },
)
