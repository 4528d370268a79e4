from setuptools import find_packages, setup

PACKAGE = "parent_controller"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Node that turns the plane's state into the desired abstract state",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "parent_controller = parent_controller.node:main",
            "parent_controller_realtime = parent_controller.realtime:main",
        ],
    },
)
