from setuptools import find_packages, setup

PACKAGE = "swarmabs_view"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Pages, terminal panels, RViz and Foxglove: how people see a swarm",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "static/*", "third_party/uplot/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools", "psutil", "rich"],
    extras_require={
        "foxglove": ["foxglove-sdk"],
        "view": ["aiohttp"],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "plane_markers = swarmabs_view.visualization.node:main",
        ],
    },
)
