from setuptools import find_packages, setup

PACKAGE = "abstraction_observer"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Node that gathers the agents' states into the abstract and the auxiliary state",
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
            "abstraction_observer = abstraction_observer.node:main",
            "abstraction_observer_realtime = abstraction_observer.realtime:main",
        ],
    },
)
