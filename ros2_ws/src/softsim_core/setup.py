"""Install rules of the ROS package; the code is the import package of the same name, three folders up."""

from setuptools import find_packages, setup

NAME = "softsim_core"

setup(
    name=NAME,
    version="0.2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed"], NAME: ["physics/fem/materials/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},  # by which colcon knows what runs the tests
    zip_safe=False,
    maintainer="the softsim authors",
    maintainer_email="softsim@users.noreply.example.org",
    description="Soft-robot physics: finite elements, rigid frames, joints. NumPy arrays in and out.",
    license="Apache-2.0",
)
