from setuptools import find_packages, setup

PACKAGE = "plane_sim"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Node that simulates the tilting plane under a swarm",
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
            "plane_driver = plane_sim.driver:main",
            "plane_sim = plane_sim.node:main",
            "plane_sim_realtime = plane_sim.realtime:main",
        ],
    },
)
